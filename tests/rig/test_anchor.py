"""Commands only where it is known what the device holds: after a pause, a failed send, a device that moved itself."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hystmpc.ctrl.command import CommandLimits
from hystmpc.rig.experiment.phases import Decision, Past, Phase, PhaseInput
from hystmpc.rig.safety.gate import Gate
from hystmpc.rig.safety.plausibility import ModelWatch, MotionWatch, PlausibilitySettings
from hystmpc.rig.safety.ramp import RampSettings, stop_commands
from hystmpc.rig.transports.transport import Reading

from .bench_parts import DT, LIMITS, NS, OVERSHOOT, RAMPS, Rig, following, travel

STEP = LIMITS.rate * DT


@dataclass
class Rising(Phase):
    """A phase that raises the command at a rate [unit/s] for 20 s."""

    rate: float
    samples: int = 0
    name = "rising"

    def begin(self, now: PhaseInput, past: Past) -> None:
        del now, past

    def step(self, now: PhaseInput) -> Decision:
        self.samples += 1
        return Decision(now.held + self.rate * DT, "rising", finished=self.samples >= 500)


def rise_after(rig: Rig, moment_ns: int) -> float:
    """How far the device moved away from the safe command after a moment."""
    held = [u for t, u in rig.transport.history if t >= moment_ns]
    return max((b - a for k, a in enumerate(held) for b in held[k:]), default=0.0)


def test_a_paused_loop_does_not_drive_a_device_that_has_made_itself_safe() -> None:
    """3 s of pause at 4 mm: the watchdog leads to 0, and nothing leads up again."""
    rig = Rig(following, costs_ns={60: 3 * NS}, watchdog=True)
    outcome = rig.run([travel(4.0, hold_s=10.0)])
    resumed = next(k for k, s in enumerate(rig.sink.samples) if s.period_s > 1.0)
    assert max(u for t, u in rig.transport.history) > 3.9
    assert rise_after(rig, rig.transport.history[60][0] + 2 * NS) <= 1e-9
    assert all(s.command == 0.0 for s in rig.sink.samples[resumed + 1 :])
    assert "stood still" in outcome.cause
    assert outcome.confirmed
    assert rig.transport.held == 0.0


@given(
    at=st.integers(5, 80),
    pause_s=st.floats(0.13, 5.0),
    rate=st.floats(0.1, 10.0),
    suspended=st.booleans(),
)
@settings(max_examples=60)
def test_after_any_pause_the_device_never_moves_away_from_safe(
    at: int, pause_s: float, rate: float, suspended: bool
) -> None:
    """Stalls and suspensions of any length, at any moment of a rise at any rate."""

    def script(k: int, command: float) -> float:
        if k == at and rig.clock.suspended == 0 and suspended:
            rig.clock.suspended = round(pause_s * NS)
        if k == at + 20:
            rig.flag.set("end")
        return following(k, command)

    rig = Rig(script, costs_ns={} if suspended else {at: round(pause_s * NS)}, watchdog=True)
    outcome = rig.run([Rising(rate)])
    assert within_limits_while_commanding(rig)
    stopped_ns = round(outcome.stop_s * NS) + 7 * NS
    assert rise_after(rig, stopped_ns) <= OVERSHOOT + STEP
    assert rig.transport.rest() == pytest.approx(0.0)


def within_limits_while_commanding(rig: Rig) -> bool:
    """Every command lies within the limits, and by at most a sample's rate beside what the device held then."""
    steps = [b.command - a.command for a, b in pairwise(rig.sink.samples) if "wait" not in (a.source, b.source)]
    inside = all(LIMITS.lower <= u <= LIMITS.upper for u in rig.transport.sent)
    return inside and max(map(abs, steps), default=0.0) <= STEP + 1e-9


def test_a_suspended_machine_is_a_gap_although_the_monotonic_clock_stood_still() -> None:
    def script(k: int, command: float) -> float:
        if k == 40:
            rig.clock.suspended = 10 * NS
        return following(k, command)

    rig = Rig(script, watchdog=True)
    outcome = rig.run([travel(4.0, hold_s=10.0)])
    assert "stood still for 10" in outcome.cause
    assert max(rig.transport.sent[40:]) == pytest.approx(0.0)


def test_a_device_that_does_not_tell_gets_nothing_after_a_pause() -> None:
    rig = Rig(following, costs_ns={60: 3 * NS}, tells=False, watchdog=True)
    outcome = rig.run([travel(4.0, hold_s=10.0)])
    assert len(rig.transport.sent) == 61
    assert "has not told what it holds" in outcome.cause
    assert not outcome.confirmed
    assert math.isnan(outcome.safe_s)
    assert rig.transport.goodbyes == 0
    assert rig.transport.rest() == 0.0


@pytest.mark.parametrize("tells", [True, False])
def test_failed_sends_do_not_let_the_gate_run_on(tells: bool) -> None:
    """Commands in a row that do not leave, while the command rises as fast as the limits allow."""
    rig = Rig(following, fails=lambda k: 8 <= k <= 9, tells=tells)
    outcome = rig.run([Rising(10.0)])
    steps = [b - a for a, b in pairwise(rig.transport.sent)]
    assert outcome.unsent == 2
    assert outcome.cause == ""
    assert max(map(abs, steps)) <= STEP + 1e-9


@pytest.mark.parametrize("first", [1, 8, 60])
@pytest.mark.parametrize(
    ("stall_s", "cause"), [(0.5, "no command has left for 0."), (60.0, "the safe command could not be sent")]
)
def test_a_device_that_talks_and_takes_no_command_stops_the_run(first: int, stall_s: float, cause: str) -> None:
    """From the first command on, in the motion, and at rest; also where the way back is given up before it is said."""
    rig = Rig(following, fails=lambda k: k >= first, stall_s=stall_s)
    outcome = rig.run([travel(4.0, hold_s=1.0)])
    assert outcome.cause.startswith(cause)
    assert math.isnan(outcome.safe_s)
    assert not outcome.confirmed or rig.transport.held == 0.0  # where it has never left the safe command
    assert len(rig.transport.sent) == first - 1


@pytest.mark.parametrize("pause_s", [0.2, 0.7, 1.0, 3.0])
def test_a_pause_during_the_stop_begins_its_way_out_anew(pause_s: float) -> None:
    """The device has come down meanwhile: the rest of the old way would lead it up again."""

    def script(k: int, command: float) -> float:
        if k == 60:
            rig.flag.set("SIGTERM")
        return following(k, command)

    rig = Rig(script, costs_ns={70: round(pause_s * NS)}, watchdog=True)
    outcome = rig.run([travel(5.0, hold_s=10.0)])
    assert outcome.cause == "SIGTERM"
    assert outcome.confirmed
    assert rise_after(rig, rig.transport.history[69][0]) <= 1e-9


def test_a_gate_rolls_back_what_was_not_sent_and_counts_the_time_that_has_passed() -> None:
    gate = Gate(CommandLimits(0.0, 6.0, 10.0), DT)
    assert gate.anchor(1.0)
    assert gate.admissible(6.0, 0) == pytest.approx(1.4)
    assert gate.admissible(6.0, 0) == pytest.approx(1.4)  # it was not sent: nothing is added up
    gate.sent(1.4, 0)
    assert gate.admissible(6.0, 300_000) == pytest.approx(1.4 + 10 * 0.1 * DT)  # .3 ms later: the floor
    assert gate.admissible(6.0, round(0.5 * DT * NS)) == pytest.approx(1.4 + 10 * 0.5 * DT)
    assert gate.admissible(6.0, 10 * NS) == pytest.approx(1.4 + 10 * DT)  # a pause earns no jump


@pytest.mark.parametrize("held", [-0.1, 6.1, math.nan, math.inf])
def test_a_device_beyond_the_limits_is_no_place_to_start_from(held: float) -> None:
    gate = Gate(LIMITS, DT)
    assert not gate.anchor(held)
    assert not gate.anchored
    rig = Rig(following, held=held)
    outcome = rig.run([travel()])
    assert rig.transport.sent == []
    assert outcome.cause


def test_nothing_is_sent_before_the_device_stands_still() -> None:
    """A device that is on its way back at the start of a run: the first command is one that it holds."""
    rig = Rig(following, held=5.6, watchdog=True)
    rig.transport._written_ns = rig.clock.ns - NS  # its last controller was killed a second ago
    outcome = rig.run([travel(1.0)])
    assert rig.transport.sent[0] <= RAMPS.velocity_per_s * DT
    assert outcome.cause == ""
    assert rise_after(rig, 0) <= 1.0 + 1e-9


def test_a_device_that_moves_by_itself_during_a_run_stops_it() -> None:
    def script(k: int, command: float) -> float:
        if k == 30:
            rig.transport.held = 0.3
        return following(k, command)

    rig = Rig(script)
    outcome = rig.run([travel(4.0, hold_s=10.0)])
    assert outcome.cause.startswith("the device does not follow: it holds 0.3")
    assert max(rig.transport.sent[30:]) <= 0.3 + OVERSHOOT
    assert outcome.confirmed


def test_the_safe_command_is_held_only_where_the_device_says_so() -> None:
    """A device that stays beside it: sent for a while, never confirmed, and no goodbye."""
    rig = Rig(following)
    write = rig.transport.write

    def sticking(command: float) -> None:
        write(command)
        rig.transport.held = max(command, 0.5)

    rig.transport.write = sticking  # type: ignore[method-assign]
    outcome = rig.run([travel(2.0, hold_s=0.2)])
    assert not outcome.confirmed
    assert rig.transport.goodbyes == 0


@given(
    start=st.floats(0, 6),
    velocity=st.floats(-10, 10),
    safe=st.floats(0, 6),
    overshoot=st.floats(0.01, 1.0),
    acceleration=st.floats(1, 1000),
)
@settings(max_examples=300)
def test_a_stop_stays_within_the_overshoot_and_ends_at_the_safe_command(
    start: float, velocity: float, safe: float, overshoot: float, acceleration: float
) -> None:
    ramps = RampSettings(acceleration_per_s2=acceleration)
    commands = stop_commands(start, velocity, safe, ramps, overshoot, DT)
    assert commands[-1] == safe
    assert commands.max() <= max(start, safe) + overshoot * (1 + 1e-9)
    assert commands.min() >= min(start, safe) - overshoot * (1 + 1e-9)


def test_a_stop_is_as_gentle_as_the_overshoot_allows() -> None:
    """Slow motions keep the jerk-limited ramp, fast ones brake first."""
    gentle = stop_commands(3.0, 0.5, 0.0, RAMPS, OVERSHOOT, DT)
    assert 3.0 < gentle.max() <= 3.0 + OVERSHOOT
    steps = [abs(b - a) / DT for a, b in pairwise([3.0, *gentle])]
    assert max(abs(b - a) / DT for a, b in pairwise([0.5, *steps])) <= RAMPS.acceleration_per_s2 * (1 + 1e-6)
    assert stop_commands(3.0, 10.0, 0.0, RAMPS, OVERSHOOT, DT).max() == pytest.approx(3.0 + OVERSHOOT)


def blocked_at(k0: int, deg: float = 40.0) -> Rig:
    """A tip that does not move any more from sample `k0` on, under a sensor with noise."""
    noise = [0.15 * math.sin(37.1 * k**2) for k in range(2000)]
    return Rig(
        lambda k, u: following(k, u) + noise[k] if k < k0 else deg + noise[k], plausibility=PlausibilitySettings()
    )


@pytest.mark.parametrize(
    ("rate", "first", "travel", "later_s"), [(1.0, 40, 1.8, 0), (3.0, 20, 1.8, 0), (10.0, 5, 3, 0.8)]
)
def test_a_blocked_tip_stops_the_run(rate: float, first: int, travel: float, later_s: float) -> None:
    """It is noticed when the command, lagged by half a second, has gone on for 30 % of the range.

    Where it comes to the end of its limits before, it has to have gone for half of the range since the last motion.
    """
    rig = blocked_at(first, 30.0 + 10.0 * rate * DT * first)
    outcome = rig.run([Rising(rate)])
    assert outcome.cause.startswith("implausible: the command went from")
    assert max(rig.transport.sent) <= min((first + 1) * rate * DT + travel + (0.8 + 3 * DT) * rate, 6.0) + OVERSHOOT
    # the angle is smoothed over 0.2 s
    assert outcome.stop_s <= (first + 1) * DT + travel / rate + 0.5 + 0.3 + 3 * DT + later_s
    assert outcome.confirmed


def test_a_tip_that_moves_or_rests_is_plausible() -> None:
    noise = [0.15 * math.sin(37.1 * k**2) for k in range(2000)]
    rig = Rig(lambda k, u: following(k, u) + noise[k], plausibility=PlausibilitySettings())
    assert rig.run([travel(5.0, hold_s=5.0), travel(1.0)]).cause == ""


@given(st.lists(st.floats(-0.5, 0.5), min_size=10, max_size=100), st.floats(0.2, 5.0))
def test_travel_below_the_threshold_is_never_implausible(noise: list[float], slope: float) -> None:
    """Whatever the angle does: a command that stays within the travel allowed is no evidence."""
    watch = MotionWatch(PlausibilitySettings(travel=1.0), 6.0, 120.0)
    for k, e in enumerate(noise):
        assert watch.judge(40.0 + e, min(slope * k * 0.01, 0.99), k * 40_000_000) == ""


def test_a_model_that_the_device_does_not_obey_stops_the_run() -> None:
    watch = ModelWatch(PlausibilitySettings(), 30.0, DT)
    assert [watch.judge(21.0) for _ in range(24)] == [""] * 24
    assert watch.judge(21.0).startswith("implausible: the device is 21.0 deg off its model")
    assert watch.judge(19.0) == ""
    saturated = ModelWatch(PlausibilitySettings(), 10.0, DT)
    assert [bool(saturated.judge(-10.0)) for _ in range(25)][-1]
    off = ModelWatch(PlausibilitySettings(watch_model=False), 30.0, DT)
    assert not any(off.judge(30.0) for _ in range(100))


@pytest.mark.parametrize("lag_s", [0.1, 0.5, 2.0])
def test_travel_counts_as_a_device_of_the_slowest_lag_would_follow_it(lag_s: float) -> None:
    """A step of twice the travel is implausible after ln 2 time constants."""
    watch = MotionWatch(PlausibilitySettings(travel=1.0, travel_s=lag_s), 6.0, 120.0)
    assert watch.judge(40.0, 0.0, 0) == ""
    verdicts = [bool(watch.judge(40.0, 2.0, k * 10_000_000)) for k in range(1, 300)]
    assert 0.01 * (1 + verdicts.index(True)) == pytest.approx(lag_s * math.log(2.0), abs=0.02)


@pytest.mark.parametrize("gain", [20.0, -20.0])
def test_play_is_left_after_a_reversal_alone(gain: float) -> None:
    """30 % of the range in the direction of the last motion, 50 % against it or where nothing has moved yet.

    In a recording it is seen by the motion itself whether the angle rises with the command.
    """
    for before, then, least in [(3.0, 1.0, 1.8), (3.0, -1.0, 3.0), (0.0, 1.0, 3.0)]:
        watch, t, u, angle = MotionWatch(PlausibilitySettings(travel_s=1e-3), 6.0, 120.0), 0, 0.0, 40.0
        for k in range(int(before / 0.01)):
            u, angle, t = u + 0.01, 40.0 + gain * 0.01 * (k + 1), t + 40_000_000
            assert watch.judge(angle, u, t) == ""
        turned = u
        for _ in range(400):
            u, t = u + 0.01 * then, t + 40_000_000
            if watch.judge(angle, u, t):
                break
        assert abs(u - turned) == pytest.approx(least, abs=0.2)


@dataclass
class Driven:
    """A device of play, lag and noise, in ranges of the command and degrees of the sensor."""

    play: float
    lag_s: float
    gain: float
    noise_deg: float
    random: np.random.Generator
    at: float = 0.0
    lagged: float = 0.0

    def angle_deg(self, u: float, dt_s: float) -> float:
        self.at = min(max(self.at, u - 0.5 * self.play), u + 0.5 * self.play)
        self.lagged += (1.0 - math.exp(-dt_s / self.lag_s)) * (self.at - self.lagged)
        return 60.0 + self.gain * self.lagged + self.noise_deg * float(self.random.standard_normal())


def motions(seed: int, rate: float, dt_s: float) -> list[float]:
    """Ramps between drawn commands with rests, at most at a rate, for 30 s; in mm of 6."""
    random = np.random.default_rng(seed)
    commands = [0.0]
    while len(commands) * dt_s < 30.0:
        target, speed = random.uniform(0.0, 6.0), rate * random.uniform(0.05, 1.0)
        steps = max(math.ceil(abs(target - commands[-1]) / (speed * dt_s)), 1)
        commands += np.linspace(commands[-1], target, steps + 1)[1:].tolist()
        commands += [target] * int(random.uniform(0.0, 1.5) / dt_s)
    return commands


@given(
    seed=st.integers(0, 10_000),
    play=st.floats(0.0, 0.4),
    lag_s=st.floats(0.01, 0.5),
    gain=st.floats(7.0, 20.0),
    noise_deg=st.floats(0.0, 0.5),
    rate=st.floats(0.5, 12.0),
    dt_s=st.sampled_from([0.04, 0.01]),
    inverted=st.booleans(),
)
@example(seed=3878, play=0.4, lag_s=0.5, gain=20.0, noise_deg=0.1, rate=3.0, dt_s=0.04, inverted=False)
@settings(max_examples=60)
def test_no_healthy_device_is_implausible_and_an_inverted_one_is(
    seed: int, play: float, lag_s: float, gain: float, noise_deg: float, rate: float, dt_s: float, inverted: bool
) -> None:
    """Play to 40 % of the range, lags to half a second, at any rate; one that falls is found in a closed loop alone."""
    device = Driven(6.0 * play, lag_s, -gain if inverted else gain, noise_deg, np.random.default_rng(seed))
    watch, free = (MotionWatch(PlausibilitySettings(), 6.0, 120.0, rises) for rises in (True, False))
    found = []
    for k, u in enumerate(motions(seed, rate, dt_s)):
        angle, now = device.angle_deg(u, dt_s), round(k * dt_s * NS)
        found.append(watch.judge(angle, u, now))
        assert free.judge(angle, u, now) == ""
    if not inverted:
        assert not any(found)
    elif rate >= 3.0 and (6.0 - 6.0 * play) * gain > 40.0:  # slower ones turn before they have gone far enough
        assert any("against the command" in text for text in found)


def false_for(rig: Rig, first: int, last: int, says: float) -> None:
    """Make the device say that it holds something, over readings `first` to `last`."""
    read, count = rig.transport.read, iter(range(10_000_000))

    def lying() -> Reading | None:
        found = read()
        return found if found is None or not first <= next(count) <= last else replace(found, held=says)

    rig.transport.read = lying  # type: ignore[method-assign]


@given(
    at=st.integers(20, 80),
    lasts=st.integers(1, 200),
    says=st.one_of(st.floats(-1.0, 7.0), st.just(1e308)),
    top=st.floats(0.5, 5.0),
)
@example(at=70, lasts=6, says=0.5, top=4.0)
@example(at=20, lasts=6, says=5.5, top=4.0)
@settings(max_examples=80)
def test_a_device_that_says_something_false_is_never_sent_a_jump(at: int, lasts: int, says: float, top: float) -> None:
    """Any false command held, for any time: what is sent is within a sample's rate of what the device really holds.

    Unless the time without commands was long enough for the device's own watchdog to have led it there.
    """
    rig = Rig(following, watchdog=True)
    false_for(rig, at, at + lasts, says)
    write, steps = rig.transport.write, list[tuple[float, float]]()

    def watched(command: float) -> None:
        rig.transport.history.append((rig.clock.ns, rig.transport.held))
        steps.append((rig.transport.held, command))
        write(command)

    rig.transport.write = watched  # type: ignore[method-assign]
    outcome = rig.run([travel(top, hold_s=5.0)])
    led = not 0.0 <= says <= top + 0.1  # nothing can have led the device there
    assert max((b - a for a, b in steps), default=0.0) <= STEP + 1e-9 or not led
    assert all(LIMITS.lower <= u <= LIMITS.upper for u in rig.transport.sent)
    if lasts * DT < 0.4:
        assert max((abs(b - a) for a, b in steps), default=0.0) <= STEP + 1e-9
    if led and lasts * DT > 4.0:
        assert outcome.cause
        assert outcome.samples * DT <= at * DT + 4.0  # it is not waited for much longer than two seconds
    assert rig.transport.rest() == pytest.approx(0.0)


def test_a_device_that_moves_by_itself_for_a_minute_is_left_alone() -> None:
    """Its held command never stands still: after 60 s nothing is sent any more, whatever it says then."""

    def script(k: int, command: float) -> float:
        if k >= 30:
            rig.transport.held = 1.0 + 0.5 * math.sin(20.0 * rig.clock.ns / NS)
        return following(k, command)

    rig = Rig(script)
    outcome = rig.run([travel(4.0, hold_s=10.0)])
    assert "moved by itself for 60 s" in outcome.cause
    assert len(rig.transport.sent) <= 45
    assert not outcome.confirmed
