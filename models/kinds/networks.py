"""The kinds of model that are networks, and their trainings: as in S2 (Wu et al., RA-L 2024), as in S1 (Wu et al., RA-L
2021), and the best that we know.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, final

from hystmpc.trials.trial import Trial

from ..model import FitProgress
from ..networks.settings import FeedForwardSettings, GatedSettings, HybridSettings, NetworkForm, RecurrentSettings
from ..train.settings import (
    NetworkSettings,
    RestSettings,
    ScalingSettings,
    StreamTraining,
    TeacherSettings,
    WindowTraining,
)
from .kind import FitRequest, Identified, ModelKind

_PLAIN = {"memory_samples": 0, "command_gain": 1.0}  # PyTorch's own initial weights, as in the papers
_PLAIN_HEAD = _PLAIN | {"head_gain": 1.0}
_HISTORY = 50
_S2_WINDOWS = WindowTraining(keep_after=10, padding_samples=50)
_S1_WINDOWS = WindowTraining(epochs=50, padding_samples=49)


def _s2(
    kind: str, network: NetworkForm, training: WindowTraining = _S2_WINDOWS, name: str = "paper"
) -> NetworkSettings:
    """S2 section III-D: windows of 50, Adam 1e-3, batch 16, at most 100 epochs, u/6 and theta/90, rest at 30 deg."""
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


def _s1(kind: str, network: NetworkForm, training: WindowTraining = _S1_WINDOWS) -> NetworkSettings:
    """S1 section II-C: windows of 50 padded on the left, ranges mapped to [-1, 1], 50 epochs over all samples.

    Optimiser, rate and batch stood in a table that is lost; those of S2 are taken.
    """
    return NetworkSettings(
        kind=kind, name="s1", network=network, warmup_samples=49, learning_rate=1e-3, training=training
    )


def _named(*settings: NetworkSettings) -> Mapping[str, NetworkSettings]:
    return MappingProxyType({each.name: each for each in settings})


_LSTM = RecurrentSettings()
_GRU = RecurrentSettings(cell="gru")
_FNN = FeedForwardSettings()
_HIB = FeedForwardSettings(history=_HISTORY)
_HB1 = HybridSettings(form="serial")
_HB2 = HybridSettings(form="parallel")
_SERIAL = _S2_WINDOWS.model_copy(update={"batch": 4})
_GATED_TRAINING = StreamTraining(
    streams=32,
    matrix_learning_rate=0.02,
    updates=1600,
    teacher=TeacherSettings(model="play_kernel", runs=32, centred=True),
)
RESIDUAL = "residual"
"""Training of a network of what operators leave: there is no model of plays to learn from beside the trials."""

_SINGLE = {"length": 1}  # a feed-forward network is scored on the last sample of its window

NETWORK_TRAININGS: Mapping[str, Mapping[str, NetworkSettings]] = MappingProxyType(
    {
        "fnn": _named(
            NetworkSettings(
                kind="fnn", network=_FNN, warmup_samples=0, training=StreamTraining(updates=1500, teacher=None)
            ),
            _s2("fnn", _FNN, _S2_WINDOWS.model_copy(update=_SINGLE)),
            _s1("fnn", _FNN, _S1_WINDOWS.model_copy(update=_SINGLE)),
        ),
        "fnn_hib": _named(
            NetworkSettings(
                kind="fnn_hib", network=_HIB, warmup_samples=_HISTORY - 1, training=StreamTraining(updates=6000)
            ),
            _s2("fnn_hib", _HIB, _S2_WINDOWS.model_copy(update=_SINGLE)),
            _s1("fnn_hib", _HIB, _S1_WINDOWS.model_copy(update=_SINGLE)),
        ),
        "lstm": _named(
            NetworkSettings(kind="lstm", network=GatedSettings(), learning_rate=0.01, training=_GATED_TRAINING),
            NetworkSettings(kind="lstm", name="stacked", network=_LSTM),
            NetworkSettings(
                kind="lstm",
                name=RESIDUAL,
                network=GatedSettings(),
                learning_rate=0.01,
                training=_GATED_TRAINING.model_copy(update={"teacher": None}),
            ),
            _s2("lstm", _LSTM.model_copy(update=_PLAIN)),
            _s1("lstm", _LSTM.model_copy(update=_PLAIN)),
        ),
        "gru": _named(
            NetworkSettings(kind="gru", network=_GRU, training=StreamTraining(updates=3000)),
            NetworkSettings(
                kind="gru", name=RESIDUAL, network=_GRU, training=StreamTraining(updates=1600, teacher=None)
            ),
            _s2("gru", _GRU.model_copy(update=_PLAIN)),
            _s1("gru", _GRU.model_copy(update=_PLAIN)),
        ),
        "hb1": _named(
            NetworkSettings(kind="hb1", network=_HB1, training=StreamTraining(updates=4000)),
            _s2("hb1", _HB1.model_copy(update=_PLAIN_HEAD)),
            _s2("hb1", _HB1.model_copy(update=_PLAIN_HEAD), _SERIAL, "paper-batch-4"),
        ),
        "hb2": _named(
            NetworkSettings(kind="hb2", network=_HB2, training=StreamTraining(updates=4000)),
            _s2("hb2", _HB2.model_copy(update=_PLAIN_HEAD)),
        ),
    }
)
"""Settings by kind and training; the first training of a kind is its default."""


_WINDOW = 50  # S2's, over which its constancy term is taken


def network_settings(kind: str, request: FitRequest) -> NetworkSettings:
    """The settings of a training with what the request changes.

    A feed-forward network, which the papers train on single samples, is trained on windows where the constancy term
    is asked for.
    """
    chosen = NETWORK_TRAININGS[kind][request.training]
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
    return NetworkSettings.parse(dict(chosen) | changes, f"{kind}, training {request.training}")


class NetworkKind(ModelKind):
    """A kind that is a network, with trainings of `NETWORK_TRAININGS`; torch is loaded when one is trained."""

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None) -> Identified:
        from ..identify.estimation_noise import with_noise  # compiled code, which a list of kinds need not load
        from ..train.networks import fit_network, network_bundle

        self.check(trials, request)
        settings = network_settings(self.name, request)
        found = fit_network(trials, settings, progress, request.validation)
        judges = ", ".join(Path(source).name for source in found.held_out) or "the training trials"
        report = (
            f"weights of step {found.best_step} of {settings.steps}, judged by {judges} "
            f"({found.validation_rmse_deg:.4g} {trials[0].units.angle})"
        )
        history = tuple((look.step, look.validation_rmse_deg) for look in found.history)
        bundle = network_bundle(found, trials, request.limits)
        unseen = request.validation or [trial for trial in trials if trial.source in found.held_out]
        bundle = with_noise(bundle, unseen or trials, 0 if unseen else bundle.metadata.state_size)
        return Identified(bundle, None, history, report, found.interrupted)

    def steps(self, request: FitRequest) -> int:
        return network_settings(self.name, request).steps

    def estimate(self, trials: Sequence[Trial], request: FitRequest) -> float | None:
        from ..train.networks import training_seconds

        return training_seconds(trials, network_settings(self.name, request))


@final
class FnnKind(NetworkKind):
    """Two ReLU layers of 64 over the present command alone, S2 section III-B; see `FeedForwardNet`."""

    name = "fnn"
    title = "FNN"
    trainings = tuple(NETWORK_TRAININGS["fnn"])
    recurrent = False


@final
class FnnHibKind(NetworkKind):
    """Two ReLU layers of 64 over the last 50 commands, S2 section III-B; see `FeedForwardNet`."""

    name = "fnn_hib"
    title = "FNN-HIB"
    trainings = tuple(NETWORK_TRAININGS["fnn_hib"])


@final
class LstmKind(NetworkKind):
    """Cells over plays of the command, see `GatedLstmNet`; the papers' two layers of 64, see `LstmWeights`."""

    name = "lstm"
    title = "LSTM"
    trainings = tuple(NETWORK_TRAININGS["lstm"])
    inverse_training = "stacked"  # a gated state cannot jump across the loop, as the command does where the angle turns


@final
class GruKind(NetworkKind):
    """Two layers of 64 units, S2 section III-B; see `GruNet`."""

    name = "gru"
    title = "GRU"
    trainings = tuple(NETWORK_TRAININGS["gru"])


@final
class Hb1Kind(NetworkKind):
    """An LSTM that gives the four parameters of a backlash at every sample, S2 eq. (6); see `SerialNet`."""

    name = "hb1"
    title = "HB1"
    trainings = tuple(NETWORK_TRAININGS["hb1"])


@final
class Hb2Kind(NetworkKind):
    """A backlash fitted beforehand and an LSTM that adds what it leaves, S2 eq. (7); see `ParallelNet`."""

    name = "hb2"
    title = "HB2"
    trainings = tuple(NETWORK_TRAININGS["hb2"])


NETWORK_KINDS: tuple[NetworkKind, ...] = (FnnKind(), FnnHibKind(), LstmKind(), GruKind(), Hb1Kind(), Hb2Kind())
