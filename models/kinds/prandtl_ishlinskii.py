"""The rate-dependent Prandtl-Ishlinskii model as a kind of model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, final

from hystmpc.trials.trial import Trial

from .kind import FitRequest, Identified, ModelKind, Progress
from .operator_fit import identify_operator


@final
class PrandtlIshlinskiiKind(ModelKind):
    """Rate-dependent plays, S2 eq. (4)-(5); see `PrandtlIshlinskii` and `InversePrandtlIshlinskii`."""

    name: ClassVar[str] = "pi"
    title: ClassVar[str] = "PI"
    readable: ClassVar[bool] = True

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None) -> Identified:
        self.check(trials, request)
        return identify_operator(self.name, trials, request, progress)

    def steps(self, request: FitRequest) -> int | None:
        del request
        return None
