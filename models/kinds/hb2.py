"""The parallel hybrid of backlash and LSTM as a kind of model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, final

from hystmpc.trials.trial import Trial

from .kind import FitRequest, Identified, ModelKind, Progress
from .network_fit import estimate_network, identify_network, network_steps


@final
class Hb2Kind(ModelKind):
    """A backlash fitted beforehand and an LSTM that adds what it leaves, S2 eq. (7); see `ParallelNet`."""

    name: ClassVar[str] = "hb2"
    title: ClassVar[str] = "HB2"
    presets: ClassVar[tuple[str, ...]] = ("best", "paper")

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None) -> Identified:
        self.check(trials, request)
        return identify_network(self.name, trials, request, progress)

    def steps(self, request: FitRequest) -> int | None:
        return network_steps(self.name, request)

    def estimate(self, trials: Sequence[Trial], request: FitRequest) -> float | None:
        return estimate_network(self.name, trials, request)
