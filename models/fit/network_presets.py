"""Presets of every network: as in S2, as in S1, and the best that we know."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from ..networks.settings import FeedForwardSettings, HybridSettings, NetworkForm, RecurrentSettings
from .network_settings import (
    NetworkSettings,
    RestSettings,
    ScalingSettings,
    StreamTraining,
    TeacherSettings,
    WindowTraining,
)

_PLAIN = {"memory_samples": 0, "command_gain": 1.0}  # PyTorch's own initial weights, as in the papers
_PLAIN_HEAD = _PLAIN | {"head_gain": 1.0}
_HISTORY = 50
_S2_WINDOWS = WindowTraining(keep_after=10, padding_samples=50)
_S1_WINDOWS = WindowTraining(epochs=50, padding_samples=49)


def _s2(
    kind: str, network: NetworkForm, training: WindowTraining = _S2_WINDOWS, preset: str = "paper"
) -> NetworkSettings:
    """S2 section III-D: windows of 50, Adam 1e-3, batch 16, at most 100 epochs, u/6 and theta/90, rest at 30 deg."""
    return NetworkSettings(
        kind=kind,
        preset=preset,
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
        kind=kind, preset="s1", network=network, warmup_samples=49, learning_rate=1e-3, training=training
    )


def _named(*settings: NetworkSettings) -> Mapping[str, NetworkSettings]:
    return MappingProxyType({each.preset: each for each in settings})


_LSTM = RecurrentSettings()
_GRU = RecurrentSettings(cell="gru")
_FNN = FeedForwardSettings()
_HIB = FeedForwardSettings(history=_HISTORY)
_HB1 = HybridSettings(form="serial")
_HB2 = HybridSettings(form="parallel")
_SERIAL = _S2_WINDOWS.model_copy(update={"batch": 4})
# A device that saturates and has dead zones, such as the PAM catheter of S1, is no Prandtl-Ishlinskii operator.
_KERNEL_TEACHER = StreamTraining(teacher=TeacherSettings(model="play_kernel"))
_SINGLE = {"length": 1}  # a feed-forward network is scored on the last sample of its window

NETWORK_PRESETS: Mapping[str, Mapping[str, NetworkSettings]] = MappingProxyType(
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
            NetworkSettings(kind="lstm", network=_LSTM),
            NetworkSettings(kind="lstm", preset="kernel", network=_LSTM, training=_KERNEL_TEACHER),
            _s2("lstm", _LSTM.model_copy(update=_PLAIN)),
            _s1("lstm", _LSTM.model_copy(update=_PLAIN)),
        ),
        "gru": _named(
            NetworkSettings(kind="gru", network=_GRU, training=StreamTraining(updates=3000)),
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
"""Settings by kind and preset; the first preset of a kind is its default."""
