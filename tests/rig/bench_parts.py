"""Parts that the tests of the rig share: a clock that obeys, a transport with a script, a list as a sink."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from hystmpc.ctrl.command import CommandLimits
from hystmpc.rig.experiment.phases import CommandMotion, Phase, SafeStop
from hystmpc.rig.loop import ControlLoop, RunOutcome
from hystmpc.rig.recording.sample import Sample
from hystmpc.rig.safety.gate import Anchor, Gate
from hystmpc.rig.safety.intake import Intake, SensorSettings
from hystmpc.rig.safety.plausibility import MotionWatch, PlausibilitySettings
from hystmpc.rig.safety.ramp import RampSettings, stop_commands, waypoint_commands
from hystmpc.rig.safety.stop import StopFlag
from hystmpc.rig.transports.transport import Reading, Transport

DT = 0.04
LIMITS = CommandLimits(0.0, 6.0, 10.0)
SENSOR = SensorSettings(lower_deg=0.0, upper_deg=120.0)
RAMPS = RampSettings()
OVERSHOOT = 0.12
BLIND = PlausibilitySettings(watch_motion=False)
WATCHDOG_S, RETURN_PER_S = 0.5, 2.0
NS = 1_000_000_000


@dataclass
class FakeClock:
    """Time that stands still but for waits and what is added to it."""

    ns: int = 7 * NS
    wall: int = 1_700_000_000 * NS
    suspended: int = 0

    def now_ns(self) -> int:
        return self.ns

    def boot_ns(self) -> int:
        return self.ns + self.suspended

    def wall_ns(self) -> int:
        return self.wall + self.ns

    def wait_until(self, deadline_ns: int) -> None:
        self.ns = max(self.ns, deadline_ns)


# What a device does in sample k: an angle, None for nothing, or an exception to raise.
Script = Callable[[int, float], float | None]


@dataclass
class ScriptedTransport(Transport):
    """A device whose angle is a function of the count of commands and of the one it holds; remembers every command.

    With `watchdog` it returns to 0 by itself after half a second without a command, and then wants a new greeting.
    """

    clock: FakeClock
    script: Script
    sent: list[float] = field(default_factory=list)
    costs_ns: Mapping[int, int] = field(default_factory=dict)
    tells: bool = True
    held: float = 0.0
    watchdog: bool = False
    fails: Callable[[int], bool] = lambda k: False
    history: list[tuple[int, float]] = field(default_factory=list)
    stopped: int = 0
    goodbyes: int = 0
    greeted: int = 0
    _read_ns: int = -NS
    _sequence: int = 0
    _writes: int = 0
    _written_ns: int | None = None
    _lived_ns: int = 0
    _deaf: bool = False

    @property
    def counters(self) -> Mapping[str, int]:
        return {}

    def read(self) -> Reading | None:
        self._live()
        if self.clock.ns - self._read_ns < 0.5 * DT * NS:
            return None
        self._read_ns, self._sequence = self.clock.ns, self._sequence + 1
        angle = self.script(len(self.sent), self.held)
        held = self.held if self.tells else math.nan
        return None if angle is None else Reading(angle, self._sequence, 1, self.clock.ns, self.clock.ns, held)

    def write(self, command: float) -> None:
        self._writes += 1
        if self.fails(self._writes):
            raise OSError("no buffer space")
        self.clock.ns += self.costs_ns.get(len(self.sent), 0)
        self._live()
        self.sent.append(command)
        if not self._deaf:
            self.held, self._written_ns = command, self.clock.ns
            self.history.append((self.clock.ns, command))

    def greet(self) -> None:
        self.greeted += 1
        self._deaf = False

    def rest(self) -> float:
        """What the device holds when nobody has said anything for a long time."""
        self.clock.ns += 10 * NS
        self._live()
        return self.held

    def _live(self) -> None:
        """What the device has done by itself since it was looked at."""
        now = self.clock.ns + self.clock.suspended
        bites = None if self._written_ns is None else self._written_ns + round(WATCHDOG_S * NS)
        if self.watchdog and bites is not None and now > bites:
            self._deaf = self._deaf or self._lived_ns <= bites
            moved = RETURN_PER_S * 1e-9 * (now - max(bites, self._lived_ns))
            self.held = max(0.0, self.held - moved)
            self.history.append((now, self.held))
        self._lived_ns = now

    def stop(self, goodbye: bool = False) -> None:
        self.stopped += 1
        self.goodbyes += goodbye


@dataclass
class ListSink:
    """Keeps every sample."""

    samples: list[Sample] = field(default_factory=list)
    closed: bool = False

    def put(self, sample: Sample) -> None:
        self.samples.append(sample)

    def close(self) -> None:
        self.closed = True


@dataclass
class Rig:
    """A loop on a fake clock, and everything around it."""

    script: Script
    held: float = 0.0
    safe: float = 0.0
    sensor: SensorSettings = SENSOR
    costs_ns: Mapping[int, int] = field(default_factory=dict)
    tells: bool = True
    watchdog: bool = False
    fails: Callable[[int], bool] = lambda k: False
    plausibility: PlausibilitySettings = BLIND
    stall_s: float = 0.5

    def __post_init__(self) -> None:
        self.clock, self.flag, self.sink = FakeClock(), StopFlag(), ListSink()
        self.transport = ScriptedTransport(
            self.clock,
            self.script,
            costs_ns=self.costs_ns,
            tells=self.tells,
            held=self.held,
            watchdog=self.watchdog,
            fails=self.fails,
        )
        self.gate = Gate(LIMITS, DT)
        if not self.tells:
            self.gate.anchor(self.held)
        watch = MotionWatch(self.plausibility, LIMITS.upper - LIMITS.lower, SENSOR.upper_deg - SENSOR.lower_deg)
        self.intake = Intake(self.sensor, self.clock.ns, watch)
        self.anchor = Anchor(self.gate, 0.1, 3 * DT, 0.5, self.safe, 0.5)

    def run(self, phases: Sequence[Phase]) -> RunOutcome:
        return self.loop_of().run(phases)

    def loop_of(self) -> ControlLoop:
        """The loop of these parts."""

        def to_safe(cause: str) -> SafeStop:
            return SafeStop(
                lambda held, velocity: stop_commands(held, velocity, self.safe, RAMPS, OVERSHOOT, DT),
                self.safe,
                0.1,
                cause,
            )

        parts = self.clock, self.transport, self.intake, self.gate, self.anchor
        self.loop = ControlLoop(*parts, DT, self.sink, to_safe, self.flag, self.stall_s)
        return self.loop


def travel(to: float = 3.0, hold_s: float = 1.0) -> CommandMotion:
    """A ramp to a command and back to 0, with rests."""
    return CommandMotion("travel", lambda held: waypoint_commands(held, [to, 0.0], [hold_s, hold_s], RAMPS, DT))


def following(k: int, command: float) -> float:
    """An angle that follows the command, never twice the same."""
    return 30.0 + 10.0 * command + 1e-6 * k
