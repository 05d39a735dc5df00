"""The Bouc-Wen model as a kind of model."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, final

from .operator_fit import OperatorKind

_METHODS: Mapping[str, str] = MappingProxyType(
    {"best": "least_squares", "paper": "adam", "global": "global", "cmaes": "cmaes"}
)


@final
class BoucWenKind(OperatorKind):
    """Bouc-Wen hysteresis with the six parameters of S2's code; see `BoucWen`. It has no inverse map.

    Presets are methods: bounded least squares (`best`), Adam on windows (`paper`), differential evolution (`global`)
    and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "bouc_wen"
    title: ClassVar[str] = "Bouc-Wen"
    presets: ClassVar[tuple[str, ...]] = tuple(_METHODS)
    methods: ClassVar[Mapping[str, str]] = _METHODS
    invertible: ClassVar[bool] = False
