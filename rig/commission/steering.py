"""Phase of a planner node: a controller that takes targets from outside while the loop runs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import final

from hystmpc.ctrl.config import sensor_fault
from hystmpc.ctrl.limits import CommandLimits
from hystmpc.ctrl.planner.assembly import assemble
from hystmpc.ctrl.planner.settings import read_settings
from hystmpc.ctrl.planner.tip_controller import TipController
from hystmpc.trials.errors import ConfigError

from ..safety.plausibility import PlausibilitySettings
from .experiment import LATE, Refusing, decided, make_timely, model_watch
from .phases import Decision, Past, Phase, PhaseInput


@final
class Steering(Phase):
    """A `TipController` that starts at rest where the device is found, and takes targets at any time, by any thread.

    It steps as `Tracking` does: samples in which nothing was sent are told as holds, a sample that begins late is
    answered by the fallbacks, and a device that leaves its model is a fault. It never ends by itself.

    Attributes:
        tip: the controller, for targets, its state and its stop.
        limits: of the command.
        unit: of the command, mm or bar.
        safe_command: where a stop leads; NaN where it stays.

    Raises:
        ConfigError: if the controller's file cannot be used or its controller wants no continuous sensor.
        HystmpcError: of any other kind, see `assemble`.
    """

    name = "steer"

    def __init__(self, config: Path | str) -> None:
        settings, folder = read_settings(config)
        self._settings = settings.controller
        if fault := sensor_fault(self._settings, "continuous"):
            raise ConfigError(f"{config}: controller.{fault}")
        assembly = assemble(settings, folder)
        controller, law = make_timely(assembly.controller)
        self._law: Refusing = law
        self.tip = TipController(assembly, settings, controller)
        self.limits: CommandLimits = assembly.limits
        self.unit = assembly.unit
        safe = self._settings.resolved().ladder.safe_command
        self.safe_command = math.nan if safe is None else safe
        self.watch(PlausibilitySettings())

    def watch(self, plausibility: PlausibilitySettings) -> None:
        """Restart the monitor of the model error with these settings."""
        self._plausibility = plausibility
        self._watch = model_watch(plausibility, self._settings, self.tip.dt)

    def begin(self, now: PhaseInput, past: Past) -> None:
        """Wait for the first usable angle."""
        del now, past
        self._started = False
        self.watch(self._plausibility)

    def step(self, now: PhaseInput) -> Decision:
        """Hold until there is an angle, then one step of the controller."""
        if not self._started:
            if math.isnan(now.angle_deg):
                return Decision(now.held, "hold", "waits for an angle")
            self.tip.reset(now.angle_deg, now.held)
            self._started = True
        else:
            for _ in range(now.skipped):
                self.tip.skip()
        self._law.refusal = LATE if now.late or now.skipped else ""
        command = self.tip.step(now.angle_deg)
        control = self.tip.snapshot().control
        return decided(command, math.nan if control is None else control.due, self._watch)
