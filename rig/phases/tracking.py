"""The phase in which a controller follows a reference."""

from __future__ import annotations

import math
from collections.abc import Callable
from threading import Thread
from typing import final

from hystmpc.ctrl.command import Command, Source
from hystmpc.ctrl.tip_controller import TipController
from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.types import Vec

from ..plausibility import ModelWatch
from .phase import Decision, Now, Past
from .timely import TimelyLaw

# Where the reference starts: measured angle [deg] to a trajectory that leads in to it.
LeadIn = Callable[[float], Trajectory]


@final
class Tracking:
    """A `TipController` along a reference, from where preparation has left the device.

    The controller takes up what was sent and measured so far, hysteresis included. That takes longer than a sample, so
    it is done beside the loop while the command is held. A sample that follows a missed deadline is answered from
    the ladder (shifted plan, inverse, hold); samples in which nothing was sent are told to the controller as holds.

    Args:
        tip: the controller.
        law: its law, to be told that there is no time.
        lead_in: measured angle to the reference to follow.
        watch: finds a model that the device does not obey.
        drill_s: from when until when the law is made to fail, as an exercise [s]; None for never.
    """

    name = "track"

    def __init__(
        self,
        tip: TipController,
        law: TimelyLaw,
        lead_in: LeadIn,
        watch: ModelWatch,
        drill_s: tuple[float, float] | None = None,
    ) -> None:
        self._tip, self._law, self._lead_in, self._watch, self._drill = tip, law, lead_in, watch, drill_s
        self._reference: Trajectory | None = None
        self._worker: Thread | None = None
        self._past: Past | None = None
        self._failure: Exception | None = None
        self._skip = False
        self._due_deg = math.nan
        self._k = 0

    def begin(self, now: Now, past: Past) -> None:
        """Take up what was done so far."""
        del now
        self._past = past

    def step(self, now: Now) -> Decision:
        """Hold while the hand-over lasts, then one step of the controller."""
        if self._waits(now):
            return Decision(now.held, "hold", "hand-over to the controller")
        if self._failure is not None:
            raise self._failure
        for _ in range(now.skipped):
            self._skip = True
            self._tip.step(math.nan)
        self._skip = False
        self._law.refusal = self._refusal(now)
        command = self._tip.step(now.angle_deg)
        self._k += 1 + now.skipped
        return self._decision(command)

    def _waits(self, now: Now) -> bool:
        """Whether the hand-over lasts; it starts with the first usable angle."""
        past = self._past
        if past is not None:
            past.commands.append(now.held)
            past.angles_deg.append(now.angle_deg)
            if math.isfinite(now.angle_deg):
                self._past = None
                self._worker = Thread(target=self._hand_over, args=(past,), name="hand-over", daemon=True)
                self._worker.start()
            return True
        return self._worker is not None and self._worker.is_alive()

    def _hand_over(self, past: Past) -> None:
        try:
            self._tip.replay(past.commands, past.angles_deg)
            self._reference = self._lead_in(past.angles_deg[-1])
            self._tip.set_reference(self._wanted)
        except Exception as error:  # noqa: BLE001 - raised again in the loop, which stops safely
            self._failure = error

    def _wanted(self, t: Vec) -> Vec:
        """The preview; refused for samples in which nothing was sent, so that the controller holds."""
        if self._skip:
            raise ValueError("sample skipped, command held")
        assert self._reference is not None
        angles = self._reference(t)
        self._due_deg = float(angles[0])
        return angles

    def _refusal(self, now: Now) -> str:
        if now.late or now.skipped:
            return "late: no time for a plan"
        t = self._k * self._tip.dt
        if self._drill is not None and self._drill[0] <= t < self._drill[1]:
            return "drill: solver made to fail"
        return ""

    def _decision(self, command: Command) -> Decision:
        reference = self._reference
        assert reference is not None
        t = self._k * self._tip.dt
        predicted = float(command.predicted[0]) if command.predicted.size else math.nan
        stages = (*command.timing.stages.items(), ("total", command.timing.total_s))
        stopped = command.source is Source.STOP
        return Decision(
            u=command.u,
            source=str(command.source),
            status=command.status,
            reference_deg=self._due_deg,
            predicted_deg=predicted,
            stages_s=stages,
            finished=t >= reference.duration_s,
            fault=f"controller {command.status}" if stopped else self._watch.judge(command.disturbance),
        )
