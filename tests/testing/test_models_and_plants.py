"""The contracts of models, kinds of model and plants: kept by those of the package, and not by broken ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from hystmpc.ctrl.loop import Plant
from hystmpc.models.identify.chain_kinds import FRICTION_KINDS
from hystmpc.models.kinds.catalogue import all_kinds, kind_named
from hystmpc.models.kinds.kind import FitRequest, Identified, ModelKind
from hystmpc.models.load import load_model
from hystmpc.models.model import Model
from hystmpc.sim.config import PlantSettings
from hystmpc.sim.devices.names import DEVICES
from hystmpc.sim.plants.device import make_plant
from hystmpc.testing import KindContract, ModelContract, PlantContract
from hystmpc.trials.types import Vec

BUILTIN = ("builtin:backlash", "builtin:pi", "builtin:auto", "builtin:tendon-catheter", "builtin:lstm")
# Of the others fits take long, or they are of another device: a resonance, a force that leads its displacement.
QUICK = [kind.name for kind in all_kinds() if kind.readable and not kind.rings and kind.name not in FRICTION_KINDS]
QUICK = [name for name in QUICK if name != "auto"]


def laws(contract: type) -> list[str]:
    return [name for name in dir(contract) if name.startswith("test_")]


def keeps(contract: Any) -> None:
    for law in laws(type(contract)):
        getattr(contract, law)()


def broken(contract: Any) -> set[str]:
    """The laws that fail."""
    found = set()
    for law in laws(type(contract)):
        try:
            getattr(contract, law)()
        except AssertionError:
            found.add(law)
    return found


@pytest.mark.parametrize("name", BUILTIN)
def test_every_model_of_the_library_keeps_the_contract(name: str) -> None:
    if name == "builtin:lstm":
        pytest.importorskip("onnxruntime")

    class Own(ModelContract):
        creeps = name in ("builtin:tendon-catheter", "builtin:auto", "builtin:lstm")

        def model(self) -> Model:
            return load_model(name)

    keeps(Own())


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_every_quick_kind_keeps_the_contract(name: str) -> None:
    class Own(KindContract):
        kind = kind_named(name)

    keeps(Own())


@pytest.mark.parametrize("device", ["", *DEVICES])
def test_every_simulated_device_keeps_the_contract(device: str) -> None:
    block = {"device": device} if device else {"simulator": "builtin:tendon-catheter"}

    class Own(PlantContract):
        high = 3.0

        def plant(self) -> Plant:
            return make_plant(PlantSettings.parse({**block, "noise_deg": 0.0}), 0.04)

    keeps(Own())


@dataclass
class Line:
    """A straight line with a memory of its own, where it is broken."""

    dt: float = 0.04
    nx: int = 2
    nu: int = 1
    wrong: str = ""
    steps: int = 0

    def initial(self, y: Vec) -> Vec:
        return np.hstack([y, y + (self.wrong == "start")])

    def step(self, x: Vec, u: Vec) -> Vec:
        self.steps += 1
        slope = 10.0 + (0.1 * self.steps if self.wrong == "memory" else 0.0)
        if self.wrong == "batch":
            u = u + 0.01 * u.shape[0]
        if self.wrong == "writes":
            x += 1.0
        creep = x[:, :1] + 0.05 if self.wrong == "creeps" else slope * u
        return np.hstack([creep, np.full_like(u, np.nan) if self.wrong == "nan" else creep])

    def output(self, x: Vec) -> Vec:
        return x[:, 1:]


BREAKS = {
    "start": "test_it_starts_at_the_measured_angle",
    "memory": "test_a_step_leaves_the_state_alone_and_repeats_itself",
    "writes": "test_a_step_leaves_the_state_alone_and_repeats_itself",
    "batch": "test_a_batch_is_its_rows",
    "nan": "test_every_command_gives_an_angle_and_some_give_others",
    "creeps": "test_it_rests_while_the_command_does",
}


@pytest.mark.parametrize("wrong", ["", *BREAKS])
def test_a_broken_model_is_caught_by_its_law(wrong: str) -> None:
    class Own(ModelContract):
        def model(self) -> Model:
            return Line(wrong=wrong)

    found = broken(Own())
    assert BREAKS[wrong] in found if wrong else not found


class Careless(ModelKind):
    """A kind that takes what it cannot fit."""

    name, title = "careless", "careless"

    def fit(self, trials: Any, request: FitRequest, progress: Any = None) -> Identified:
        del request, progress
        return kind_named("backlash").fit(trials or KindContract()._trials, FitRequest())

    def steps(self, request: FitRequest) -> int | None:
        del request
        return None


def test_a_kind_that_takes_anything_is_caught() -> None:
    class Own(KindContract):
        kind = Careless()

    assert broken(Own()) == {"test_what_cannot_be_fitted_is_refused_in_one_line"}


@dataclass
class Device:
    """A line behind a wire, where it is broken."""

    wrong: str = ""
    dt: float = 0.04
    held: float = 0.0
    stopped: bool = False

    def reset(self) -> float:
        if self.wrong != "keeps":
            self.held = 0.0
        return 10.0 * self.held

    def apply(self, u: float) -> float:
        self.held = u if self.wrong != "dead" else 0.0
        return float("nan") if self.wrong == "nan" and u > 5.0 else 10.0 * self.held

    def stop(self) -> None:
        if self.wrong == "once" and self.stopped:
            raise AssertionError("stopped twice")
        self.stopped = True


DEVICE_BREAKS = {
    "keeps": "test_a_reset_finds_it_at_rest_and_the_same_each_time",
    "nan": "test_every_command_is_answered_by_a_finite_angle",
    "dead": "test_it_moves",
    "once": "test_stop_is_allowed_at_any_time_and_twice",
}


@pytest.mark.parametrize("wrong", ["", *DEVICE_BREAKS])
def test_a_broken_plant_is_caught_by_its_law(wrong: str) -> None:
    class Own(PlantContract):
        def plant(self) -> Plant:
            return Device(wrong)

    found = broken(Own())
    assert DEVICE_BREAKS[wrong] in found if wrong else not found
