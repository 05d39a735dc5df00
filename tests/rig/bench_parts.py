"""Parts that the tests of the rig share: a clock that obeys, a transport with a script, a list as a sink."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from hystmpc.ctrl.limits import CommandLimits
from hystmpc.rig.gate import Gate
from hystmpc.rig.intake import Intake, SensorSettings
from hystmpc.rig.loop import ControlLoop
from hystmpc.rig.outcome import Outcome
from hystmpc.rig.phases.motion import CommandMotion, SafeStop
from hystmpc.rig.phases.phase import Phase
from hystmpc.rig.ramp import RampSettings, ramp_commands, way_commands
from hystmpc.rig.sample import Sample
from hystmpc.rig.stop_flag import StopFlag
from hystmpc.rig.transports.reading import Reading

DT = 0.04
LIMITS = CommandLimits(0.0, 6.0, 10.0)
SENSOR = SensorSettings(lower_deg=0.0, upper_deg=120.0)
RAMPS = RampSettings()
NS = 1_000_000_000


@dataclass
class FakeClock:
    """Time that stands still but for waits and what is added to it."""

    ns: int = 7 * NS
    wall: int = 1_700_000_000 * NS

    def now_ns(self) -> int:
        return self.ns

    def wall_ns(self) -> int:
        return self.wall + self.ns

    def wait_until(self, deadline_ns: int) -> None:
        self.ns = max(self.ns, deadline_ns)


# What a device does in sample k: an angle, None for nothing, or an exception to raise.
Script = Callable[[int, float], float | None]


@dataclass
class ScriptedTransport:
    """A device whose angle is a function of sample and command; remembers every command."""

    clock: FakeClock
    script: Script
    sent: list[float] = field(default_factory=list)
    costs_ns: Mapping[int, int] = field(default_factory=dict)
    stopped: int = 0
    _k: int = -1
    _asked: int = -1

    @property
    def counters(self) -> Mapping[str, int]:
        return {}

    def read(self) -> Reading | None:
        k = len(self.sent)
        if self._asked == k:
            return None
        self._asked = k
        angle = self.script(k, self.sent[-1] if self.sent else 0.0)
        return None if angle is None else Reading(angle, k, 1, self.clock.ns, self.clock.ns, math.nan)

    def write(self, command: float) -> None:
        self.clock.ns += self.costs_ns.get(len(self.sent), 0)
        self.sent.append(command)

    def stop(self) -> None:
        self.stopped += 1


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

    def __post_init__(self) -> None:
        self.clock, self.flag, self.sink = FakeClock(), StopFlag(), ListSink()
        self.transport = ScriptedTransport(self.clock, self.script, costs_ns=self.costs_ns)
        self.gate = Gate(LIMITS, DT, self.held)
        self.intake = Intake(self.sensor, self.clock.ns)

    def run(self, phases: Sequence[Phase]) -> Outcome:
        def stop(cause: str, velocity: float) -> SafeStop:
            return SafeStop(lambda held: ramp_commands(held, velocity, self.safe, RAMPS, DT), self.safe, cause)

        self.loop = ControlLoop(
            self.clock, self.transport, self.intake, self.gate, DT, self.sink, stop, self.flag, stall_s=0.5
        )
        return self.loop.run(phases)


def travel(to: float = 3.0, hold_s: float = 1.0) -> CommandMotion:
    """A ramp to a command and back to 0, with rests."""
    return CommandMotion("travel", lambda held: way_commands(held, [to, 0.0], [hold_s, hold_s], RAMPS, DT))


def following(k: int, command: float) -> float:
    """An angle that follows the command, never twice the same."""
    return 30.0 + 10.0 * command + 1e-6 * k
