"""The rate-dependent Prandtl-Ishlinskii model as a kind of model."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, final

from .operator_fit import OperatorKind

_METHODS: Mapping[str, str] = MappingProxyType(
    {"best": "least_squares", "paper": "adam", "global": "global", "cmaes": "cmaes"}
)


@final
class PrandtlIshlinskiiKind(OperatorKind):
    """Rate-dependent plays, S2 eq. (4)-(5); see `PrandtlIshlinskii`; from swapped trials S2's fitted inverse.

    Presets are methods: bounded least squares (`best`), Adam on windows as S2 has it (`paper`), differential evolution
    (`global`) and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "pi"
    title: ClassVar[str] = "PI"
    presets: ClassVar[tuple[str, ...]] = tuple(_METHODS)
    methods: ClassVar[Mapping[str, str]] = _METHODS
