"""The 4-parameter backlash as a kind of model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar, final

from hystmpc.trials.trial import Trial

from .kind import FitRequest, Identified, ModelKind, Progress
from .operator_fit import identify_operator

_METHODS: Mapping[str, str] = MappingProxyType(
    {"best": "least_squares", "paper": "adam", "iterated": "iterated", "global": "global", "cmaes": "cmaes"}
)


@final
class BacklashKind(ModelKind):
    """Backlash with two slopes, S2 eq. (1)-(3); see `Backlash` and `InverseBacklash`.

    Presets are methods: bounded least squares (`best`), Adam on windows as S2 has it (`paper`), Voros' iterated
    regression (`iterated`), differential evolution (`global`) and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "backlash"
    title: ClassVar[str] = "backlash"
    presets: ClassVar[tuple[str, ...]] = tuple(_METHODS)
    readable: ClassVar[bool] = True

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None) -> Identified:
        self.check(trials, request)
        return identify_operator(self.name, trials, request, _METHODS, progress)

    def steps(self, request: FitRequest) -> int | None:
        del request
        return None
