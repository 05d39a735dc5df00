"""The rate-dependent Prandtl-Ishlinskii model as a kind of model."""

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
class PrandtlIshlinskiiKind(ModelKind):
    """Rate-dependent plays, S2 eq. (4)-(5); see `PrandtlIshlinskii`; from swapped trials S2's fitted inverse.

    Presets are methods: bounded least squares (`best`), Adam on windows as S2 has it (`paper`), differential evolution
    (`global`) and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "pi"
    title: ClassVar[str] = "PI"
    presets: ClassVar[tuple[str, ...]] = tuple(_METHODS)
    readable: ClassVar[bool] = True

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None) -> Identified:
        self.check(trials, request)
        return identify_operator(self.name, trials, request, _METHODS, progress)

    def steps(self, request: FitRequest) -> int | None:
        del request
        return None
