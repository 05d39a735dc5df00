"""Quality of a log's motion: units, sign, excitation, segments, and what the first flexure left behind."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .errors import LogError
from .findings import Finding, Severity
from .presets import Preset
from .resample import resample
from .segments import Motion, Segments, segment
from .trial import Trial
from .types import Vec

_SEGMENT_RATE_HZ = 50.0  # enough for tip motions up to a few Hz
_RETURN_SHARE = 0.05  # of the command's range: nearer to its start counts as back at its start
_SET_DEG = 1.0  # about three times the noise of an electromagnetic tracker
_FOLLOWS = 0.3  # correlation of angle and command below which the sign cannot be told

# Range of a signal -> what its numbers look like: (from, to, suspicion); between the rows they look right.
_MISTAKEN: dict[str, tuple[tuple[float, float, str], ...]] = {
    "mm": ((0.0, 0.05, "metres"), (200.0, np.inf, "micrometres")),
    "bar": ((0.0, 0.02, "MPa or a valve signal"), (20.0, 5e3, "kPa or psi"), (5e3, np.inf, "Pa")),
    "deg": ((0.0, 3.5, "radians"), (400.0, np.inf, "sensor counts")),
}


def motion_findings(trial: Trial, preset: Preset) -> Iterator[Finding]:
    """Findings on a trial whose values are finite and in order."""
    span = float(np.ptp(trial.command))
    yield _units("command", trial.command, trial.units.command, preset.command_range)
    yield _units("angle", trial.angle, trial.units.angle, preset.angle_range)
    if span == 0:
        text = f"the command is {trial.command[0]:g} {trial.units.command} throughout: nothing can be identified"
        yield Finding(Severity.ERROR, "excitation", text)
        return
    yield _sign(trial)
    try:
        even = resample(trial, min(_SEGMENT_RATE_HZ, 1 / trial.dt))
    except LogError as error:
        yield Finding(Severity.ERROR, "segments", f"not looked for: {str(error).removeprefix(f'{trial.source}: ')}")
        return
    parts = segment(even)
    yield _excitation(even, parts)
    yield _segments(even, parts)
    yield _first_flexure(even, parts)


def _units(name: str, values: Vec, unit: str, plausible: tuple[float, float]) -> Finding:
    low, high, topic = float(values.min()), float(values.max()), f"units of {name}"
    text = f"{low:.4g} to {high:.4g} {unit}"
    for least, most, suspicion in _MISTAKEN.get(unit, ()):
        if least < high - low and least <= high - low <= most:
            return Finding(Severity.WARNING, topic, f"{text}: looks like {suspicion}, expected {unit}")
    if low < plausible[0] or high > plausible[1]:
        return Finding(
            Severity.WARNING, topic, f"{text}: expected {plausible[0]:g} to {plausible[1]:g}; offset or another unit?"
        )
    return Finding(Severity.OK, topic, text)


def _sign(trial: Trial) -> Finding:
    """Does the angle rise with the command, and by how much."""
    u, y = trial.command - trial.command.mean(), trial.angle - trial.angle.mean()
    power = float(np.sqrt((u @ u) * (y @ y)))
    together = float(u @ y) / power if power > 0 else 0.0
    text = f"{float(u @ y / (u @ u)):.3g} deg per {trial.units.command} (correlation {together:.2f})"
    if abs(together) < _FOLLOWS:
        return Finding(Severity.WARNING, "sign", f"the angle hardly follows the command: {text}")
    if together < 0:
        return Finding(Severity.WARNING, "sign", f"the angle falls as the command rises: {text}; flip one of them")
    return Finding(Severity.OK, "sign", f"the angle rises with the command: {text}")


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
    """Compare the angle before the first flexure with the one when the command is back."""
    topic, unit, u, y = "first flexure", trial.units.command, trial.command, trial.angle
    if not parts.reversals.size:
        return Finding(Severity.NOTE, topic, "the command never turns back, so a set cannot be told")
    top = int(parts.reversals[0])
    low = int(parts.reversals[1]) if parts.reversals.size > 1 else len(trial) - 1
    opening = f"ends at {trial.t[top]:.4g} s, {y[top]:.1f} deg at {u[top]:.3g} {unit}"
    if abs(u[low] - u[0]) > _RETURN_SHARE * float(np.ptp(u)):
        way_up = float(y[int(np.argmin(np.abs(u[: top + 1] - u[low])))])
        return Finding(
            Severity.NOTE,
            topic,
            f"{opening}; the command does not come back to its start ({u[0]:.3g} {unit}), so a set cannot be told "
            f"from hysteresis: at {u[low]:.3g} {unit} the angle was {way_up:.1f} deg on the way there and "
            f"{y[low]:.1f} deg back",
        )
    left = float(y[low] - y[0])
    text = f"{opening}; the angle was {y[0]:.1f} deg before and is {y[low]:.1f} deg after it: a set of {left:+.1f} deg"
    if abs(left) > _SET_DEG:
        advice = "; score later motions only (--skip-first-flexure)"
        return Finding(Severity.WARNING, topic, text + advice)
    return Finding(Severity.OK, topic, text)
