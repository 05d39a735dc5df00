"""The Bouc-Wen model as a kind of model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar, final

from hystmpc.trials.trial import Trial

from .kind import FitRequest, Identified, ModelKind, Progress
from .operator_fit import identify_operator

_METHODS: Mapping[str, str] = MappingProxyType(
    {"best": "least_squares", "paper": "adam", "global": "global", "cmaes": "cmaes"}
)


@final
class BoucWenKind(ModelKind):
    """Bouc-Wen hysteresis with the six parameters of S2's code; see `BoucWen`. It has no inverse map.

    Presets are methods: bounded least squares (`best`), Adam on windows (`paper`), differential evolution (`global`)
    and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "bouc_wen"
    title: ClassVar[str] = "Bouc-Wen"
    presets: ClassVar[tuple[str, ...]] = tuple(_METHODS)
    readable: ClassVar[bool] = True
    invertible: ClassVar[bool] = False

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None) -> Identified:
        self.check(trials, request)
        return identify_operator(self.name, trials, request, _METHODS, progress)

    def steps(self, request: FitRequest) -> int | None:
        del request
        return None
