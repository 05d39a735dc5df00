"""The deadband rate-dependent Prandtl-Ishlinskii model as a kind of model."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, final

from .operator_fit import OperatorKind

_METHODS: Mapping[str, str] = MappingProxyType({"best": "least_squares", "paper": "global", "cmaes": "cmaes"})


@final
class DrdpiKind(OperatorKind):
    """Dead zones after rate-dependent plays, S1 section II-B as reconstructed in `Drdpi`; inverse from swapped trials.

    Presets are methods: bounded least squares (`best`), a global search of 1,000 iterations in place of S1's genetic
    algorithm (`paper`), and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "drdpi"
    title: ClassVar[str] = "DRDPI"
    presets: ClassVar[tuple[str, ...]] = tuple(_METHODS)
    methods: ClassVar[Mapping[str, str]] = _METHODS
    plays: ClassVar[int] = 10  # as S1 has them
