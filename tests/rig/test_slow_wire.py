"""A wire that takes its time: commands keep leaving, or the run stops and the safe command is sent all the same."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hystmpc.rig.config import BenchSettings
from hystmpc.rig.experiment.phases import CommandMotion
from hystmpc.rig.loop import Reader, RunOutcome
from hystmpc.rig.run import control_loop, first_contact
from hystmpc.rig.safety.ramp import waypoint_commands
from hystmpc.rig.safety.stop import StopFlag
from hystmpc.rig.transports.transport import Reading, Transport

from .bench_parts import NS, RAMPS, FakeClock, ListSink
from .test_run import SETTINGS

MS = 1_000_000


@dataclass
class SlowWire(Transport):
    """A device at 10 deg per mm that measures at a rate of its own; each call takes a time of its own [ns].

    Readings queue up until they are read. At `rate_hz` 0 each call measures, so that there is always something. The
    times apply from the first command on, or to all calls where `always`.
    """

    clock: FakeClock
    rate_hz: float = 0.0
    read_ns: int = 0
    write_ns: int = 0
    greet_ns: int = 0
    always: bool = False
    held: float = 0.0
    sent: list[tuple[int, float]] = field(default_factory=list)
    ages_ns: list[int] = field(default_factory=list)
    from_ns: int = 0
    _waiting: deque[tuple[int, float, float]] = field(default_factory=deque)
    _made: int = 0
    _sequence: int = 0
    _began: int = -1

    @property
    def counters(self) -> Mapping[str, int]:
        return {}

    def _takes(self, ns: int) -> None:
        self.clock.ns += ns if self.always or (self.from_ns and self.clock.ns >= self.from_ns) else 10_000

    def _measure(self) -> None:
        """What the device has measured since it was looked at."""
        self._began = self.clock.ns if self._began < 0 else self._began
        while self.rate_hz and self._began + self._made * NS / self.rate_hz <= self.clock.ns:
            at = self._began + round(self._made * NS / self.rate_hz)
            self._waiting.append((at, 30.0 + 10.0 * self.held + 1e-6 * self._made, self.held))
            self._made += 1

    def read(self) -> Reading | None:
        self._measure()
        if self.rate_hz and not self._waiting:
            return None
        self._takes(self.read_ns or 2 * MS)
        self._sequence += 1
        at, angle, held = self.clock.ns, 30.0 + 10.0 * self.held + 1e-6 * self._sequence, self.held
        if self.rate_hz:
            at, angle, held = self._waiting.popleft()
        self.ages_ns.append(self.clock.ns - at)
        return Reading(angle, self._sequence, 1, at, self.clock.ns, held)

    def write(self, command: float) -> None:
        self._measure()
        self._takes(self.write_ns)
        self._measure()
        self.held = command
        self.sent.append((self.clock.ns, command))

    def greet(self) -> None:
        self._takes(self.greet_ns)

    def stop(self, goodbye: bool = False) -> None:
        del goodbye


def run(wire: SlowWire, rate_hz: float, to: float = 3.0, after_s: float = 1.0, **more: float) -> RunOutcome:
    """First contact, and a motion to a command with a long rest there, at a bench of this rate."""
    sensor = {"lower_deg": 0, "upper_deg": 120, **more}
    bench = BenchSettings.parse(
        SETTINGS | {"rate_hz": rate_hz, "sensor": sensor, "transport": {"kind": "udp"}, "connect_timeout_s": 20}
    )
    clock, flag, sink = wire.clock, StopFlag(), ListSink()
    contact = first_contact(bench, wire, clock, flag)
    clock.ns += NS  # the recording opens
    wire.from_ns = clock.ns + round(after_s * NS)
    loop = control_loop(bench, wire, clock, contact, flag, sink)
    work = CommandMotion("away", lambda held: waypoint_commands(held, [to], [4.0], RAMPS, bench.dt_s))
    outcome = loop.run([work], contact.newest.received_ns + round(0.5e9 * bench.dt_s))
    steps = [abs(b - a) for (_, a), (_, b) in pairwise([(0, 0.0), *wire.sent])]
    assert max(steps, default=0.0) <= 10.0 * bench.dt_s + 1e-9
    return outcome


def gaps_s(wire: SlowWire, outcome: RunOutcome) -> float:
    """Longest time between two commands [s]."""
    del outcome
    return 1e-9 * max(b - a for (a, _), (b, _) in pairwise(wire.sent))


@given(
    rate_hz=st.sampled_from([25.0, 50.0, 100.0]),
    read_ms=st.floats(0.1, 95.0),
    write_ms=st.floats(0.0, 30.0),
    measures_hz=st.sampled_from([0.0, 25.0, 100.0, 1000.0]),
)
@settings(max_examples=12, deadline=None)
def test_commands_keep_leaving_or_the_run_stops_and_ends_at_the_safe_command(
    rate_hz: float, read_ms: float, write_ms: float, measures_hz: float
) -> None:
    """Any time of a read and of a write, at any rate of the loop and of the device, with and without a queue.

    Where both together are a gap (0.1 s) and all that is told is long past, nobody knows what the device holds.
    """
    assume(read_ms + write_ms < 90 or not measures_hz)
    wire = SlowWire(FakeClock(), measures_hz, round(read_ms * MS), round(write_ms * MS))
    outcome = run(wire, rate_hz)
    assert wire.sent[-1][1] == 0.0
    assert math.isfinite(outcome.safe_s) or outcome.cause == ""
    assert gaps_s(wire, outcome) < 0.6
    if read_ms + write_ms > 1.5e3 / rate_hz and not measures_hz:
        assert "too slow" in outcome.cause
        assert outcome.stop_s < 1.0 + 1.5


@pytest.mark.parametrize("rate_hz", [25.0, 100.0])
@pytest.mark.parametrize("read_ms", [20, 60, 90])
def test_a_read_that_always_has_something_does_not_keep_the_commands(rate_hz: float, read_ms: int) -> None:
    """As long as a read is shorter than a sample, such a driver is a healthy one; else the run stops in time."""
    wire = SlowWire(FakeClock(), 0.0, read_ms * MS)
    outcome = run(wire, rate_hz)
    assert wire.sent[-1][1] == 0.0
    if read_ms < 1e3 / rate_hz:
        assert (outcome.cause, outcome.faults.get("wire-slow", 0)) == ("", 0)
    else:
        assert "the wire is too slow" in outcome.cause
        assert 0.9 < outcome.stop_s < 1.0 + 1.5
        assert math.isfinite(outcome.safe_s)


@pytest.mark.parametrize("rate_hz", [25.0, 100.0])
def test_a_short_age_limit_does_not_keep_the_safe_command_either(rate_hz: float) -> None:
    """Each read alone is a gap then, after which the device has to say what it holds."""
    wire = SlowWire(FakeClock(), 0.0, 70 * MS)
    outcome = run(wire, rate_hz, age_limit_s=0.03)
    assert outcome.cause
    assert wire.sent[-1][1] == 0.0
    assert math.isfinite(outcome.safe_s)


def test_writes_that_take_longer_than_a_sample_stop_the_run() -> None:
    wire = SlowWire(FakeClock(), 100.0, write_ns=60 * MS)
    outcome = run(wire, 25.0)
    assert "the wire is too slow" in outcome.cause
    assert outcome.stop_s < 2.5
    assert wire.sent[-1][1] == 0.0


def test_a_wire_that_is_slow_in_turns_is_borne_with() -> None:
    """One slow read in three samples costs angles; no stop adds up."""
    wire = SlowWire(FakeClock(), 25.0)
    clock, takes = wire.clock, [0]

    def in_turns(ns: int) -> None:
        takes[0] += 1
        clock.ns += 50 * MS if takes[0] % 6 == 0 else 10_000

    wire._takes = in_turns  # type: ignore[method-assign]
    outcome = run(wire, 25.0)
    assert outcome.faults["wire-slow"] > 10
    assert "too slow" not in outcome.cause


@pytest.mark.parametrize("read_ms", [20, 90])
def test_what_has_piled_up_costs_half_a_second_at_most(read_ms: int) -> None:
    """Before the first sample there may be any number of readings, and a read may take any time."""
    wire = SlowWire(FakeClock(), 0.0, read_ms * MS, always=True)
    begun = wire.clock.ns
    run(wire, 25.0)
    assert wire.sent[0][0] - begun < 3 * NS


@pytest.mark.parametrize(("measures_hz", "read_ns"), [(1000.0, 10_000), (5000.0, 10_000), (5000.0, 40_000)])
def test_a_fast_stream_is_read_to_its_end(measures_hz: float, read_ns: int) -> None:
    """At 25 Hz a sample brings 40 or 200 readings; none is left for the next one, and the newest is the one used."""
    wire = SlowWire(FakeClock(), measures_hz, read_ns)
    outcome = run(wire, 25.0, to=1.0, frozen_samples=None)
    assert outcome.cause == ""
    assert len(wire._waiting) <= measures_hz * 0.04 + 1
    assert max(wire.ages_ns[len(wire.ages_ns) // 2 :]) < 60 * MS


def test_a_stream_faster_than_it_can_be_read_is_stale_and_stops() -> None:
    """What is left is read first: it shows as age, and not as a present that is long past."""
    wire = SlowWire(FakeClock(), 100.0, 12 * MS)
    outcome = run(wire, 25.0, to=1.0)
    assert "stale" in outcome.cause or "too slow" in outcome.cause
    used = [age for age in wire.ages_ns if age < 10 * NS]
    assert outcome.stop_s < 1.0 + 2.5, max(used)
    assert wire.sent[-1][1] == 0.0


def test_a_backlog_that_keeps_its_length_never_looks_fresh() -> None:
    """A second has piled up while the recording opened, and the device measures as fast as it can be read."""
    wire = SlowWire(FakeClock(), 100.0, 10 * MS)
    wire.always = True
    outcome = run(wire, 100.0, to=1.0)
    assert outcome.cause
    assert all(u <= 0.3 for _, u in wire.sent)


def test_a_reader_begins_no_read_after_a_quarter_of_the_sample() -> None:
    wire = SlowWire(FakeClock(), 0.0, 4 * MS, always=True)
    taken = Reader(wire, wire.clock, 40 * MS).take()
    assert (len(taken.readings), taken.took_ns) == (3, 12 * MS)


def test_what_is_read_too_slowly_is_left_alone_where_commands_are_in_a_hurry() -> None:
    """For 0.8 s after each read, until it has been quick for 3 s; whoever waits for a word reads all the same."""
    wire = SlowWire(FakeClock(), 0.0, 60 * MS, always=True)
    reader = Reader(wire, wire.clock, 40 * MS)
    found: list[int] = []
    for pause_ms in (0, 0, 700, 200, 0):
        wire.clock.ns += pause_ms * MS
        found.append(len(reader.take(spared=True).readings))
    assert found == [1, 0, 0, 1, 0]
    assert len(reader.take().readings) == 1
    wire.read_ns = 0
    wire.clock.ns += 3 * NS
    assert len(reader.take(spared=True).readings) > 1
    assert len(reader.take(spared=True).readings) > 1
