"""Samples of the loop of `hystmpc run` on an external clock. No ROS in here."""

from __future__ import annotations

from typing import final

from hystmpc.rig import Transport
from hystmpc.rig.config import BenchSettings
from hystmpc.rig.experiment.experiment import Steering
from hystmpc.rig.loop import ControlLoop, Reader
from hystmpc.rig.realtime import Clock
from hystmpc.rig.recording.sample import Sample
from hystmpc.rig.run import FirstContact, control_loop
from hystmpc.rig.safety.stop import StopFlag
from hystmpc.trials.errors import HystmpcError


@final
class Planner:
    """A controller at a device: it waits for contact, runs the loop, and stays stopped after any fault.

    Contact, gate, anchor, intake, plausibility and safe stop are those of `hystmpc run`. Before contact nothing is sent
    but greetings. A stop leads to the safe command, which is sent until `leave`, or rests in place without one; it is
    latched until `reset`, which waits for contact again.

    Args:
        settings: of the bench, of two axes where the controller has two; `safe_command` and limits are those of the
            controller.
    """

    def __init__(self, settings: BenchSettings, steering: Steering, transport: Transport, clock: Clock) -> None:
        self.tip, self._steering = steering.tip, steering
        self._settings, self._transport, self._clock = settings, transport, clock
        self._leaves = False
        steering.watch(settings.plausibility)
        self._wait()

    def _wait(self) -> None:
        self._flag, self._loop = StopFlag(), None
        self._contact = FirstContact(self._settings, self._transport)
        self._reader = Reader(self._transport, self._clock, round(1e9 * self._settings.dt_s))
        self._newest: Sample | None = None
        self._over = False
        self.status = "waits for the device"

    def reset(self) -> None:
        """Release the stop and wait for contact; the target is then the angle of that moment."""
        self.tip.reset()
        self._wait()

    def stop(self, cause: str) -> None:
        """Stop safely, and latch it."""
        self.tip.stop()
        self._flag.set(cause)

    def leave(self, cause: str) -> None:
        """Stop safely; nothing is sent any more once the safe command is held."""
        self._leaves = True
        self.stop(cause)

    def sample(self) -> None:
        """One sample; called once in `tip.dt` seconds. A call that comes late is a sample that ended late."""
        loop: ControlLoop | None = self._loop
        if loop is None:
            self._look_for_it()
        elif not self._over:
            self._over = not loop.sample(loop.due())
            if cause := loop.cause or self._flag.cause:
                self.tip.stop()
                self.status = cause if self._over else f"safe stop: {cause}"

    @property
    def over(self) -> bool:
        """Whether nothing is sent: there was no contact yet, or the stop has come to its end."""
        return self._loop is None or self._over

    @property
    def newest(self) -> Sample | None:
        """The last sample of the loop, None before the first."""
        return self._newest

    def put(self, sample: Sample) -> None:
        """Keep a sample of the loop."""
        self._newest, self.status = sample, sample.status

    def close(self) -> None:
        """Leave; a device that has reported that it holds the safe command gets a goodbye."""
        self._transport.stop(goodbye=self._over and self._loop is not None and self._loop.outcome().confirmed)

    def _look_for_it(self) -> None:
        for reading in self._reader.take().readings:
            if self.tip.state().stopped:
                continue
            try:
                contact = self._contact.judge(reading)
                if contact is None:
                    continue
                safe = self._steering.safe_command
                parts = self._settings, self._transport, self._clock, contact, self._flag, self
                frame = self._steering.frame
                loop = control_loop(*parts, safe=safe, stays=lambda: not self._leaves, closed_loop=True, frame=frame)
                loop.begin([self._steering])
            except HystmpcError as error:
                self._wait()
                self.status = f"cannot start: {error}"
                return
            self._loop, self.status = loop, "the device answers"
            return
