"""Laws of the check over random recordings: it names what is wrong, and of a healthy recording it says none of that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.trials.check import CheckReport, Severity, check, require_sound
from hystmpc.trials.clocks import UNIT_NAMES, interval_of
from hystmpc.trials.encodings import CODES, decoded
from hystmpc.trials.errors import LogError
from hystmpc.trials.findings import clock_of, time_findings
from hystmpc.trials.trial import Trial

from .random_logs import Device, answer, device, log, wandering

LONGEST = 300
few = settings(max_examples=25, deadline=None)
seeds = st.integers(0, 2**32 - 1)


def said(report: CheckReport, start: str) -> list[str]:
    """Messages on topics that begin so."""
    return [f.message for f in report.findings if f.topic.startswith(start)]


@few
@given(seeds)
def test_a_healthy_recording_is_told_no_fault_of_its_numbers_or_clocks(seed: int) -> None:
    random = np.random.default_rng(seed)
    trial = log(random, float(random.choice([10, 25, 50, 200])), 40.0)
    report = check(trial)
    assert not said(report, "numbers")
    assert not said(report, "clocks")
    assert report.of("time base")[0].severity is Severity.OK
    assert report.of("duplicates")[0].severity is Severity.OK
    assert all(len(f.message) <= LONGEST for f in report.findings)
    require_sound(trial)


@few
@given(st.integers(2, 4), st.integers(5, 20), st.integers(200, 400), st.floats(1.0, 50.0))
def test_ramps_between_holds_are_no_wraps(ramps: int, samples: int, hold: int, size: float) -> None:
    """The samples of a quick ramp are all alike and far above those of a hold, but none is half of the range."""
    one = np.concatenate([[0.5], np.ones(samples), [0.5], np.zeros(hold)])  # begins and ends between two samples
    steps = np.concatenate([np.zeros(hold), *((-1) ** k * one for k in range(ramps))])
    travel = np.cumsum(steps)
    trial = Trial(0.04 * np.arange(travel.size), travel / samples, 48.0 + size * travel)
    assert not said(check(trial), "numbers")
    require_sound(trial)


@settings(max_examples=100, deadline=None)
@given(seeds)
def test_a_sensor_that_holds_its_readings_for_long_does_not_wrap(seed: int) -> None:
    """After each hold the reading jumps to where the device has gone meanwhile, which is no step of a wrap."""
    random, dt = np.random.default_rng(seed), 0.04
    command = 1.15 - 1.15 * np.cos(2 * np.pi * dt * np.arange(775) / random.uniform(3.0, 5.0))
    angle = 25.0 * command - 11.0 + random.normal(0.0, 0.1, command.size)
    first = 0
    while first < angle.size:
        last = first + round(random.uniform(1.0, 4.5) / dt)
        angle[first:last] = angle[first]
        first = last + random.integers(1, 20)
    trial = Trial(dt * np.arange(command.size), command, angle)
    require_sound(trial)


@few
@given(seeds, st.floats(4.0, 40.0), st.floats(0.6, 0.85), st.floats(0.0, 0.2))
def test_a_tip_that_slips_once_does_not_wrap(seed: int, height: float, first: float, creeps: float) -> None:
    """A stuck tip lets go under a held command and lands within two samples: what a modulus leaves is no motion."""
    random, dt = np.random.default_rng(seed), 0.04
    t = dt * np.arange(400)
    at = int(random.integers(100, 300))
    angle = creeps * height * np.clip((t - t[at]) / 4.0, -1.0, 0.0) + random.normal(0.0, 0.003 * height, t.size)
    angle[at] += first * height
    angle[at + 1 :] += height
    trial = Trial(t, np.interp(t, [0.0, 2.0, 3.0], [0.0, 0.0, 2.0]), angle)
    assert not said(check(trial), "numbers of angle")


@few
@given(seeds, st.sampled_from([np.pi, 2 * np.pi, 180.0, 360.0, *(2.0**bits for bits in range(8, 33))]), st.booleans())
def test_a_wrap_is_named_and_its_key_takes_it_out(seed: int, modulus: float, signed: bool) -> None:
    random = np.random.default_rng(seed)
    trial = log(random)
    # The motion crosses the seam and is no longer than the modulus.
    span = float(np.ptp(trial.angle))
    whole = (
        (trial.angle - np.quantile(trial.angle, random.uniform(0.3, 0.7))) * modulus * random.uniform(0.2, 0.8) / span
    )
    whole = np.rint(whole) if modulus >= 256 and random.random() < 0.5 else whole
    wrapped = (whole + modulus / 2) % modulus - modulus / 2 if signed else whole % modulus
    if signed:  # it crosses the other seam
        wrapped = (whole + modulus) % modulus - modulus / 2
    report = check(replace(trial, angle=wrapped))
    (message,) = said(report, "numbers of angle")
    assert f"wraps_at: {modulus:.10g}}}" in message
    assert len(message) <= LONGEST
    again = decoded(wrapped, (), None, modulus)
    np.testing.assert_allclose(again - again[0], whole - whole[0], atol=1e-6 * modulus)
    with pytest.raises(LogError, match="wraps"):
        require_sound(replace(trial, angle=wrapped))


@few
@given(seeds, st.integers(9, 31))
def test_a_sign_bit_is_named_and_its_key_reads_it(seed: int, bit: int) -> None:
    random = np.random.default_rng(seed)
    trial = log(random)
    span = float(np.ptp(trial.angle))
    size = min(2.0**bit, 4000.0) * random.uniform(0.1, 0.45)
    counts = np.rint((trial.angle - np.quantile(trial.angle, random.uniform(0.3, 0.7))) * size / span)
    written = np.where(counts < 0, 2.0**bit - counts, counts)
    report = check(replace(trial, angle=written))
    (message,) = said(report, "numbers of angle")
    assert f"sign_bit: {bit}}}" in message
    assert not any("flip" in f.message for f in report.findings) or trial_falls(trial)
    np.testing.assert_array_equal(decoded(written, (), bit, None), counts)


def trial_falls(trial: Trial) -> bool:
    """Whether the device is inverted."""
    return "falls" in check(trial).of("sign")[0].message


@few
@given(seeds, st.sampled_from([*CODES, *(-c for c in CODES), 0.0, -1.0, -1e4, 12345.0]), st.booleans())
def test_a_code_for_a_missing_value_is_named_and_nothing_else_is_said_of_it(
    seed: int, code: float, in_command: bool
) -> None:
    random = np.random.default_rng(seed)
    trial = log(random)
    angle = trial.angle
    in_command = in_command and code in (*CODES, *(-c for c in CODES))
    if code in (0.0, -1.0):  # codes that many signals reach: only an angle that stays away from them, or passes them
        in_command, angle = False, angle - angle.min() + random.choice([-40.0, 8.0])
    signal = (trial.command if in_command else angle).copy()
    at = random.choice(np.arange(5, signal.size - 5), size=random.integers(3, 8), replace=False)
    signal[at] = code
    broken = replace(trial, command=signal) if in_command else replace(trial, angle=signal)
    report = check(broken)
    name = "command" if in_command else "angle"
    (message,) = said(report, "numbers")
    assert f"`{name}: {{..., missing: [{code:.10g}]}}`" in message
    assert report.of(f"numbers of {name}")
    assert not any("looks like sensor counts" in m for m in said(report, "units"))


@few
@given(seeds, st.one_of(st.floats(-8.0, -1.0), st.floats(3.0, 8.0)))
def test_two_clocks_are_named_with_their_shift(seed: int, shift: float) -> None:
    random = np.random.default_rng(seed)
    trial = log(random)
    made = replace(device(random), lag_s=0.1, delay_s=0.0, play=0.3, noise=0.1, step=0.0)
    angle = answer(trial.command, trial.dt, made, random)
    moved = np.interp(trial.t - shift, trial.t, angle)
    report = check(replace(trial, angle=moved))
    (message,) = said(report, "clocks")
    told = -float(message.rpartition("shift_s: ")[2].partition("}")[0])
    assert told == pytest.approx(shift, abs=0.4)  # the device's own lag and play are in it
    assert ("falls" in report.of("sign")[0].message) == (made.gain < 0)


@few
@given(seeds, st.sampled_from(["ms", "us", "ns", "d"]), st.floats(5.0, 2000.0), st.booleans())
def test_a_unit_of_time_is_named(seed: int, unit: str, rate_hz: float, dated: bool) -> None:
    random = np.random.default_rng(seed)
    dt, seconds = 1 / rate_hz, min(60.0, 5_000 / rate_hz)
    command = wandering(random, seconds, dt)
    angle = answer(command, dt, Device(lag_s=0.1), random)
    start = {"d": 45_000.5, "ms": 1.7e12, "us": 1.7e15, "ns": 1.7e18}[unit] if dated else 0.0
    one = {"ms": 1e3, "us": 1e6, "ns": 1e9, "d": 1 / 86400}[unit]
    t = start + one * dt * np.arange(command.size)
    if np.any(np.diff(t) <= 0):  # no digits are left for that rate after this date
        return
    (base,) = check(Trial(t, command, angle)).of("time base")
    if unit == "ms" and rate_hz > 1000:  # 0.5 is a second at 2 Hz as well
        return
    assert base.severity is not Severity.OK
    # Where another unit is as likely it is named too.
    assert f"`time_unit: {unit}`" in base.message or f"or {UNIT_NAMES[unit]}?" in base.message
    assert len(base.message) <= LONGEST
    if base.severity is Severity.ERROR:
        with pytest.raises(LogError, match="time_unit"):
            require_sound(Trial(t, command, angle))


@few
@given(
    seeds,
    st.sampled_from([(2.0**16, "ms"), (2.0**24, "us"), (2.0**32, "us"), (2.0**32, "ms"), (2.0**31, "us"), (60.0, "s"),
                     (3600.0, "s"), (86400.0, "s"), (1e6, "us"), (2.0**32, "ns")]),
    st.sampled_from([10.0, 25.0, 50.0, 100.0, 333.0, 1000.0]),
)  # fmt: skip
def test_a_counter_that_wraps_is_named(seed: int, wrap: tuple[float, str], rate_hz: float) -> None:
    random = np.random.default_rng(seed)
    modulus, unit = wrap
    one = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[unit]
    dt, seconds = 1 / rate_hz, min(30.0, 3000 / rate_hz)
    command = wandering(random, seconds, dt)
    span = one * seconds
    start = modulus - min(random.uniform(0.2, 0.8) * span, 0.9 * modulus)
    t = start + np.rint(one * dt * np.arange(command.size)) if unit != "s" else start + dt * np.arange(command.size)
    t = t % modulus
    clock = clock_of(t / one, command, unit)
    found = {f.topic: f for f in time_findings(clock, command, command, "sample {}".format)}
    assert f"time_wraps_at: {modulus:.16g}" in found["duplicates"].message
    assert found["time base"].severity is Severity.OK
    assert float(found["time base"].message.split()[0]) == pytest.approx(rate_hz, rel=0.01)


@few
@given(st.floats(3.0, 500.0), st.sampled_from([1.0, 0.1, 0.5]), st.floats(0.0, 1.0), st.integers(200, 4000))
def test_the_rate_that_is_proposed_for_a_coarse_clock_is_one_that_its_stamps_allow(
    rate_hz: float, step: float, start: float, count: int
) -> None:
    t = np.floor((start + np.arange(count) / rate_hz) / step) * step
    if rate_hz * step < 2 or t[-1] < 4 * step:  # stamps of their own, or hardly any
        return
    found = interval_of(t)
    assert found is not None
    assert found.least <= 1 / rate_hz <= found.most
    assert abs(found.rate_hz - rate_hz) <= max(1 / found.least - 1 / found.most, 1e-3 * rate_hz)
    whole = round(rate_hz)
    again = interval_of(np.floor(np.arange(2 * whole * 20) / whole / step + 1e-9) * step)
    assert again is not None
    assert again.least <= 1 / whole <= again.most
