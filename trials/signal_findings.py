"""Findings on the signals of a log: how their numbers are written, units, sign, motion and the first flexure."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from .clock_shift import DELAY_S, ClockShift, clock_shift, correlations
from .encodings import MODULI, Encoding, encodings
from .errors import LogError
from .findings import Finding, Severity
from .first_flexure import Verdict, first_flexure
from .layouts import Layout
from .segments import Motion, Segments, segment
from .trial import Trial, parts_at_gaps, resample
from .types import Vec

_SEGMENT_RATE_HZ = 50.0  # enough for tip motions up to a few Hz
_FOLLOWS, _SURE = 0.3, 0.85  # correlation of angle and command below which the sign cannot be told, or is in doubt
_MUCH_MORE, _FAR_MORE = 0.5, 0.1  # of the variance left without a delay, or with the other sign
_ALIKE = 0.95  # correlation at a delay that tells the sign where that without one does not
_ROUNDING = 1e-9

# Range of a signal -> what its numbers look like: (from, to, suspicion); between the rows they look right. Only where
# travel in mm or pressure in bar bends a tip by degrees: of any other device nothing is known that could be compared.
_MISTAKEN: dict[str, tuple[tuple[float, float, str], ...]] = {
    "mm": ((0.0, 0.05, "metres"), (200.0, np.inf, "micrometres")),
    "bar": ((0.0, 0.02, "MPa or a valve signal"), (20.0, 5e3, "kPa or psi"), (5e3, np.inf, "Pa")),
    "deg": ((0.0, 3.5, "radians"), (400.0, np.inf, "sensor counts")),
}


_COMMANDS, _ANGLES, _ANY = (-100.0, 100.0), (-200.0, 200.0), (-np.inf, np.inf)  # plausible values: mm or bar, deg


def motion_findings(trial: Trial, layout: Layout) -> Iterator[Finding]:
    """Findings on a trial whose values are finite and in order."""
    span = float(np.ptp(trial.command))
    bends = trial.units.angle == "deg" and trial.units.command in ("mm", "bar")
    ranges = (layout.command_range or _COMMANDS, layout.angle_range or _ANGLES) if bends else (_ANY, _ANY)
    yield _units("command", trial.command, trial.units.command, ranges[0], bends)
    yield _units("angle", trial.angle, trial.units.angle, ranges[1], bends)
    if span == 0:
        text = f"the command is {trial.command[0]:g} {trial.units.command} throughout: nothing can be identified"
        yield Finding(Severity.ERROR, "excitation", text)
        return
    if np.ptp(trial.angle) == 0:
        text = f"the angle is {trial.angle[0]:g} {trial.units.angle} throughout: nothing can be identified"
        yield Finding(Severity.ERROR, "excitation", text)
        return
    shift = clock_shift(trial.t, trial.command, trial.angle)
    if shift is not None:
        yield Finding(Severity.WARNING, "clocks", shift_said(shift))
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


def shift_said(shift: ClockShift) -> str:
    """A shift in words, with the key of a mapping file that takes it out."""
    late = "later" if shift.late_s > 0 else "earlier"
    return (
        f"the angle answers {abs(shift.late_s):.3g} s {late} than the command was given (correlation "
        f"{shift.without:.2f}, {shift.correlation:.2f} without this shift): two clocks? A mapping file with "
        f"`angle: {{..., shift_s: {-shift.late_s:.3g}}}` moves it"
    )


def _moved(trial: Trial, late_s: float) -> Trial:
    """The trial with its angle earlier by `late_s`, as far as both are known."""
    at = trial.t + late_s
    inside = (at >= trial.t[0]) & (at <= trial.t[-1])
    angle = np.interp(at[inside], trial.t, trial.angle)
    return Trial(trial.t[inside], trial.command[inside], angle, units=trial.units, source=trial.source)


def _units(name: str, values: Vec, unit: str, plausible: tuple[float, float], bends: bool) -> Finding:
    low, high, topic = float(values.min()), float(values.max()), f"units of {name}"
    text = f"{low:.4g} to {high:.4g} {unit}"
    for least, most, suspicion in _MISTAKEN.get(unit, ()) if bends else ():
        # 30.0 to 30.1 is no angle in radians: a signal in a larger unit has small values, not a small range alone.
        if least < high - low <= most and max(-low, high) <= 2 * most:
            return Finding(Severity.WARNING, topic, f"{text}: looks like {suspicion}, expected {unit}")
    if low < plausible[0] or high > plausible[1]:
        return Finding(
            Severity.WARNING, topic, f"{text}: expected {plausible[0]:g} to {plausible[1]:g}; offset or another unit?"
        )
    return Finding(Severity.OK, topic, text)


def _sign(trial: Trial) -> Finding:
    """Does the angle rise with the command, and by how much; at the delay at which it follows best."""
    lag, together = _best_delay(trial)
    u, y = trial.command[: len(trial) - lag], trial.angle[lag:]
    u, y = u - u.mean(), y - y.mean()
    slope = float(u @ y / (u @ u))
    delay = f", {lag * trial.dt:.2g} s later" if lag else ""
    text = f"{slope:.3g} {trial.units.angle} per {trial.units.command} (correlation {together:.2f}{delay})"
    if abs(together) < _FOLLOWS:
        return Finding(Severity.WARNING, "sign", f"the angle hardly follows the command: {text}{_WHY}")
    if together >= 0:
        return Finding(Severity.OK, "sign", f"the angle rises with the command: {text}")
    advice = "flip one of them"
    if together > -_SURE:
        advice = "feedback, a long delay or two clocks may be why; flip one only if it is wired so"
    return Finding(Severity.WARNING, "sign", f"the angle falls as the command rises: {text}; {advice}")


_WHY = "; a play wider than the motion, a long delay, or signals of two devices?"


def _best_delay(trial: Trial) -> tuple[int, float]:
    """Delay of the angle [samples] of those that a device may have, and the correlation there; 0 if none adds much.

    A periodic command is like its opposite half a period later: the sign is that without a delay, unless the other one
    leaves next to nothing.
    """
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
    # Of a weak likeness that only grows with the delay, such as that of a force and its motion, nothing is known.
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


def _first_flexure(trial: Trial, parts: Segments) -> Finding:
    """Whether the first flexure left a set, as far as two rests at one command tell."""
    topic, unit, out = "first flexure", trial.units.command, trial.units.angle
    found = first_flexure(trial, parts)
    opening = ""
    if parts.reversals.size:
        top = int(parts.reversals[0])
        opening = f"ends at {trial.t[top]:.4g} s, at {trial.command[top]:.3g} {unit}; "
    if found.verdict is Verdict.UNKNOWN or found.before is None or found.after is None:
        text = f"{opening}a set cannot be told: {found.why}{'' if found.after else _TWO_RESTS}"
        return Finding(Severity.NOTE, topic, text)
    before, after, change = found.before, found.after, found.change
    text = (
        f"{opening}at rest at {after.command:.4g} {unit} the angle was {before.angle:.4g} {out} before it and is "
        f"{after.angle:.4g} {out} after it"
    )
    if found.verdict is Verdict.NONE:
        return Finding(Severity.OK, topic, f"{text}: it comes back")
    what = f"a set of {change:+.2g} {out}"
    if found.verdict is Verdict.SET_OR_PLAY:
        what = f"{change:+.2g} {out}, by a set or by a play that began elsewhere"
    return Finding(Severity.WARNING, topic, f"{text}: {what}; score later motions only (--skip-first-flexure)")


_TWO_RESTS = "; it takes two rests of the command at one value, one before and one after the first motion"


@dataclass(frozen=True)
class Written:
    """How a signal came from the number in the log: value = scale * number + offset."""

    scale: float = 1.0
    offset: float = 0.0

    def number(self, values: Vec) -> Vec:
        """The numbers (T,) in the log, whole ones exactly so."""
        if self.scale == 1.0 and self.offset == 0.0:
            return values
        numbers = (values - self.offset) / self.scale
        whole = np.rint(numbers)
        return np.where(np.abs(numbers - whole) <= _ROUNDING * np.maximum(np.abs(numbers), 1.0), whole, numbers)

    def value(self, numbers: Vec) -> Vec:
        """The signal (T,) of numbers in the log."""
        return self.scale * numbers + self.offset


def encoding_findings(
    trial: Trial, written: tuple[Written, Written], where: Callable[[int], str]
) -> tuple[list[Finding], Trial]:
    """Codes, wraps and sign bits among the numbers of command and angle, and the trial without them.

    Args:
        trial: as read.
        written: how command and angle were made of the numbers in the log.
        where: names a sample for the reader.
    """
    found = []
    signals = {"angle": trial.angle, "command": trial.command}
    for name, form in (("angle", written[1]), ("command", written[0])):
        other = signals["command" if name == "angle" else "angle"]
        known = np.flatnonzero(np.isfinite(other))
        if known.size < 2:
            break
        numbers = form.number(signals[name][known])
        repairs = encodings(numbers, other[known], trial.dt, is_command=name == "command")
        if repairs:
            whole = np.full(len(trial), np.nan)
            whole[known] = form.value(repairs[-1].values)
            signals[name] = whole
        for repair in repairs:
            at = where(int(known[repair.samples[0]]))
            found.append(Finding(Severity.ERROR, f"numbers of {name}", _encoding(repair, name, known.size, at)))
    if not found:
        return [], trial
    kept = np.isfinite(signals["command"]) & np.isfinite(signals["angle"])
    if np.count_nonzero(kept) < 2:
        return found, trial
    t = trial.t[kept]
    repaired = Trial(t, signals["command"][kept], signals["angle"][kept], units=trial.units, source=trial.source)
    return found, repaired


def _encoding(found: Encoding, name: str, count: int, where: str) -> str:
    value, times = f"{found.value:.10g}", len(found.samples)
    if found.key == "missing":
        return (
            f"{times} of {count} are {value}, first at {where}: a code for a missing value; a mapping file with "
            f"`{name}: {{..., missing: [{value}]}}` leaves them out"
        )
    if found.key == "sign_bit":
        return (
            f"{times} jumps by about {2**found.value:g}, first at {where}: bit {value} is the sign; a mapping file "
            f"with `{name}: {{..., sign_bit: {value}}}` reads it"
        )
    exact = "" if found.value in MODULI else ", or the sensor's own exact range,"
    return (
        f"{times} jumps by about {value}, first at {where}: it wraps there; a mapping file with "
        f"`{name}: {{..., wraps_at: {value}}}`{exact} takes them out"
    )
