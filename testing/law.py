"""Contract tests of control laws, on which the closed loop relies."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hystmpc.ctrl.build import build_controller, pair_for
from hystmpc.ctrl.command import CommandLimits, Source, limits_of_model
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.law import LawSettings
from hystmpc.ctrl.planner.reach import angles_at_rest
from hystmpc.models.load import load_model, model_path
from hystmpc.models.prediction.build import ControllerModel, controller_model
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from .wire import require

_STEPS = 200


@dataclass(frozen=True, eq=False)
class KnownDevice:
    """Simulated device whose model the control law knows exactly; angles at its limits [deg]."""

    known: ControllerModel
    limits: CommandLimits
    low_deg: float
    high_deg: float

    @property
    def middle_deg(self) -> float:
        """Angle in the middle of the range [deg]."""
        return 0.5 * (self.low_deg + self.high_deg)


@dataclass(frozen=True, eq=False)
class LawRun:
    """Closed-loop run: angles (T,) [deg], commands (T,) and their sources; state and angle at the end."""

    angles: Vec
    commands: Vec
    sources: list[Source]
    state: Any
    y: float


class ControllerContract(ABC):
    """Contract tests of a control law: derive a class whose name begins with `Test`, give it `settings`, run pytest.


    Attributes:
        model: model of the device: a simulator (.yaml), an exported model (.onnx), or `builtin:NAME`.
        settled_deg: greatest error at the end of a hold of eight seconds [deg].
    """

    model: str = "builtin:pi"
    settled_deg: float = 1.0

    @abstractmethod
    def settings(self) -> LawSettings:
        """Settings of the controller under test."""

    def test_its_settings_are_read_as_they_are_written(self) -> None:
        """Settings written to a file and read back are equal, and unknown keys are refused."""
        settings = self.settings()
        second = type(settings).parse(settings.model_dump(mode="json"))
        require(second == settings, f"written {settings}, read {second}")
        try:
            type(settings).parse({"no_such_key": 1})
        except ConfigError:
            return
        require(False, "a key that does not exist is taken")

    def test_it_comes_to_rest(self) -> None:
        """Late in a hold the command moves by less than a hundredth of its range, without a limit cycle."""
        commands = self._follow(np.full(_STEPS, self._device.middle_deg)).commands[-_STEPS // 2 :]
        moved, limits = float(np.ptp(commands)), self._device.limits
        require(moved < 0.01 * (limits.upper - limits.lower), f"in a hold the command moves by {moved:.3g}")

    def test_it_settles_on_a_target_without_its_fallbacks(self) -> None:
        """From rest the controller settles in the middle of the range, without its fallbacks."""
        target = self._device.middle_deg
        run = self._follow(np.full(_STEPS, target))
        wrong = sorted({str(s) for s in run.sources} - {str(Source.CONTROLLER), str(Source.MPC)})
        require(not wrong, f"commands came from {', '.join(wrong)}: the law failed")
        off = float(np.max(np.abs(run.angles[-20:] - target)))
        require(off <= self.settled_deg, f"{off:.2f} deg off at the end of the hold, at most {self.settled_deg} deg")

    def test_the_same_state_gives_the_same_command(self) -> None:
        """The command depends on the given state alone."""
        controller, run = self._controller, self._follow(np.full(_STEPS, self._device.middle_deg))
        wanted = np.full(controller.horizon, self._device.middle_deg + 0.3)
        first = controller.step(run.state, run.y, wanted)[0].u
        controller.step(run.state, run.y + 5.0, wanted + 3.0)
        second = controller.step(run.state, run.y, wanted)[0].u
        require(first == second, f"the same state gives {first} and then {second}")

    def test_nothing_brings_it_beyond_the_limits(self) -> None:
        """Commands stay finite, within range and rate, for any measurement and reference."""
        controller, limits = self._controller, self._device.limits
        random = np.random.default_rng(3)
        state, last = controller.init(self._device.low_deg, limits.lower), limits.lower
        odd = [math.nan, math.inf, -math.inf, 1e9, -1e9, 0.0]
        for k in range(_STEPS):
            y = (
                odd[k % len(odd)]
                if random.random() < 0.3
                else float(random.uniform(self._device.low_deg, self._device.high_deg))
            )
            reference = np.full(controller.horizon, float(random.uniform(-200.0, 300.0)))
            if random.random() < 0.1:
                reference[:] = odd[k % len(odd)]
            command, state = controller.step(state, y, reference)
            step = abs(command.u - last)
            require(math.isfinite(command.u), f"command {command.u}")
            require(limits.lower <= command.u <= limits.upper, f"command {command.u} beyond {limits}")
            require(step <= limits.rate * controller.dt * (1 + 1e-9), f"the command moves by {step} in a sample")
            last = command.u

    def test_it_goes_on_after_missing_measurements(self) -> None:
        """The controller settles on the target after five samples without a measurement."""
        target = self._device.middle_deg
        angles = self._follow(np.full(_STEPS, target), missing=range(20, 25)).angles
        off = float(np.max(np.abs(angles[-20:] - target)))
        require(off <= self.settled_deg, f"{off:.2f} deg off after a gap, at most {self.settled_deg} deg")

    @cached_property
    def _device(self) -> KnownDevice:
        opened = load_model(model_path(self.model), start="conditioned")
        known, limits = controller_model(opened), limits_of_model(opened.metadata)
        low, high = angles_at_rest(known.predictive[0], limits, opened.metadata.trained_angle.lower)
        return KnownDevice(known, limits, low, high)

    @cached_property
    def _controller(self) -> GuardedController:
        settings = self.settings()
        return build_controller(settings, *pair_for(settings, self._device.known), self._device.limits)

    def _follow(self, reference: Vec, missing: range = range(0)) -> LawRun:
        plant, controller, y = self._device.known.predictive[0], self._controller, self._device.low_deg
        device = plant.initial(y, self._device.limits.lower)
        state = controller.init(y, self._device.limits.lower)
        angles, commands, sources = np.empty(reference.size), np.empty(reference.size), []
        for k in range(reference.size):
            ahead = np.full(controller.horizon, reference[k])
            command, state = controller.step(state, math.nan if k in missing else y, ahead)
            y, device = plant.advance(device, command.u)
            angles[k], commands[k] = y, command.u
            sources.append(command.source)
        return LawRun(angles, commands, sources, state, y)
