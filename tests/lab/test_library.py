"""The laboratory's C files: one result at every level of vector instructions, an end for every number."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hystmpc.core.build import levels
from hystmpc.core.library import compiled, engine
from hystmpc.trials.types import Vec
from hystmpc_lab.devices import drawn, kernels, rod_solver
from hystmpc_lab.devices.drawn import OUTSIDE, DrawnDevice, DrawnPlant, draw_devices
from hystmpc_lab.devices.rod import RodCatheter, RodParameters
from hystmpc_lab.library import FOLDER

BEST = int(engine().level())
RUNNABLE = [level for level in levels() if level == "plain" or int(level[1:]) <= BEST]
DEVICES = (*draw_devices(4, 3, quick=True), *draw_devices(2, 3, True, OUTSIDE))
FAMILIES = pytest.mark.parametrize("device", DEVICES, ids=lambda device: device.family)


def moved(device: DrawnDevice, commands: Vec) -> tuple[Vec, Vec]:
    """Angles along the commands, and the state after them."""
    p = drawn.packed(device, device.delay_s)
    state, theta = drawn.at_rest(device, p)[1], np.empty(commands.size)
    kernels.run(p, state, commands, theta)
    return theta, state


@FAMILIES
@pytest.mark.parametrize("level", RUNNABLE)
def test_a_device_moves_alike_at_every_level(device: DrawnDevice, level: str, monkeypatch: pytest.MonkeyPatch) -> None:
    commands = 0.5 * device.limits.upper * (1 - np.cos(np.linspace(0, 7, 40)))
    expected = moved(device, commands)
    for module in (kernels, rod_solver):
        monkeypatch.setattr(module, "laboratory", lambda: compiled(FOLDER, level))
    for found, same in zip(moved(device, commands), expected, strict=True):
        np.testing.assert_array_equal(found, same)


@FAMILIES
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1e300])
def test_a_command_that_is_no_number_ends(device: DrawnDevice, wrong: float) -> None:
    theta, _ = moved(device, np.array([0.0, wrong, 0.0]))
    assert np.isfinite(theta[0])


@FAMILIES
def test_a_plan_does_not_change_the_state_it_starts_from(device: DrawnDevice) -> None:
    plant = DrawnPlant(device, 0)
    before, plans = plant.rest[1].copy(), np.full((2, 3), 0.3 * device.limits.upper)
    theta = np.empty(plans.shape)
    kernels.rollout(plant.packed, plant.rest[1], plans, theta)
    np.testing.assert_array_equal(plant.rest[1], before)
    np.testing.assert_array_equal(theta[0], theta[1])


def test_a_rod_of_more_contacts_than_there_is_room_for_does_nothing() -> None:
    rod = RodParameters()
    state, out = RodCatheter(rod).virgin(), np.full((3, 1), 7.0)
    numbers: Any = rod.numbers()._replace(shaft_contacts=60, segments=60)
    before = state.copy()
    packed = rod_solver.packed(numbers, rod.step_numbers(0.04))
    assert rod_solver.advance(state, np.ones(1), numbers, packed, 1, *out) == np.inf
    np.testing.assert_array_equal(state, before)
    assert np.all(out == 7.0)
