"""The stacked LSTM as a kind of model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, final

from hystmpc.trials.trial import Trial

from ..fit.lstm import fit_lstm
from ..fit.lstm_bundle import lstm_bundle
from ..fit.lstm_settings import LSTM_PRESETS, LstmSettings, WindowTraining
from .kind import FitRequest, Identified, ModelKind, Progress


@final
class LstmKind(ModelKind):
    """Two layers of 64 cells, S1 eq. (1) and S2 section III; see `LstmWeights` and `LSTM_PRESETS`."""

    name: ClassVar[str] = "lstm"
    title: ClassVar[str] = "LSTM"

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None) -> Identified:
        self.check(trials, request)
        settings = lstm_settings(request)
        found = fit_lstm(trials, settings, progress, request.validation)
        judges = ", ".join(Path(source).name for source in found.held_out) or "the training trials"
        report = (
            f"weights of step {found.best_step} of {settings.steps}, judged by {judges} "
            f"({found.validation_rmse_deg:.3f} {trials[0].units.angle})"
        )
        history = tuple((look.step, look.validation_rmse_deg) for look in found.history)
        return Identified(lstm_bundle(found, trials, request.limits), None, history, report, found.interrupted)

    def steps(self, request: FitRequest) -> int | None:
        return lstm_settings(request).steps


def lstm_settings(request: FitRequest) -> LstmSettings:
    """The preset's settings with what the request changes."""
    chosen = LSTM_PRESETS[request.preset]
    way = chosen.training
    windows = isinstance(way, WindowTraining)
    if request.steps is not None:
        way = way.model_copy(update={"epochs" if windows else "updates": request.steps})
    if request.constancy_weight is not None and windows:
        way = way.model_copy(update={"constancy_weight": request.constancy_weight})
    changes = {
        "seed": request.seed,
        "training": way,
        "first_flexure_weight": 0.0 if request.skip_first_flexure else chosen.first_flexure_weight,
    }
    if request.validation:
        changes["validation_trials"] = 0
    elif request.hold_out is not None:
        changes["validation_trials"] = request.hold_out
    return chosen.model_copy(update=changes)
