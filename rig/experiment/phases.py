"""Phases, the parts of a run: command motions, checks, the safe stop; and the preparation steps of the settings."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping, MutableSequence, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol, final

from pydantic import Field, model_validator

from hystmpc.trials.config import Count, NotNegative, Positive, Settings
from hystmpc.trials.types import Vec

from ..axes import PerAxis, each, is_known, is_near, rows_of
from ..safety.intake import ObservedFrame
from ..safety.ramp import RampSettings, ramp_commands, waypoint_commands

if TYPE_CHECKING:
    from ..compiled.loop import CompiledLoop
    from ..safety.stop import StopFlag


@dataclass(frozen=True, slots=True)
class PhaseInput:
    """Measurements and command state given to a phase in each sample."""

    angle_deg: PerAxis  # measured angle, NaN where none is usable [deg]
    held: PerAxis  # the command sent last, or the one that the device was found to hold
    late: bool = False  # whether the previous sample missed its deadline, so that there is no time for a plan
    skipped: int = 0  # whole samples since the previous one in which nothing was sent and the device held `held`
    reported: PerAxis = math.nan  # the command that the device says it holds, NaN where it does not tell
    velocity: PerAxis = 0.0  # of the command between the last two samples; 0 where the device is at rest [unit/s]
    frames: tuple[ObservedFrame, ...] = ()  # of an intermittent sensor, accepted since the last sample
    shown_deg: PerAxis = math.nan  # the newest angle that is not stale, believed or not; NaN where none came [deg]
    inputs: Mapping[str, float] = field(default_factory=dict)  # newest usable value of each measured input


@dataclass(frozen=True, slots=True)
class Decision:
    """Command and status that a phase returns for a sample."""

    u: PerAxis  # wanted command; the gate decides
    source: str  # as in `Sample`
    status: str = "ok"  # as in `Sample`
    reference_deg: PerAxis = math.nan  # wanted at the end of the sample, NaN without a reference [deg]
    predicted_deg: PerAxis = math.nan  # expected there, NaN without a model [deg]
    stages_s: tuple[tuple[str, float], ...] = ()  # name and time of stages
    finished: bool = False  # whether this was the phase's last sample
    fault: str = ""  # cause of a stop, empty without one


@dataclass(frozen=True, slots=True)
class Past:
    """Commands and angles of the run so far, as the start of a controller; copies of shape (T,), of two axes (T, 2)."""

    commands: list[PerAxis]
    angles_deg: list[PerAxis]

    def keep(self, now: PhaseInput, dt_s: float) -> None:
        """Append a sample; the angle of a frame is stored at the sample of its exposure, or at the first sample."""
        self.commands.append(now.held)
        self.angles_deg.append(math.nan if now.frames else now.angle_deg)
        place_frames(self.angles_deg, now.frames, dt_s)


REPEATS = 5
"""Least number of transmissions of the safe command at the end of a run."""

_ATTEMPTS = 5  # starts of the motion of a stop

REMEMBERED = 200_000
"""Samples of preparation that a controller can be told of."""


def place_frames(angles: MutableSequence[PerAxis], frames: Sequence[ObservedFrame], dt_s: float) -> None:
    """Write the angles of frames into the samples of their exposure; the last sample is the present one."""
    for frame in frames:
        angles[max(-1 - round(frame.age_s / dt_s), -len(angles))] = frame.angle_deg


class Phase(Protocol):
    """One part of a run. An exception in it leads to a safe stop and is reported."""

    name: str  # as logs show it

    @property
    def closed_loop(self) -> bool:
        """Whether a controller moves the device by feedback of its angle."""
        return False

    def begin(self, now: PhaseInput, past: Past) -> None:
        """Start the phase from rest at the held command."""
        ...

    def step(self, now: PhaseInput) -> Decision:
        """Execute one sample."""
        ...

    def compiled(self) -> CompiledLoop | None:
        """Compiled loop for the next samples; None if Python has to execute them."""
        return None

    def taken_in_c(self, flag: StopFlag) -> Generator[tuple[Any, Decision]]:
        """Execute samples in the compiled loop until the flag is set, and yield the decision of each."""
        del flag
        yield from ()


@final
class CommandMotion(Phase):
    """Open-loop motion: commands (N,), of two axes (N, 2), computed from the held command when the phase begins.

    Skipped samples delay the motion and leave out no command.
    """

    def __init__(self, name: str, commands: Callable[[PerAxis], Vec]) -> None:
        self.name, self._plan = name, commands
        self._commands: list[PerAxis] = []
        self._k = 0

    def begin(self, now: PhaseInput, past: Past) -> None:
        del past
        self._commands, self._k = rows_of(self._plan(now.held)), 0

    def step(self, now: PhaseInput) -> Decision:
        del now
        u = self._commands[self._k]
        self._k += 1
        return Decision(u, self.name, finished=self._k >= len(self._commands))


@final
class AwaitStart(Phase):
    """Phase that holds the command until a person starts the run; the commands keep the device's watchdog from acting.

    `started` is called once a sample.
    """

    name = "await start"

    def __init__(self, started: Callable[[], bool]) -> None:
        self._started = started

    def begin(self, now: PhaseInput, past: Past) -> None:
        del now, past

    def step(self, now: PhaseInput) -> Decision:
        started = self._started()
        return Decision(now.held, self.name, "ok" if started else "waits for Start", finished=started)


@final
class PretensionCheck(Phase):
    """Phase that ramps the command up and back and checks that the angle exists and moves with it.

    `commands` maps the held command to those (N,) of the way up, and of the way back. The bounds of the angle's motion
    [deg] are negative where more command means less angle.
    """

    name = "pretension check"

    def __init__(self, commands: Callable[[float], tuple[Vec, Vec]], least_deg: float, most_deg: float) -> None:
        self._plan, self._bounds = commands, (least_deg, most_deg)
        self._commands: list[float] = []
        self._k, self._top = 0, 0
        self._before = self._angle = math.nan

    def begin(self, now: PhaseInput, past: Past) -> None:
        """Compute the commands; the present angle counts as the angle at rest."""
        del past
        up, back = self._plan(now.held)
        self._commands, self._top, self._k = [*up.tolist(), *back.tolist()], up.size, 0
        self._before = self._angle = now.angle_deg

    def step(self, now: PhaseInput) -> Decision:
        if math.isfinite(now.angle_deg):
            self._angle = now.angle_deg
            self._before = self._angle if math.isnan(self._before) else self._before
        if self._k == self._top and (fault := self._verdict()):
            return Decision(now.held, self.name, fault, fault=fault)
        u = self._commands[self._k]
        self._k += 1
        return Decision(u, self.name, finished=self._k >= len(self._commands))

    def _verdict(self) -> str:
        moved, (least, most) = self._angle - self._before, self._bounds
        if least <= moved <= most:
            return ""
        return (
            f"pretension check: the angle moved {moved:.2f} deg, expected {least:g} to {most:g} deg: "
            "is the tendon slack, the sensor fixed, the sign right?"
        )


@final
class SafeStop(Phase):
    """Motion to rest at the safe command; it ends once the device reports that it holds that command.

    Every run ends with it: after its last phase, and after a stop. The safe command is sent five times at least, since
    a wire may lose some; to a device that does not report it, `patience` times. A device that follows none of five
    starts of the motion is left to its watchdog.

    Args:
        commands: held command and its velocity to the commands (N,), of two axes (N, 2), to send; where it fails, the
            safe command itself is wanted, and the gate lets the device there as fast as the limits allow.
        safe: the safe command; NaN rests where the motion ends, which is never confirmed, so that the device's watchdog
            stays armed.
        tolerance: greatest deviation of the reported command, in its unit.
        cause: of the stop; empty at the regular end of a run.
        stays: called where it could finish; True sends the safe command on.
    """

    def __init__(
        self,
        commands: Callable[[PerAxis, PerAxis], Vec],
        safe: PerAxis,
        tolerance: float,
        cause: str,
        patience: int = 25,
        stays: Callable[[], bool] = lambda: False,
    ) -> None:
        self._plan, self._safe, self._tolerance, self.cause = commands, safe, tolerance, cause
        self._end, self._stays = safe, stays
        self._patience, self._attempts = patience, _ATTEMPTS
        self.name = "stop" if cause else "return"
        self._status = f"safe stop: {cause}" if cause else "ok"
        self._commands: list[PerAxis] = []
        self._k, self._rested = 0, 0
        self.sent = self.confirmed = False

    def begin(self, now: PhaseInput, past: Past) -> None:
        """Compute the stop motion from the held command; never raises."""
        del past
        self._attempts -= 1
        try:
            self._commands = rows_of(self._plan(now.held, now.velocity))
        except Exception:  # noqa: BLE001 - a stop cannot fail: the gate's limits lead there as well
            self._commands = []
        if not is_known(self._safe):
            self._end = self._commands[-1] if self._commands else now.held
        self._k = self._rested = 0

    def step(self, now: PhaseInput) -> Decision:
        """Next command; finished once the safe command is held or no attempt is left."""
        if self._attempts < 0:
            return Decision(now.held, self.name, f"{self._status}; given up", finished=True)
        u = self._commands[self._k] if self._k < len(self._commands) else self._end
        self._k += 1
        self._rested += is_near(now.held, self._end, 1e-9 * (1 + max(map(abs, each(self._end)))))
        self.confirmed = is_near(now.reported, self._safe, self._tolerance)
        self.sent = self._k >= len(self._commands) and self._rested >= REPEATS
        there = self.sent and (self.confirmed or self._rested >= self._patience)
        return Decision(u, self.name, self._status, finished=there and not self._stays())


class MoveSettings(Settings):
    """Preparation step `step: move`: a ramp to a command.

    Attributes:
        to: command at the end [mm or bar].
    """

    step: Literal["move"]
    to: float

    def phase(self, ramps: RampSettings, dt_s: float) -> Phase:
        """Build the phase of this step."""
        return CommandMotion("move", lambda held: ramp_commands(held, 0.0, self.to, ramps, dt_s))


class FlexureSettings(Settings):
    """Preparation step `step: flexure`: to the upper command and back to the lower one, `cycles` times.

    S2 prescribes one cycle, whose data are discarded.

    Attributes:
        lower: command at the end [mm or bar].
        upper: command at the far point [mm or bar].
        cycles: number of repetitions.
        hold_s: rest at either point [s].
    """

    step: Literal["flexure"]
    lower: float
    upper: float
    cycles: Count = 1
    hold_s: NotNegative = 0.0

    def phase(self, ramps: RampSettings, dt_s: float) -> Phase:
        """Build the phase of this step."""
        stops = [self.upper, self.lower] * self.cycles
        holds = [self.hold_s] * len(stops)
        return CommandMotion("flexure", lambda held: waypoint_commands(held, stops, holds, ramps, dt_s))


class RelaxationSettings(Settings):
    """Preparation step `step: relaxation`: hold the command while creep decays.

    Attributes:
        duration_s: how long [s].
    """

    step: Literal["relaxation"]
    duration_s: Positive

    def phase(self, ramps: RampSettings, dt_s: float) -> Phase:
        """Build the phase of this step."""
        return CommandMotion("relaxation", lambda held: waypoint_commands(held, [held], [self.duration_s], ramps, dt_s))


class PretensionSettings(Settings):
    """Preparation step `step: pretension_check`: the angle has to be plausible and to move with the command.

    Attributes:
        by: how far the command goes, from where it is and back.
        hold_s: rest at the far end before the verdict.
        least_move_deg, most_move_deg: what the angle has to move, sign included.
    """

    step: Literal["pretension_check"]
    by: float
    hold_s: Positive = 0.5
    least_move_deg: float
    most_move_deg: float

    @model_validator(mode="after")
    def _ordered(self) -> PretensionSettings:
        if not self.least_move_deg < self.most_move_deg or self.by == 0:
            raise ValueError(
                f"got by {self.by}, least_move_deg {self.least_move_deg}, most_move_deg {self.most_move_deg}, expected "
                "by other than 0 and least < most"
            )
        return self

    def phase(self, ramps: RampSettings, dt_s: float) -> Phase:
        """Build the phase of this step."""
        return PretensionCheck(
            lambda held: (
                waypoint_commands(held, [held + self.by], [self.hold_s], ramps, dt_s),
                ramp_commands(held + self.by, 0.0, held, ramps, dt_s),
            ),
            self.least_move_deg,
            self.most_move_deg,
        )


PrepareStep = Annotated[
    MoveSettings | FlexureSettings | RelaxationSettings | PretensionSettings, Field(discriminator="step")
]
