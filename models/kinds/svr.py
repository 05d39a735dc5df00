"""Support-vector regression as a kind of model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, final

import numpy as np

from hystmpc.trials.trial import Trial

from ..contract.bundle import ExportBundle
from ..fit.svr_ import SvrFit, fit_svr
from ..fit.svr_settings import SVR_PRESETS, SvrSettings
from ..identify.trial_set import facts_of, fixed_rule
from ..probe import probe_commands
from ..svr.graph import svr_step_graph
from ..svr.step import SvrStep
from .kind import FitRequest, Identified, ModelKind, Progress


@final
class SvrKind(ModelKind):
    """Radial kernel on 50 past commands, S1: `paper` with its values, `grid` with its grid search, or `best`.

    See `SvrWeights` for the equations and `SvrSettings` for what is compared how.
    """

    name: ClassVar[str] = "svr"
    title: ClassVar[str] = "SVR"
    presets: ClassVar[tuple[str, ...]] = ("best", "paper", "grid")

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None) -> Identified:
        self.check(trials, request)
        settings = SVR_PRESETS[request.preset].model_copy(update={"seed": request.seed})
        history: list[tuple[int, float]] = []

        def show(done: int, error: float) -> None:
            history.append((done, error))
            if progress:
                progress(done, error)

        found = fit_svr(trials, settings, request.skip_first_flexure, show)
        choice, unit = found.choice, trials[0].units.angle
        report = (
            f"C {choice.c:g}, gamma {choice.gamma:g}, epsilon {choice.epsilon:g}: {len(found.weights.supports)} "
            f"support vectors of {found.samples} samples, {found.rmse:.4f} {unit} on these"
        )
        if found.judged:
            report += f", {found.judged[choice]:.4f} {unit} on what was left out"
        bundle = _bundle(found, trials, settings, request)
        return Identified(bundle, None, tuple(history), report, found.interrupted)

    def steps(self, request: FitRequest) -> int | None:
        settings = SVR_PRESETS.get(request.preset)
        if settings is None:
            return None
        compared = len(settings.c) * len(settings.gamma) * len(settings.epsilon)
        return 1 + (compared if compared > 1 else 0)


def _bundle(fit: SvrFit, trials: Sequence[Trial], settings: SvrSettings, request: FitRequest) -> ExportBundle:
    """Fresh and conditioned devices start alike: a window forgets what is older, and the warm-up fills it."""
    past = fit.weights.state_size
    rest = fixed_rule(np.full(past, float(np.mean([trial.command[0] for trial in trials]))))
    metadata = facts_of(
        "svr",
        trials,
        request.limits,
        (rest, rest),
        past,
        {
            "preset": settings.preset,
            "settings": settings.model_dump_json(),
            "c": fit.choice.c,
            "gamma": fit.choice.gamma,
            "epsilon": fit.choice.epsilon,
            "training_rmse": fit.rmse,
            "interrupted": fit.interrupted,
        },
    )
    return ExportBundle(svr_step_graph(fit.weights), metadata, SvrStep(fit.weights), probe_commands(metadata))
