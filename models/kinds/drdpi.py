"""The deadband rate-dependent Prandtl-Ishlinskii model as a kind of model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar, final

from hystmpc.trials.trial import Trial

from .kind import FitRequest, Identified, ModelKind, Progress
from .operator_fit import identify_operator

_METHODS: Mapping[str, str] = MappingProxyType({"best": "least_squares", "paper": "global", "cmaes": "cmaes"})


@final
class DrdpiKind(ModelKind):
    """Dead zones after rate-dependent plays, S1 section II-B as reconstructed in `Drdpi`; inverse from swapped trials.

    Presets are methods: bounded least squares (`best`), a global search of 1,000 iterations in place of S1's genetic
    algorithm (`paper`), and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "drdpi"
    title: ClassVar[str] = "DRDPI"
    presets: ClassVar[tuple[str, ...]] = tuple(_METHODS)
    readable: ClassVar[bool] = True

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None) -> Identified:
        self.check(trials, request)
        return identify_operator(self.name, trials, request, _METHODS, progress)

    def steps(self, request: FitRequest) -> int | None:
        del request
        return None
