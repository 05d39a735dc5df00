"""The 4-parameter backlash as a kind of model."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, final

from .operator_fit import OperatorKind

_METHODS: Mapping[str, str] = MappingProxyType(
    {"best": "least_squares", "paper": "adam", "iterated": "iterated", "global": "global", "cmaes": "cmaes"}
)


@final
class BacklashKind(OperatorKind):
    """Backlash with two slopes, S2 eq. (1)-(3); see `Backlash` and `InverseBacklash`.

    Presets are methods: bounded least squares (`best`), Adam on windows as S2 has it (`paper`), Voros' iterated
    regression (`iterated`), differential evolution (`global`) and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "backlash"
    title: ClassVar[str] = "backlash"
    presets: ClassVar[tuple[str, ...]] = tuple(_METHODS)
    methods: ClassVar[Mapping[str, str]] = _METHODS
