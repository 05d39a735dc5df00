"""The stacked LSTM as a kind of model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, final

from hystmpc.trials.trial import Trial

from .kind import FitRequest, Identified, ModelKind, Progress
from .network_fit import estimate_network, identify_network, network_steps


@final
class LstmKind(ModelKind):
    """Two layers of 64 cells, S1 eq. (1) and S2 section III-B; see `LstmWeights`."""

    name: ClassVar[str] = "lstm"
    title: ClassVar[str] = "LSTM"
    presets: ClassVar[tuple[str, ...]] = ("best", "kernel", "paper", "s1")

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None) -> Identified:
        self.check(trials, request)
        return identify_network(self.name, trials, request, progress)

    def steps(self, request: FitRequest) -> int | None:
        return network_steps(self.name, request)

    def estimate(self, trials: Sequence[Trial], request: FitRequest) -> float | None:
        return estimate_network(self.name, trials, request)
