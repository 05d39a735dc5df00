"""One sample after another: judge what has come, step the controller, send. No ROS in here."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import final

from hystmpc.ctrl import TipController
from hystmpc.rig import Reading, Transport
from hystmpc.rig.safety.intake import Intake, Seen, SensorSettings
from hystmpc.trials.errors import ControllerError

_CONTACTS = 3  # plausible angles, with a command that stands still, before anything is sent
_SAME = 1e-6  # two commands that are one [mm or bar]
_REST = 2  # equal commands of a stop: it has come to its end


@final
class Planner:
    """A controller at a device: it waits for contact, runs, and stays stopped after a fault.

    Before contact nothing is sent but greetings. A device that no longer listens, a restarted one and a dead sensor
    latch the stop; `reset` begins anew with waiting for contact.

    Args:
        start_command: what the device holds, where it does not tell; NaN where it tells [mm or bar].
        safe_command: where a stop leads; NaN where it stays [mm or bar].
        clock: monotonic time now [ns].
    """

    def __init__(
        self,
        tip: TipController,
        transport: Transport,
        sensor: SensorSettings,
        start_command: float,
        safe_command: float,
        clock: Callable[[], int],
    ) -> None:
        self.tip, self.status = tip, ""
        self._transport, self._sensor, self._clock = transport, sensor, clock
        self._start_command, self._safe_command = start_command, safe_command
        self._wait()

    def _wait(self) -> None:
        self._intake = Intake(self._sensor, self._clock())
        self._running, self._contacts, self._resting = False, 0, 0
        self._held = self._told = self._sent = math.nan
        self.status = "waits for the device"

    def reset(self) -> None:
        """Release the stop and wait for contact; the target is then the angle of that moment."""
        self.tip.reset()
        self._wait()

    def sample(self) -> None:
        """One sample; called once in `tip.dt` seconds."""
        readings: list[Reading] = []
        while (reading := self._transport.read()) is not None:
            readings.append(reading)
        seen = self._intake.judge(readings, self._clock(), self._sent)
        if readings and not readings[-1].listens:
            self._not_heard()
        elif self._running:
            self._step(seen)
        else:
            self._contact(seen)

    @property
    def at_rest(self) -> bool:
        """Whether there is nothing to move any more: it never ran, or the stop has come to its end."""
        return not self._running or self._resting >= _REST

    @property
    def running(self) -> bool:
        """Whether commands are sent."""
        return self._running

    def close(self) -> None:
        """Leave; goodbye is said to a device that has told that it holds the safe command."""
        rests = self._running and self.at_rest
        self._transport.stop(goodbye=rests and abs(self._told - self._safe_command) <= _SAME)

    def _not_heard(self) -> None:
        """The device takes no commands of this session: ask for it, and stop what was under way."""
        self._contacts = 0
        if self._running:
            self._running = False
            self.tip.stop()
            self.status = "the device listens no more: the stop is latched"
        if not self.tip.state().stopped:
            self._transport.greet()

    def _contact(self, seen: Seen) -> None:
        if seen.dead:  # before the first command a silence is none
            self._intake, self._contacts = Intake(self._sensor, self._clock()), 0
            return
        if math.isnan(seen.angle_deg) or seen.faults or self.tip.state().stopped:
            return
        held = self._start_command if math.isnan(seen.held) else seen.held
        if math.isnan(held):
            self.status = "the device does not tell what it holds: start_command has to"
            return
        self._contacts = self._contacts + 1 if abs(held - self._held) <= _SAME else 1
        self._held = held
        if self._contacts < _CONTACTS:
            return
        try:
            self.tip.reset(seen.angle_deg, held)
        except ControllerError as error:
            self._contacts, self.status = 0, f"cannot start: {error}"
            return
        self._running, self._sent = True, held
        self._step(seen)

    def _step(self, seen: Seen) -> None:
        if seen.dead and not self.tip.state().stopped:
            self.tip.stop()
        if math.isfinite(seen.held):
            self._told = seen.held
        command = self.tip.step(seen.angle_deg)
        stopped = self.tip.state().stopped
        self._resting = self._resting + 1 if stopped and abs(command.u - self._sent) <= _SAME else 0
        self._sent = command.u
        self._transport.write(command.u)
        self.status = seen.dead or command.status
