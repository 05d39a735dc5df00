"""The serial hybrid of LSTM and backlash as a kind of model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, final

from hystmpc.trials.trial import Trial

from .kind import FitRequest, Identified, ModelKind, Progress
from .network_fit import estimate_network, identify_network, network_steps


@final
class Hb1Kind(ModelKind):
    """An LSTM that gives the four parameters of a backlash at every sample, S2 eq. (6); see `SerialNet`."""

    name: ClassVar[str] = "hb1"
    title: ClassVar[str] = "HB1"
    presets: ClassVar[tuple[str, ...]] = ("best", "paper", "paper-batch-4")

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None) -> Identified:
        self.check(trials, request)
        return identify_network(self.name, trials, request, progress)

    def steps(self, request: FitRequest) -> int | None:
        return network_steps(self.name, request)

    def estimate(self, trials: Sequence[Trial], request: FitRequest) -> float | None:
        return estimate_network(self.name, trials, request)
