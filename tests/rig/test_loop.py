"""The loop: limits whatever happens, safe stops, misses and skips, on a clock that obeys."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.rig.experiment.phases import CommandMotion, Decision, Past, Phase, PhaseInput, PretensionCheck
from hystmpc.rig.recording.sample import Sample
from hystmpc.rig.safety.ramp import ramp_commands, waypoint_commands

from .bench_parts import DT, LIMITS, NS, RAMPS, Rig, following, travel

STEP = LIMITS.rate * DT + 1e-12


def within_limits(commands: list[float], held: float = 0.0) -> bool:
    steps = [abs(b - a) for a, b in pairwise([held, *commands])]
    return all(LIMITS.lower <= u <= LIMITS.upper for u in commands) and max(steps, default=0.0) <= STEP


@dataclass
class Wild(Phase):
    """A phase that wants anything, or raises."""

    seed: int
    raises_at: int
    name = "wild"

    def begin(self, now: PhaseInput, past: Past) -> None:
        del now, past
        self.random, self.k = random.Random(self.seed), 0

    def step(self, now: PhaseInput) -> Decision:
        del now
        self.k += 1
        if self.k == self.raises_at:
            raise RuntimeError("wild")
        wanted = self.random.choice((math.nan, math.inf, -math.inf, 1e308, self.random.uniform(-20, 20)))
        return Decision(wanted, "wild", finished=self.k >= 60)


def test_a_run_without_fault_ends_by_itself() -> None:
    rig = Rig(following)
    outcome = rig.run([travel()])
    assert outcome.cause == ""
    assert max(rig.transport.sent) == pytest.approx(3.0)
    assert rig.transport.sent[-1] == 0.0
    assert rig.transport.stopped == 1
    assert [s.sequence for s in rig.sink.samples] == list(range(outcome.samples))
    assert outcome.confirmed
    assert rig.transport.goodbyes == 1
    assert (outcome.clipped, outcome.faults, rig.loop.timings.missed) == (0, {}, 0)
    assert all(s.period_s == pytest.approx(DT) for s in rig.sink.samples)


@given(
    angles=st.lists(st.one_of(st.none(), st.floats(), st.floats(0, 120)), min_size=1, max_size=200),
    seed=st.integers(0, 1000),
    raises_at=st.integers(1, 80),
    held=st.floats(0, 6),
    signal_at=st.integers(0, 80),
    late=st.dictionaries(st.integers(0, 60), st.integers(0, 900_000_000), max_size=5),
)
@settings(max_examples=80)
def test_no_command_leaves_the_limits_whatever_comes(
    angles: list[float | None], seed: int, raises_at: int, held: float, signal_at: int, late: dict[int, int]
) -> None:
    """Any sensor, any wish, any signal, any delay: within limits, and at rest at the safe command in the end."""

    def script(k: int, command: float) -> float | None:
        if k == signal_at:
            rig.flag.set("signal")
        return angles[k % len(angles)]

    rig = Rig(script, held=held, safe=1.0, costs_ns=late)
    outcome = rig.run([Wild(seed, raises_at)])
    assert within_limits(rig.transport.sent, held)
    assert rig.transport.stopped == 1
    assert rig.transport.goodbyes == outcome.confirmed
    if outcome.confirmed:
        assert rig.transport.held == pytest.approx(1.0)
    else:  # nothing is sent to a device that has fallen silent: its watchdog acts
        assert "has not told what it holds" in outcome.cause or not rig.transport.sent
        assert math.isnan(outcome.safe_s)


@pytest.mark.parametrize("at", ["begin", "step"])
def test_a_phase_that_raises_stops_the_run(at: str) -> None:
    """It is not held and tried again: what it would have done is not known."""

    class Raising(Phase):
        name = "raising"
        steps = 0

        def begin(self, now: PhaseInput, past: Past) -> None:
            del now, past
            if at == "begin":
                raise RuntimeError("it broke")

        def step(self, now: PhaseInput) -> Decision:
            self.steps += 1
            if at == "step" and self.steps == 5:
                raise RuntimeError("it broke")
            return Decision(now.held + 0.1, "raising", finished=self.steps >= 50)

    rig, phase = Rig(following), Raising()
    outcome = rig.run([phase, travel()])
    assert outcome.cause == "RuntimeError: it broke"
    assert phase.steps == (0 if at == "begin" else 5)
    assert outcome.confirmed
    assert rig.transport.sent[-1] == 0.0


@pytest.mark.parametrize("bad", [None, math.nan, 1e4, -5.0, math.inf])
def test_a_dead_or_implausible_sensor_stops_safely(bad: float | None) -> None:
    rig = Rig(lambda k, u: following(k, u) if k < 30 else bad)
    outcome = rig.run([travel(hold_s=5.0)])
    assert outcome.cause.startswith("sensor dead")
    assert outcome.stop_s == pytest.approx(30 * DT + 0.5, abs=3 * DT)
    assert outcome.safe_s - outcome.stop_s < 3.0
    assert rig.transport.sent[-1] == 0.0
    assert within_limits(rig.transport.sent)


def test_a_frozen_sensor_is_found_while_the_command_moves_and_not_in_a_hold() -> None:
    rest = CommandMotion("rest", lambda u: waypoint_commands(u, [u], [4.0], RAMPS, DT))
    assert Rig(lambda k, u: 30.0).run([rest]).cause == ""
    rig = Rig(lambda k, u: 30.0 + (0.01 * math.sin(37.1 * k**2) if k < 60 else 0.0))
    outcome = rig.run([rest, travel(hold_s=5.0)])
    assert "frozen" in outcome.cause
    assert rig.transport.sent[-1] == 0.0


def test_a_missing_angle_is_bridged_and_named() -> None:
    rig = Rig(lambda k, u: None if k in (40, 41) else following(k, u))
    assert rig.run([travel()]).cause == ""
    assert [s.sequence for s in rig.sink.samples if math.isnan(s.measured_deg)] == [42, 43]
    assert rig.sink.samples[42].faults == ("no-angle",)


def test_a_signal_stops_by_a_ramp_that_respects_velocity_and_jerk() -> None:
    def script(k: int, command: float) -> float:
        if k == 20:
            rig.flag.set("SIGTERM")
        return following(k, command)

    rig = Rig(script)
    outcome = rig.run([travel(hold_s=5.0)])
    assert outcome.cause == "SIGTERM"
    speeds = [abs(b - a) / DT for a, b in pairwise(rig.transport.sent)]
    assert max(speeds) <= RAMPS.velocity_per_s * (1 + 1e-9)
    bends = [abs(b - a) / DT for a, b in pairwise(speeds[:20])]
    assert max(bends) <= RAMPS.acceleration_per_s2 * (1 + 1e-6)


def test_a_late_command_is_a_miss_and_whole_samples_are_skipped() -> None:
    """A write of 1.5 samples is a miss; one of 2.5 samples also skips a sequence number."""
    seen: list[PhaseInput] = []

    class Watching(Phase):
        name = "watching"

        def begin(self, now: PhaseInput, past: Past) -> None:
            del now, past
            self.k = 0

        def step(self, now: PhaseInput) -> Decision:
            seen.append(now)
            self.k += 1
            return Decision(now.held, "watching", finished=self.k >= 20)

    rig = Rig(following, costs_ns={5: round(1.5e9 * DT), 10: round(2.5e9 * DT)})
    outcome = rig.run([Watching()])
    assert (rig.loop.timings.missed, rig.loop.timings.skipped) == (2, 1)
    assert [k for k, now in enumerate(seen) if now.late] == [6, 11]
    assert [now.skipped for now in seen if now.skipped] == [1]
    missed = [s for s in rig.sink.samples if s.missed]
    assert [s.sequence for s in missed] == [7, 12]  # two samples passed before the first command
    assert rig.sink.samples[13].sequence == 14
    assert outcome.faults["deadline-missed"] == 2


@pytest.mark.parametrize("busy_s", [0.0, 0.03, 0.07, 0.1])
def test_a_period_that_a_timer_misses_is_a_sample_that_ended_late(busy_s: float) -> None:
    """`run` that is held up at the end of a sample, and a timer whose program does something else after it."""
    rigs = [Rig(following), Rig(following)]
    for rig in rigs:
        put, sink = rig.sink.put, rig.sink

        def busy(sample: Sample, rig: Rig = rig, put: Callable[[Sample], None] = put) -> None:
            put(sample)
            rig.clock.ns += round(busy_s * NS) if len(rig.sink.samples) == 40 else 0

        sink.put = busy  # type: ignore[method-assign]
    ran, rig = rigs
    ran.run([Wild(3, 1000)])
    loop = rig.loop_of()
    loop.begin([Wild(3, 1000)])
    going = True
    while going:
        rig.clock.wait_until(loop.due())
        going = loop.sample(loop.due())
    told = [[(s.command, s.sequence, s.source, s.t_s) for s in one.sink.samples] for one in rigs]
    assert told[0] == told[1]
    assert loop.timings.skipped == ran.loop.timings.skipped
    assert loop.outcome().confirmed


def test_a_timer_on_its_grid_comes_back_to_the_deadlines() -> None:
    """After a late call the next one comes at its own time: the loop is not a sample behind for ever."""
    rig = Rig(following)
    loop = rig.loop_of()
    loop.begin([travel(hold_s=5.0)])
    first = loop.due()
    for k in range(60):
        periods = k if k < 20 else k + 2
        rig.clock.ns = first + round(periods * DT * NS) + (round(0.9 * DT * NS) if k == 20 else 1_000)
        loop.sample(loop.due())
    assert loop.timings.skipped == 2
    assert [s.lateness_s > 0.5 * DT for s in rig.sink.samples].count(True) == 1


def test_a_loop_that_stood_still_stops() -> None:
    rig = Rig(following, costs_ns={8: 2_000_000_000})
    outcome = rig.run([travel(hold_s=5.0)])
    assert "stood still" in outcome.cause
    assert rig.transport.sent[-1] == 0.0
    assert within_limits(rig.transport.sent)


def test_a_wall_clock_that_jumps_changes_nothing() -> None:
    def script(k: int, command: float) -> float:
        rig.clock.wall += 3_600_000_000_000 if k == 10 else -7_200_000_000_000 if k == 20 else 0
        return following(k, command)

    rig = Rig(script)
    assert rig.run([travel()]).cause == ""
    plain = Rig(following)
    plain.run([travel()])
    assert rig.transport.sent == plain.transport.sent


@pytest.mark.parametrize(("gain", "cause"), [(10.0, ""), (0.0, "pretension check"), (-10.0, "pretension check")])
def test_pretension_check_wants_an_angle_that_moves_with_the_command(gain: float, cause: str) -> None:
    def script(k: int, command: float) -> float:
        return 40.0 + gain * command + 1e-6 * k

    rig = Rig(script)
    way = waypoint_commands(0.0, [1.0], [0.5], RAMPS, DT), ramp_commands(1.0, 0.0, 0.0, RAMPS, DT)
    check = PretensionCheck(lambda held: way, least_deg=5.0, most_deg=20.0)
    outcome = rig.run([check])
    assert outcome.cause.startswith(cause)
    assert bool(outcome.cause) == bool(cause)
    assert max(rig.transport.sent) == pytest.approx(1.0)
    assert rig.transport.sent[-1] == 0.0
