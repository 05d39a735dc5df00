"""The play-kernel model as a kind of model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, final

from hystmpc.trials.trial import Trial

from ..fit.play_kernel import fit_play_kernel, play_kernel_seconds
from ..fit.play_kernel_bundle import play_kernel_bundle
from ..fit.play_kernel_settings import PLAY_KERNEL_PRESETS
from .kind import FitRequest, Identified, ModelKind, Progress


@final
class PlayKernelKind(ModelKind):
    """Monotone additive regression on plays: `best` with a first-order lag in front, or `rate_independent`.

    See `PlayKernelWeights` for the equations and `PlayKernelSettings` for what is chosen how.
    """

    name: ClassVar[str] = "play_kernel"
    title: ClassVar[str] = "play kernel"
    presets: ClassVar[tuple[str, ...]] = ("best", "rate_independent")

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None) -> Identified:
        self.check(trials, request)
        settings = PLAY_KERNEL_PRESETS[request.preset]
        history: list[tuple[int, float]] = []

        def show(done: int, error: float) -> None:
            history.append((done, error))
            if progress:
                progress(done, error)

        found = fit_play_kernel(trials, settings, request.skip_first_flexure, show)
        unit = trials[0].units.angle
        report = f"lag {found.choice.lag_s:g} s, {found.rmse:.4f} {unit} on the training trials"
        if found.judged:
            report += f", {found.judged[found.choice]:.4f} {unit} offset-free on trials left out"
        bundle = play_kernel_bundle(found, trials, settings, request.limits)
        return Identified(bundle, None, tuple(history), report, found.interrupted)

    def estimate(self, trials: Sequence[Trial], request: FitRequest) -> float | None:
        return play_kernel_seconds(trials, PLAY_KERNEL_PRESETS[request.preset])

    def steps(self, request: FitRequest) -> int | None:
        settings = PLAY_KERNEL_PRESETS.get(request.preset)
        return None if settings is None else len(settings.lags_s) * len(settings.smoothness) + 1
