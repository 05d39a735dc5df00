"""Quality check of a recorded log before anything is identified from it: clock, values, units, sign, motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from .axes import axes_apart
from .clock_shift import DELAY_S, IMPOSSIBLE_S, clock_shift, correlations
from .clocks import SLOWEST_HZ, UNUSUAL_HZ, suspected_unit
from .encodings import MODULI, Encoding, encodings
from .errors import LogError, in_a_line
from .findings import CheckReport as CheckReport
from .findings import Finding as Finding
from .findings import Severity as Severity
from .findings import clock_of, sampled_time, time_findings
from .layouts import ANGLE_UNIT_OF, COMMAND_UNIT_OF, LogMapping
from .read import AnyLayout, Log, read_unchecked, resolve
from .segments import Motion, Segments, segment
from .signals import UncheckedLog
from .trial import Trial, even_time, parts_at_gaps, resample
from .types import Vec

LEAST_SAMPLES = 50
"""Least number of samples for the identification of a model."""

_MODEL_HZ = 25.0  # default rate of `fit`


@in_a_line
def check(log: Log, layout: AnyLayout = "auto", sampled_hz: float | None = None) -> CheckReport:
    """Check a log: time base, jitter, gaps, duplicates, values, units, sign, excitation, segments and first flexure.

    Findings on the second axis of a log of two have `y: ` before their topic.

    Args:
        sampled_hz: rate [Hz] of an evenly sampled log, whose time stamps are ignored.

    Raises:
        LogError: if it cannot be read, or lacks a column or signal.
        ConfigError: on an unknown layout or a wrong mapping file.
    """
    if isinstance(log, Trial):
        t = log.t if sampled_hz is None else even_time(len(log), sampled_hz)
        signals = t, log.command, log.angle, log.channels, log.units, log.source
        return _both(UncheckedLog(*signals, inputs=log.inputs))
    layout = resolve(layout)
    return _both(read_unchecked(log, layout, sampled_hz), layout if sampled_hz is None else None)


def _both(log: UncheckedLog, layout: AnyLayout | None = None) -> CheckReport:
    """All findings on a log of one axis or two."""
    both = axes_apart(log)
    first = _report(both[0], layout)
    if len(both) == 1:
        return first
    axes, rests = [first.findings, _report(both[1]).findings], [np.ptp(one.command) == 0 for one in both]
    if sum(rests) == 1:
        k = rests.index(True)
        axes[k] = tuple(_of_resting_axis(axes[k]))
    findings = (*axes[0], *(replace(f, topic=f"y: {f.topic}") for f in axes[1]))
    return CheckReport(first.source, first.layout, findings)


def _of_resting_axis(findings: Iterable[Finding]) -> Iterator[Finding]:
    """Findings on an axis that rests while the other one moves: its small angle and its constant command are right."""
    for finding in findings:
        if finding.topic == "excitation":
            yield replace(
                finding, severity=Severity.OK, message="the command rests: the log shows the other axis alone"
            )
        elif not finding.topic.startswith("units of angle"):
            yield finding


def _report(log: UncheckedLog, layout: AnyLayout | None = None) -> CheckReport:
    """All findings; those on the motion use finite, sorted and decoded samples."""
    mapping = layout if isinstance(layout, LogMapping) else None
    findings = [Finding(Severity.NOTE, "file", log.note)] if log.note else []
    findings += _value_findings(log)
    clock = clock_of(log.t, log.command, mapping.time_unit if mapping is not None and mapping.rate_hz is None else "s")
    findings += time_findings(clock, log.command, log.angle, log.where)
    rows = np.column_stack((sampled_time(clock), log.command, log.angle, np.arange(log.t.size)))
    rows = rows[np.isfinite(rows).all(axis=1)]
    rows = rows[np.diff(np.maximum.accumulate(rows[:, 0]), prepend=-np.inf) > 0]
    if len(rows) < LEAST_SAMPLES:
        text = f"{len(rows)} usable samples, expected at least {LEAST_SAMPLES}"
        findings.append(Finding(Severity.ERROR, "length", text))
    if len(rows) > 1:
        t, command, angle = rows.T[:3]
        findings += _short(t)
        trial = Trial(t, command, angle, units=log.units, source=log.source)
        scales = dict[str, tuple[float, float]]()
        if mapping is not None:
            mapped = ("command", mapping.command, COMMAND_UNIT_OF), ("angle", mapping.angle, ANGLE_UNIT_OF)
            for name, signal, units in mapped:
                factor = units.get(signal.unit, ("", 1.0))[1]
                scales[name] = factor * signal.scale, factor * signal.offset
        encoded, trial = encoding_findings(trial, scales, lambda k: log.where(int(rows[k, 3])))
        findings += [*encoded, *motion_findings(trial, log.ranges)]
    return CheckReport(log.source, log.layout, tuple(findings))


def _short(t: Vec) -> Iterator[Finding]:
    duration, count = float(t[-1] - t[0]), t.size
    if count >= LEAST_SAMPLES and duration * _MODEL_HZ + 1 < LEAST_SAMPLES:
        rate = min(round(200 / duration, -1), (count - 1) / duration) if duration > 0 else _MODEL_HZ
        text = (
            f"{duration:.3g} s: at {_MODEL_HZ:g} Hz, the usual rate of `fit`, that is {duration * _MODEL_HZ:.0f} "
            f"samples, expected {LEAST_SAMPLES}; `--rate-hz {rate:.3g}` takes more of them"
        )
        yield Finding(Severity.NOTE, "length", text)


def _value_findings(log: UncheckedLog) -> Iterator[Finding]:
    clean = True
    main = {"time": log.t, "command": log.command, "angle": log.angle, **log.inputs}
    for name, values in {**main, **log.channels}.items():
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            clean = False
            severity = Severity.ERROR if name in main else Severity.NOTE
            message = f"{name}: {bad.size} of {values.size} not finite, first at {log.where(int(bad[0]))}"
            yield Finding(severity, "values", message)
    if clean:
        yield Finding(Severity.OK, "values", f"{log.t.size} samples, all finite")
    for name, values in log.inputs.items():
        if (usable := values[np.isfinite(values)]).size:
            low, high, mean = float(usable.min()), float(usable.max()), float(usable.mean())
            seen = f"constant at {low:.4g}" if low == high else f"{low:.4g} to {high:.4g}, {mean:.4g} in the mean"
            yield Finding(Severity.OK, "input", f"{name}: {seen}")


def require_sound(trial: Trial) -> None:
    """Refuse a trial with a wrong unit of time, missing-value codes, wraps, or an angle ahead of its command.

    Raises:
        LogError: with the finding of `check`.
    """
    unit = suspected_unit(trial.t)
    if unit is not None and unit.certain:
        raise LogError(
            f"{trial.source}: time_s runs from {trial.t[0]:.15g} to {trial.t[-1]:.15g}, sampling rate "
            f"{1 / trial.dt:.3g} Hz, expected {SLOWEST_HZ:g} Hz to {UNUSUAL_HZ / 1e3:g} kHz: {unit.text}"
        )
    findings, _ = encoding_findings(trial, {}, "sample {}".format)
    for finding in findings:
        raise LogError(f"{trial.source}: {finding.topic}: {finding.message}")
    shift = clock_shift(trial.t, trial.command, trial.angle)
    if shift is not None and shift.late_s < -IMPOSSIBLE_S:
        raise LogError(f"{trial.source}: {shift.text}")


_SEGMENT_RATE_HZ = 50.0  # enough for tip motions up to a few Hz
_FOLLOWS, _SURE = 0.3, 0.85  # correlation of angle and command below which the sign is unknown, or doubtful
_MUCH_MORE, _FAR_MORE = 0.5, 0.1  # of the variance left without a delay, or with the other sign
_ALIKE = 0.95  # least correlation at a delay that decides the sign
_ROUNDING = 1e-9

# Range of a signal and its suspected unit: (from, to, suspicion); ranges between the rows are plausible. Only for
# travel in mm or pressure in bar that bends a tip by degrees: for other devices there is no reference.
_MISTAKEN: dict[str, tuple[tuple[float, float, str], ...]] = {
    "mm": ((0.0, 0.05, "metres"), (200.0, np.inf, "micrometres")),
    "bar": ((0.0, 0.02, "MPa or a valve signal"), (20.0, 5e3, "kPa or psi"), (5e3, np.inf, "Pa")),
    "deg": ((0.0, 3.5, "radians"), (400.0, np.inf, "sensor counts")),
}


Range = tuple[float, float]
_COMMANDS, _ANGLES, _ANY = (-100.0, 100.0), (-200.0, 200.0), (-np.inf, np.inf)  # plausible values: mm or bar, deg


def motion_findings(trial: Trial, ranges: tuple[Range | None, Range | None]) -> Iterator[Finding]:
    """Findings on a trial with finite values and increasing time.

    `ranges` are the plausible values of command and angle; None for those of a tip that bends.
    """
    bends = trial.units.angle == "deg" and trial.units.command in ("mm", "bar")
    commands, angles = (ranges[0] or _COMMANDS, ranges[1] or _ANGLES) if bends else (_ANY, _ANY)
    yield _units("command", trial.command, trial.units.command, commands, bends)
    yield _units("angle", trial.angle, trial.units.angle, angles, bends)
    signals = ("command", trial.command, trial.units.command), ("angle", trial.angle, trial.units.angle)
    for name, values, unit in signals:
        if np.ptp(values) == 0:
            text = f"the {name} is {values[0]:g} {unit} throughout: nothing can be identified"
            yield Finding(Severity.ERROR, "excitation", text)
            return
    shift = clock_shift(trial.t, trial.command, trial.angle)
    if shift is not None:
        yield Finding(Severity.WARNING, "clocks", shift.text)
        trial = _moved(trial, shift.late_s)
    yield _sign(trial)
    try:
        longest = max(parts_at_gaps(trial), key=len)
        even = resample(longest, min(_SEGMENT_RATE_HZ, 1 / longest.dt))
    except LogError as error:
        yield Finding(Severity.ERROR, "segments", f"not looked for: {str(error).removeprefix(f'{trial.source}: ')}")
        return
    parts = segment(even)
    yield _excitation(even, parts)
    yield _segments(even, parts)
    yield _first_flexure(even, parts)


def _moved(trial: Trial, late_s: float) -> Trial:
    at = trial.t + late_s
    inside = (at >= trial.t[0]) & (at <= trial.t[-1])
    angle = np.interp(at[inside], trial.t, trial.angle)
    return Trial(trial.t[inside], trial.command[inside], angle, units=trial.units, source=trial.source)


def _units(name: str, values: Vec, unit: str, plausible: tuple[float, float], bends: bool) -> Finding:
    low, high, topic = float(values.min()), float(values.max()), f"units of {name}"
    text = f"{low:.4g} to {high:.4g} {unit}"
    for least, most, suspicion in _MISTAKEN.get(unit, ()) if bends else ():
        # 30.0 to 30.1 is no angle in radians: a larger unit gives small values, not only a small range.
        if least < high - low <= most and max(-low, high) <= 2 * most:
            return Finding(Severity.WARNING, topic, f"{text}: looks like {suspicion}, expected {unit}")
    if low < plausible[0] or high > plausible[1]:
        return Finding(
            Severity.WARNING, topic, f"{text}: expected {plausible[0]:g} to {plausible[1]:g}; offset or another unit?"
        )
    return Finding(Severity.OK, topic, text)


def _sign(trial: Trial) -> Finding:
    """Finding on sign and size of the gain from command to angle, at the delay of best correlation."""
    lag, together = _best_delay(trial)
    u, y = trial.command[: len(trial) - lag], trial.angle[lag:]
    u, y = u - u.mean(), y - y.mean()
    slope = float(u @ y / (u @ u))
    delay = f", {lag * trial.dt:.2g} s later" if lag else ""
    text = f"{slope:.3g} {trial.units.angle} per {trial.units.command} (correlation {together:.2f}{delay})"
    if abs(together) < _FOLLOWS:
        why = "; a play wider than the motion, a long delay, or signals of two devices?"
        return Finding(Severity.WARNING, "sign", f"the angle hardly follows the command: {text}{why}")
    if together >= 0:
        return Finding(Severity.OK, "sign", f"the angle rises with the command: {text}")
    advice = "flip one of them"
    if together > -_SURE:
        advice = "feedback, a long delay or two clocks may be why; flip one only if it is wired so"
    return Finding(Severity.WARNING, "sign", f"the angle falls as the command rises: {text}; {advice}")


def _best_delay(trial: Trial) -> tuple[int, float]:
    """Delay of best correlation within plausible limits [samples], and the correlation; 0 without a clear gain."""
    u, y = trial.command, trial.angle
    lags, like = correlations(u, y, min(round(DELAY_S / trial.dt), len(trial) // 4))
    like = like[lags >= 0]
    now = float(like[0])
    same, other = like * np.sign(now or 1.0), -like * np.sign(now or 1.0)
    if other.max() >= _ALIKE and 1 - float(other.max()) ** 2 < _FAR_MORE * (1 - float(same.max()) ** 2):
        best = int(np.argmax(other))
        return best, float(like[best])
    fallen = np.flatnonzero(same < 0.5 * np.maximum.accumulate(same))
    best = int(np.argmax(same[: int(fallen[0])] if fallen.size else same))
    useful = 1 - same[best] ** 2 < _MUCH_MORE * (1 - now**2)
    # A weak correlation that only increases with the delay, as of a force and its motion, gives no sign.
    best = best if useful and (abs(now) >= _FOLLOWS or same[best] >= _ALIKE) else 0
    return best, float(like[best])


def _excitation(trial: Trial, parts: Segments) -> Finding:
    count = parts.reversals.size
    speed = np.abs(np.diff(trial.command)) / trial.dt
    text = f"{count} reversals of the command, fastest {float(speed.max()):.3g} {trial.units.command}/s"
    if not count:
        return Finding(Severity.WARNING, "excitation", f"{text}: hysteresis shows only after a reversal")
    return Finding(Severity.OK, "excitation", text)


def _segments(trial: Trial, parts: Segments) -> Finding:
    texts = []
    for motion in (Motion.LOADING, Motion.UNLOADING, Motion.HOLD):
        seconds = float(np.count_nonzero(parts.labels == motion)) * trial.dt
        texts.append(f"{len(parts.runs(motion))} {motion.name.lower()} ({seconds:.3g} s)")
    return Finding(Severity.OK, "segments", ", ".join(texts))


SAME = 0.005
"""Share of the command's range within which two rests count as one command."""

LEAST_SET = 0.02
"""Least share of the angle's range that counts as a change; three times the noise of an electromagnetic tracker."""

_LEAST_NOISES = 4.0  # standard errors
_BENDS = 0.2  # of the range of the angle: a smaller first flexure gives no direction of the angle
_SAME_READING = 1e-6  # of the range of the angle
_TAIL = 0.5  # share of a rest, at its end, that is evaluated
_CREEP = 0.5  # greatest share of the bend due to creep
_FULL_LOOP = 1.2  # least ratio of the gap at the start to that half-way if plays from rest are not its cause


@dataclass(frozen=True)
class HoldEnd:
    """State at the end of a hold of the command."""

    start: int
    stop: int
    command: float
    angle: float  # recorded angle nearest to the mean: the median
    error: float
    drift: float  # upper bound of the angle's speed: its estimate plus one standard error [angle/s]


def _first_flexure(trial: Trial, parts: Segments) -> Finding:
    """Permanent set after the first flexure: change of the angle between two rests at one command.

    Lag, drift and creep are excluded. Creep of time constant tau and drift d is d tau away from its end, and at most
    0.5 T / tau of the bend after the time T: for every tau at most sqrt(0.5 d T bend).

    A play can leave the angle above its start after an upward flexure, but not below it: a change below is a set. For a
    change above, the gap between loading and unloading decides: if the play starts between its middle and the side of
    the flexure, as for a command that starts at the end of its range, this gap is never wider at the start than
    half-way. Otherwise the cause is a set or a play with another start.
    """
    unit, u = trial.units.command, trial.command
    if not parts.reversals.size:
        return _no_two_rests("", "the command never turns back")
    top, span = int(parts.reversals[0]), float(np.ptp(u))
    opening = f"ends at {trial.t[top]:.4g} s, at {u[top]:.3g} {unit}; "
    steps = np.abs(np.diff(trial.angle))
    grain = 2 * float(steps[steps > _SAME_READING * np.ptp(trial.angle)].min(initial=float(np.ptp(trial.angle))))
    rests = [_rest(trial, start, stop, grain) for start, stop in parts.holds]
    before = next((r for r in rests if r.start < top and abs(r.command - u[top]) > SAME * span), None)
    if before is None:
        return _no_two_rests(opening, "the command does not rest before it")
    later = [r for r in rests if r.start > top and abs(r.command - before.command) <= SAME * span]
    finding = _no_two_rests(opening, f"the command does not rest again at {before.command:.4g} {unit}, where it began")
    for after in later:
        finding = _set(trial, before, after, top, opening)
        if finding.severity is not Severity.NOTE:
            break
    return finding


def _no_two_rests(opening: str, why: str) -> Finding:
    advice = "it takes two rests of the command at one value, one before and one after the first motion"
    return Finding(Severity.NOTE, "first flexure", f"{opening}a set cannot be told: {why}; {advice}")


def _set(trial: Trial, before: HoldEnd, after: HoldEnd, top: int, opening: str) -> Finding:
    bend, change = float(np.ptp(trial.angle)), after.angle - before.angle
    elapsed, moved = trial.t[after.stop - 1] - trial.t[before.stop - 1], trial.t[after.start] - trial.t[before.stop - 1]
    drift = max(before.drift, after.drift)
    creeping = max(drift * float(elapsed), float(np.sqrt(_CREEP * drift * moved * bend)))
    topic, out = "first flexure", trial.units.angle
    text = (
        f"{opening}at rest at {after.command:.4g} {trial.units.command} the angle was {before.angle:.4g} {out} before "
        f"it and is {after.angle:.4g} {out} after it"
    )
    if abs(change) <= max(LEAST_SET * bend, _LEAST_NOISES * float(np.hypot(before.error, after.error))):
        return Finding(Severity.OK, topic, f"{text}: it comes back")
    if abs(change) <= creeping:
        why = "the angle had not come to rest in the holds, or is too noisy there"
        return Finding(Severity.NOTE, topic, f"{opening}a set cannot be told: {why}")
    what = f"{change:+.2g} {out}, by a set or by a play that began elsewhere"
    if not _may_be_play(trial, before, after, top):
        what = f"a set of {change:+.2g} {out}"
    return Finding(Severity.WARNING, topic, f"{text}: {what}; score later motions only (--skip-first-flexure)")


def _rest(trial: Trial, start: int, stop: int, grain: float) -> HoldEnd:
    """Angle at the end of a hold; `grain` is the largest drift that a constant reading may hide."""
    first = max(stop - max(2, round((stop - start) * _TAIL)), start)
    t, y = trial.t[first:stop], trial.angle[first:stop]
    median = float(np.partition(y, y.size // 2)[y.size // 2])
    moment = t - t.mean()
    power = float(moment @ moment)
    slope = float(moment @ y) / power if power > 0 else 0.0
    grain = grain if float(np.ptp(y)) <= _SAME_READING * float(np.ptp(trial.angle)) else 0.0
    noise, seconds = float(np.std(y - y.mean() - slope * moment)), float(np.ptp(t)) or trial.dt
    error = noise / np.sqrt(power) if power > 0 else 0.0
    command, uncertain = float(np.median(trial.command[start:stop])), noise / y.size**0.5 + grain / 8
    return HoldEnd(start, stop, command, median, uncertain, abs(slope) + error + grain / seconds)


def _may_be_play(trial: Trial, before: HoldEnd, after: HoldEnd, top: int) -> bool:
    """Whether a play with another initial state explains a change of the angle between two rests."""
    u, y = trial.command, trial.angle
    span, change = float(np.ptp(u)), after.angle - before.angle
    way = y[before.stop : top + 1 + round(DELAY_S / trial.dt)] - before.angle
    farthest = float(way[np.argmax(np.abs(way))])
    if abs(farthest) < _BENDS * float(np.ptp(y)):
        return True
    out, rises = float(np.sign(u[top] - before.command)), float(np.sign(farthest))
    if change * rises < 0:
        return float((out * (u[top : after.start + 1] - before.command)).min()) < -SAME * span
    at_end = min(abs(before.command - u.min()), abs(before.command - u.max())) <= SAME * span
    if not at_end or abs(before.command) > SAME * span:
        return True
    half = 0.5 * (before.command + float(u[top]))
    there, back = _at(u, y, before.stop - 1, top, half), _at(u, y, top, after.start, half)
    if there is None or back is None:
        return True
    gap = (back - there) * rises
    middle, start = 0.5 * (there + back), 0.5 * (before.angle + after.angle)
    far = abs(float(y[top]) - middle)  # the slopes of the first and second half of the flexure differ by this ratio
    steeper = max(1.0, abs(middle - start) / far if far > 0 else np.inf)
    return not abs(change) > _FULL_LOOP * steeper * max(gap, 0.0)


def _at(u: Vec, y: Vec, start: int, stop: int, level: float) -> float | None:
    """Angle at which the command first crosses a level between two samples; None if it does not."""
    side = u[start : stop + 1] >= level
    passed = np.flatnonzero(side[1:] != side[:-1])
    if not passed.size:
        return None
    k = start + int(passed[0])
    share = (level - u[k]) / (u[k + 1] - u[k])
    return float(y[k] + share * (y[k + 1] - y[k]))


def _numbers(values: Vec, scale: float, offset: float) -> Vec:
    """Logged numbers (T,) of a signal = scale * number + offset; integers are exact."""
    if scale == 1.0 and offset == 0.0:
        return values
    numbers = (values - offset) / scale
    whole = np.rint(numbers)
    return np.where(np.abs(numbers - whole) <= _ROUNDING * np.maximum(np.abs(numbers), 1.0), whole, numbers)


def encoding_findings(
    trial: Trial, scales: Mapping[str, tuple[float, float]], where: Callable[[int], str]
) -> tuple[list[Finding], Trial]:
    """Findings on missing-value codes, wraps and sign bits of command and angle, and the decoded trial.

    `scales` are scale and offset from logged numbers to `command` and `angle`; 1 and 0 if left out.
    """
    findings = []
    signals = {"angle": trial.angle, "command": trial.command}
    for name in signals:
        scale, offset = scales.get(name, (1.0, 0.0))
        other = signals["command" if name == "angle" else "angle"]
        known = np.flatnonzero(np.isfinite(other))
        if known.size < 2:
            break
        numbers = _numbers(signals[name][known], scale, offset)
        repairs = encodings(numbers, other[known], trial.dt, is_command=name == "command")
        if repairs:
            whole = np.full(len(trial), np.nan)
            whole[known] = scale * repairs[-1].values + offset
            signals[name] = whole
        for repair in repairs:
            at = where(int(known[repair.samples[0]]))
            findings.append(Finding(Severity.ERROR, f"numbers of {name}", _encoding(repair, name, known.size, at)))
    if not findings:
        return [], trial
    kept = np.isfinite(signals["command"]) & np.isfinite(signals["angle"])
    if np.count_nonzero(kept) < 2:
        return findings, trial
    t = trial.t[kept]
    repaired = Trial(t, signals["command"][kept], signals["angle"][kept], units=trial.units, source=trial.source)
    return findings, repaired


def _encoding(encoding: Encoding, name: str, count: int, where: str) -> str:
    value, times = f"{encoding.value:.10g}", len(encoding.samples)
    if encoding.key == "missing":
        return (
            f"{times} of {count} are {value}, first at {where}: a code for a missing value; a mapping file with "
            f"`{name}: {{..., missing: [{value}]}}` leaves them out"
        )
    if encoding.key == "sign_bit":
        return (
            f"{times} jumps by about {2**encoding.value:g}, first at {where}: bit {value} is the sign; a mapping file "
            f"with `{name}: {{..., sign_bit: {value}}}` reads it"
        )
    exact = "" if encoding.value in MODULI else ", or the sensor's own exact range,"
    return (
        f"{times} jumps by about {value}, first at {where}: it wraps there; a mapping file with "
        f"`{name}: {{..., wraps_at: {value}}}`{exact} takes them out"
    )
