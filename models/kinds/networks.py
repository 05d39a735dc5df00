"""Kinds of model that are networks, with trainings of S2 (Wu et al., RA-L 2024), S1 (RA-L 2021) and our best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, final

from hystmpc.trials.trial import Trial

from ..model import FitProgress
from ..networks.settings import (
    GatedSettings,
    NetworkForm,
    NetworkSettings,
    RecurrentSettings,
    RestSettings,
    ScalingSettings,
    StreamTraining,
    TeacherSettings,
    WindowTraining,
)
from .kind import FitRequest, Identified, ModelKind

PLAIN = {"memory_samples": 0, "command_gain": 1.0}  # PyTorch's initial weights, as in the papers
S2_WINDOWS = WindowTraining(keep_after=10, padding_samples=50)
S1_WINDOWS = WindowTraining(epochs=50, padding_samples=49)


def s2_settings(
    kind: str, network: NetworkForm, training: WindowTraining = S2_WINDOWS, name: str = "paper"
) -> NetworkSettings:
    """Training settings of S2 section III-D: windows of 50, Adam 1e-3, batch 16, at most 100 epochs, rest at 30 deg."""
    return NetworkSettings(
        kind=kind,
        name=name,
        network=network,
        scaling=ScalingSettings(),
        rest=RestSettings(),
        warmup_samples=0,
        validation_trials=1,
        learning_rate=1e-3,
        training=training,
    )


def s1_settings(kind: str, network: NetworkForm, training: WindowTraining = S1_WINDOWS) -> NetworkSettings:
    """Training settings of S1 section II-C: windows of 50 padded on the left, ranges mapped to [-1, 1], 50 epochs.

    Optimiser, rate and batch are those of S2, since the table in S1 is lost.
    """
    return NetworkSettings(
        kind=kind, name="s1", network=network, warmup_samples=49, learning_rate=1e-3, training=training
    )


def by_training(*settings: NetworkSettings) -> Mapping[str, NetworkSettings]:
    """Settings by the name of the training."""
    return MappingProxyType({each.name: each for each in settings})


_LSTM = RecurrentSettings()
_GRU = RecurrentSettings(cell="gru")
_GATED_TRAINING = StreamTraining(
    streams=32,
    matrix_learning_rate=0.02,
    updates=1600,
    teacher=TeacherSettings(model="play_kernel", runs=32, centred=True),
)
RESIDUAL = "residual"
"""Training of a network of what operators leave: there is no model of plays to learn from beside the trials."""

_WINDOW = 50  # samples in S2's windows, for its constancy term


@final
class NetworkKind(ModelKind):
    """Kind of model that is a network; torch is loaded when one is trained.

    Args:
        settings: by training, the default first.
    """

    def __init__(
        self,
        name: str,
        title: str,
        settings: Mapping[str, NetworkSettings],
        recurrent: bool = True,
        inverse_training: str = "",
    ) -> None:
        self.name, self.title, self.trainings, self.settings = name, title, tuple(settings), settings
        self.recurrent, self.inverse_training = recurrent, inverse_training

    def training(self, request: FitRequest) -> NetworkSettings:
        """Settings of a training with the changes of a request; the constancy term requires windows."""
        chosen = self.settings[request.training]
        way = chosen.training.model_dump()
        if request.steps is not None:
            way["epochs" if isinstance(chosen.training, WindowTraining) else "updates"] = request.steps
        if request.constancy_weight is not None:
            way["constancy_weight"] = request.constancy_weight
            if request.constancy_weight > 0:
                way["length"] = max(way["length"], _WINDOW)
        changes: dict[str, Any] = {"seed": request.seed, "training": way}
        if request.skip_first_flexure:
            changes["first_flexure_weight"] = 0.0
        if request.validation:
            changes["validation_trials"] = 0
        elif request.hold_out is not None:
            changes["validation_trials"] = request.hold_out
        return NetworkSettings.parse(dict(chosen) | changes, f"{self.name}, training {request.training}")

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None) -> Identified:
        from ..identify.estimation_noise import with_noise  # not needed for a list of kinds
        from ..train.networks import fit_network, network_bundle

        self.check(trials, request)
        settings = self.training(request)
        fit = fit_network(trials, settings, progress, request.validation)
        judges = ", ".join(Path(source).name for source in fit.held_out) or "the training trials"
        report = (
            f"weights of step {fit.best_step} of {settings.steps}, judged by {judges} "
            f"({fit.validation_rmse_deg:.4g} {trials[0].units.angle})"
        )
        history = tuple((look.step, look.validation_rmse_deg) for look in fit.history)
        bundle = network_bundle(fit, trials, request.limits)
        unseen = request.validation or [trial for trial in trials if trial.source in fit.held_out]
        bundle = with_noise(bundle, unseen or trials, 0 if unseen else bundle.metadata.state_size)
        return Identified(bundle, None, history, report, fit.interrupted)

    def steps(self, request: FitRequest) -> int:
        return self.training(request).steps

    def estimate(self, trials: Sequence[Trial], request: FitRequest) -> float | None:
        from ..train.networks import training_seconds

        return training_seconds(trials, self.training(request))


LSTM = NetworkKind(
    "lstm",
    "LSTM",
    by_training(
        NetworkSettings(kind="lstm", network=GatedSettings(), learning_rate=0.01, training=_GATED_TRAINING),
        NetworkSettings(kind="lstm", name="stacked", network=_LSTM),
        NetworkSettings(
            kind="lstm",
            name=RESIDUAL,
            network=GatedSettings(),
            learning_rate=0.01,
            training=_GATED_TRAINING.model_copy(update={"teacher": None}),
        ),
        s2_settings("lstm", _LSTM.model_copy(update=PLAIN)),
        s1_settings("lstm", _LSTM.model_copy(update=PLAIN)),
    ),
    inverse_training="stacked",  # a gated state cannot jump across the loop, as the command does where the angle turns
)
"""Cells over plays of the command, see `GatedLstmNet`; the papers' two layers of 64, see `LstmWeights`."""

GRU = NetworkKind(
    "gru",
    "GRU",
    by_training(
        NetworkSettings(kind="gru", network=_GRU, training=StreamTraining(updates=3000)),
        NetworkSettings(kind="gru", name=RESIDUAL, network=_GRU, training=StreamTraining(updates=1600, teacher=None)),
        s2_settings("gru", _GRU.model_copy(update=PLAIN)),
        s1_settings("gru", _GRU.model_copy(update=PLAIN)),
    ),
)
"""Two layers of 64 gated recurrent units, S2 section III-B; see `GruNet`."""

NETWORK_KINDS: tuple[NetworkKind, ...] = (LSTM, GRU)
