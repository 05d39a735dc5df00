"""Every kind of model identified in a second, in both directions: networks of a few cells, a few updates."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import pytest

from hystmpc.models.chain import Chain
from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import OnnxModel, load_onnx
from hystmpc.models.kinds.catalogue import all_kinds, kind_named
from hystmpc.models.kinds.connected import DrivenKind
from hystmpc.models.kinds.kind import FitRequest, Identified, ModelKind
from hystmpc.models.kinds.networks import NetworkKind
from hystmpc.models.networks.settings import NetworkSettings, StreamTraining
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.trials.trial import Trial
from hystmpc_lab.rivals.kinds import FeedForwardSettings

from ..shared import shared
from .lstm_examples import four_trials
from .zoo import BACKLASH, DT, simulator

NETWORKS = {kind.name: kind for kind in all_kinds() if isinstance(kind, NetworkKind)}
FORWARD, INVERSE = "forward", "inverse"
STREAMS = StreamTraining(length=25, streams=4, updates=30, rounds_between_checks=1, averaging=0.5, teacher=None)


def tiny(settings: NetworkSettings, **changes: object) -> NetworkSettings:
    """The same network with a few cells and a few updates."""
    sizes: dict[str, object] = {"hidden": (6,) if isinstance(settings.network, FeedForwardSettings) else 6}
    if hasattr(settings.network, "layers"):
        sizes["layers"] = 1
    if getattr(settings.network, "history", 1) > 1:
        sizes["history"] = 5
    network = settings.network.model_copy(update=sizes)
    return settings.model_copy(update={"network": network, "warmup_samples": 4, "training": STREAMS} | changes)


def tiny_trainings(patch: pytest.MonkeyPatch, **changes: object) -> None:
    """Put tiny networks in the place of the trainings `best`."""
    for kind in NETWORKS.values():
        patch.setattr(kind, "settings", {**kind.settings, "best": tiny(kind.settings["best"], **changes)})


@dataclass(frozen=True)
class Example:
    """One kind, identified in one direction, exported and loaded."""

    trials: list[Trial]
    found: Identified
    path: Path
    model: OnnxModel


BEHIND = " behind a drive"
DEVICE = simulator(Chain(BACKLASH, before=(Delay(1.5 * DT, 2), Lag(0.1))))


def kind_of(name: str) -> ModelKind:
    """The kind of that name, or that kind behind the drive of a device."""
    plain = name.removesuffix(BEHIND)
    return kind_named(name) if plain == name else DrivenKind(kind_named(plain), DEVICE)


def trials_of(direction: str) -> list[Trial]:
    """Four trials, swapped for an inverse map."""
    return [t.swapped() for t in four_trials()] if direction == INVERSE else four_trials()


@lru_cache
def folder() -> tempfile.TemporaryDirectory[str]:
    """Where the examples' files lie until the session ends."""
    return tempfile.TemporaryDirectory()


def identified(name: str, direction: str) -> Identified:
    """Identify a tiny one."""
    kind = kind_of(name)
    with pytest.MonkeyPatch.context() as patch:
        tiny_trainings(patch)
        steps = 3 if kind.readable else 30  # an operator's count for each of its starts
        return kind.fit(trials_of(direction), replace(FitRequest(training=kind.trainings[0]), steps=steps))


@lru_cache
def example(name: str, direction: str) -> Example:
    """Identify once, whichever test asks first; `auto` is the device of test_auto, whose search takes its time."""
    trials = trials_of(direction)
    if name == "auto":
        from . import test_auto as auto

        trials, found = auto.trials_of((), auto.PAIR)[::-1], auto.identified((), auto.PAIR)
    else:
        found = shared(f"tiny {name} {direction}", lambda: identified(name, direction))
    path = Path(folder().name) / f"{name}_{direction}.onnx".replace(" ", "_")
    export_onnx(found.bundle, path)
    return Example(trials, found, path, load_onnx(path))
