"""The kind of model that is a regression on plays; it is loaded when it is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

from hystmpc.trials.trial import Trial

from ..model import FitProgress
from .kind import FitRequest, Identified, ModelKind


def recorded(progress: FitProgress | None) -> tuple[list[tuple[int, float]], FitProgress]:
    """A history (step, least error), and a progress that writes it and goes on to the given one."""
    history: list[tuple[int, float]] = []

    def show(done: int, error: float) -> None:
        history.append((done, error))
        if progress:
            progress(done, error)

    return history, show


@final
class PlayKernelKind(ModelKind):
    """Monotone additive regression on plays: `best` with a first-order lag in front, or `rate_independent`.

    See `PlayKernelWeights` for the equations and `PlayKernelSettings` for what is chosen how.
    """

    name = "play_kernel"
    title = "play kernel"
    trainings = ("best", "rate_independent")

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None) -> Identified:
        from ..identify.estimation_noise import with_noise
        from ..play_kernel.fit import PLAY_KERNEL_TRAININGS, fit_play_kernel, play_kernel_bundle

        self.check(trials, request)
        settings = PLAY_KERNEL_TRAININGS[request.training]
        history, show = recorded(progress)
        fit = fit_play_kernel(trials, settings, request.skip_first_flexure, show)
        unit = trials[0].units.angle
        report = f"lag {fit.choice.lag_s:g} s, {fit.rmse:.4g} {unit} on the training trials"
        if fit.judged:
            report += f", {fit.judged[fit.choice]:.4g} {unit} offset-free on trials left out"
        bundle = with_noise(play_kernel_bundle(fit, trials, settings, request.limits), trials, fit.weights.state_size)
        return Identified(bundle, None, tuple(history), report, fit.interrupted)

    def estimate(self, trials: Sequence[Trial], request: FitRequest) -> float | None:
        from ..play_kernel.fit import PLAY_KERNEL_TRAININGS, play_kernel_seconds

        return play_kernel_seconds(trials, PLAY_KERNEL_TRAININGS[request.training])

    def steps(self, request: FitRequest) -> int | None:
        from ..play_kernel.fit import PLAY_KERNEL_TRAININGS

        settings = PLAY_KERNEL_TRAININGS.get(request.training)
        return None if settings is None else len(settings.lags_s) * len(settings.smoothness) + 1
