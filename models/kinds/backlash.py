"""The 4-parameter backlash as a kind of model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, final

from hystmpc.trials.trial import Trial

from .kind import FitRequest, Identified, ModelKind, Progress
from .operator_fit import identify_operator


@final
class BacklashKind(ModelKind):
    """Backlash with two slopes, S2 eq. (1)-(3); see `Backlash` and `InverseBacklash`."""

    name: ClassVar[str] = "backlash"
    title: ClassVar[str] = "backlash"
    readable: ClassVar[bool] = True

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None) -> Identified:
        self.check(trials, request)
        return identify_operator(self.name, trials, request, progress)

    def steps(self, request: FitRequest) -> int | None:
        del request
        return None
