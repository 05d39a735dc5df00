"""Encodings of logged numbers: codes for missing values, wraps of a counter or angle, a sign bit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .clocks import plainest, runs
from .types import Index, Mask, Vec

Key = Literal["missing", "wraps_at", "sign_bit"]

CODES = (
    999.0, 9999.0, 99999.0, 999999.0, 9999999.0, 999.9, 999.99, 9999.99, 32767.0, 32768.0, 65535.0, 8388607.0,
    8388608.0, 16777215.0, 2147483647.0, 2147483648.0, 4294967295.0, 1e6, 1e9, 1e10, 1e20, 1e30, 1e31, 1e38,
)  # fmt: skip
"""Magnitudes that loggers write in place of a missing value, with any sign."""

MODULI = (
    np.pi, 2 * np.pi, 1.0, 90.0, 100.0, 180.0, 200.0, 360.0, 400.0, 720.0, 1000.0, 1440.0, 1800.0, 2000.0, 3600.0,
    4000.0, 6400.0, 8000.0, 10000.0, 20000.0, 36000.0, *(2.0**bits for bits in range(7, 33)),
)  # fmt: skip
"""Usual moduli of angles and counters: radians, turns, percent, degrees, gons, decimal counts, and 2^n counts."""

_UNUSUAL = (1.0, 90.0, 100.0, 200.0, 400.0, 1000.0, 1800.0, 2000.0, 3600.0, 4000.0, 6400.0, 8000.0, 10000.0, 20000.0)
_CODES = 3  # greatest number of different codes in one signal
_MANY = 0.4  # of the samples: a more frequent value is no code
_FAR, _ANY_FAR = 0.5, 3.0  # ranges of the others by which a known code, or any value, lies outside them
_JUMP = 5.0  # multiple of the greatest usual step above which a step is no motion
_USUAL = 99.5  # percentile of the steps that are usual
_BRIEF_S = 0.25  # longest run of an unlisted code
_ROUNDED = 1e-4  # tolerance of a jump due to rounding, relative to the modulus
_CHOPPY = 0.1  # share of jumps above which a signal has no usual step
_LATE_S = 1.5  # greatest delay of an angle after its command
_CLEARLY = 0.95  # ratio to the error of the previous repair below which another replaces it
_SMOOTH = 2.0  # remaining size of the jumps after a repair, in greatest other steps
_ROUGH = 3.0  # changes of the step, by which the step over a seam may differ from those beside it
_FEW = 2  # jumps
_LEAST = 10  # samples
_LEAST_BIT = 7
_SOFT = (0.0, -1.0)  # codes within the range of many signals: detected only by the jumps
_ASKED = 0.1  # of the range of the command: a step in one sample that can cause a jump of the angle
_KEPT = 0.1  # of the range of the command: a sensor that keeps one reading over more has held it
_NO_WORSE = 1.3  # of the same, for jumps of an angle without a cause in its command
_BETTER = 0.6  # of the variance left unexplained by the other signal, after a repair that counts


@dataclass(frozen=True, eq=False)
class Encoding:
    """Encoding of the numbers of one signal, and the decoded signal."""

    key: Key  # key of a mapping file that decodes it
    value: float  # the code, the modulus, or the bit
    samples: tuple[int, ...]  # samples with a code, or first samples after a jump
    values: Vec  # the decoded signal (T,); not-a-number in place of codes


def unwrapped(values: Vec, modulus: float) -> Vec:
    """Unwrap a signal (T,) by a modulus; its first value is in [-modulus / 2, modulus / 2).

    A step of more than half the modulus counts as a wrap. Not-a-number is ignored and remains.
    """
    known = np.flatnonzero(np.isfinite(values))
    out = values.astype(np.float64)
    if known.size:
        whole = np.unwrap(values[known], period=modulus)
        out[known] = whole - modulus * np.floor(whole[0] / modulus + 0.5)
    return out


def sign_and_magnitude(values: Vec, bit: int) -> Vec:
    """Decode numbers (T,) in sign-magnitude form, with the sign in bit `bit`."""
    return np.where(values >= 2.0**bit, 2.0**bit - values, values)


def decoded(values: Vec, missing: tuple[float, ...], sign_bit: int | None, wraps_at: float | None) -> Vec:
    """Decode a logged signal (T,) by the keys of a mapping file; codes for missing values become not-a-number."""
    out = np.where(np.isin(values, missing), np.nan, values) if missing else values
    out = out if sign_bit is None else sign_and_magnitude(out, sign_bit)
    return out if wraps_at is None else unwrapped(out, wraps_at)


def encodings(values: Vec, other: Vec, dt: float, is_command: bool) -> list[Encoding]:
    """Detect the encodings of one signal, in the order of their decoding.

    A code for a missing value is isolated: the signal jumps to exactly this value and back. Wraps and a sign bit are
    jumps of one size between the ends of the range; without them the other signal explains this one better.

    Args:
        values: as logged (T,), finite.
        other: the command for an angle, the angle for a command (T,).
        dt: usual sample interval [s].
    """
    late = max(1, round(_LATE_S / dt))

    def codes(values: Vec, far_only: bool) -> list[Encoding]:
        kept: list[Encoding] = []
        for _ in range(_CODES):
            last = kept[-1].values if kept else values
            code = _code(last, np.isfinite(last), dt, is_command, far_only)
            if code is None:
                break
            kept.append(code)
        return kept

    repairs = codes(values, far_only=True)
    values = repairs[-1].values if repairs else values
    jumps, others = _jumps(values, other, late, is_command), codes(values, far_only=False)
    # Jumps of any size to one value and back indicate a code.
    if jumps is not None and (not others or _jumps(others[-1].values, other, late, is_command) is not None):
        return [*repairs, jumps]
    return [*repairs, *others]


def _code(values: Vec, known: Mask, dt: float, is_command: bool, far_only: bool) -> Encoding | None:
    """Detect a missing-value code; `far_only` restricts this to listed codes far from all other values."""
    signal, index = values[known], np.flatnonzero(known)
    if signal.size < _LEAST:
        return None
    least, most = float(signal.min()), float(signal.max())
    listed = [c for size in CODES for c in (-size, size) if least <= c <= most]
    soft = [] if is_command else [least, most, *(c for c in _SOFT if least < c < most)]
    for value in listed if far_only else soft:
        here = signal == value
        rest = signal[~here]
        if not 0 < signal.size - rest.size <= _MANY * signal.size or np.unique(rest).size < 3:
            continue
        low, high = (float(end) for end in np.percentile(rest, [1, 99]))
        away = max(low - value, value - high) / max(high - low, 1e-12 * abs(value), 1e-300)
        starts, stops = runs(here)
        # The smaller of the steps into and out of each run of the value; at an end of the log the single one.
        into = np.where(starts > 0, np.abs(value - signal[np.maximum(starts - 1, 0)]), np.inf)
        out = np.where(stops < signal.size, np.abs(signal[np.minimum(stops, signal.size - 1)] - value), np.inf)
        jump, neighbours = np.minimum(into, out), np.abs(np.diff(signal))[~(here[1:] | here[:-1])]
        usual = float(np.percentile(neighbours, _USUAL if far_only else 100.0)) if neighbours.size else 0.0
        isolated = jump > max(_JUMP * usual, 0.2 * (high - low))
        if far_only:
            bad = away > _FAR and bool(isolated.all())
        else:
            brief = isolated & ((stops - starts) * dt <= _BRIEF_S)
            bad = int(np.count_nonzero(brief)) >= 2 and (value in _SOFT or (away > _ANY_FAR and bool(brief.all())))
        if bad:
            cleaned = values.copy()
            cleaned[index[here]] = np.nan
            return Encoding("missing", float(value), tuple(index[here].tolist()), cleaned)
    return None


def _jumps(values: Vec, other: Vec, late: int, is_command: bool) -> Encoding | None:
    """Detect a sign bit or a modulus from jumps of equal size."""
    index = np.flatnonzero(np.isfinite(values))
    signal, witness = values[index], other[index]
    if signal.size < 10:
        return None
    steps = np.diff(signal)
    size = np.abs(steps)
    big = size > 0.5 * float(size.max())
    if float(size.max()) == 0 or np.count_nonzero(big) > _CHOPPY * size.size:
        return None
    usual = float(size[~big].max())
    if usual == 0 or float(np.median(size[big])) < _JUMP * float(np.percentile(size[~big], _USUAL)):
        return None
    before = _unexplained(signal, witness, late, is_command)
    at = tuple(int(index[k + 1]) for k in np.flatnonzero(big))
    if not is_command and _held(signal, witness, np.flatnonzero(big)):
        return None
    # Equal jumps of the angle without jumps of the command are no motion.
    unasked = not is_command and _unasked(witness, np.flatnonzero(big) + 1, late)
    if not unasked and np.count_nonzero(big) < _FEW:
        return None
    best, limit = None, (_NO_WORSE if unasked else _BETTER) * before
    for key, value, repaired in _repairs(signal, size[big], usual):
        longest = float(np.abs(np.diff(repaired)).max())
        smooth = longest <= _SMOOTH * usual and longest <= 0.5 * float(size.max())  # no jump is left
        smooth = smooth and _goes_on(repaired, np.flatnonzero(big))
        if smooth and (left := _unexplained(repaired, witness, late, is_command)) < limit:
            whole = values.copy()
            whole[index] = repaired
            best, limit = Encoding(key, value, at, whole), _CLEARLY * left
    return best


def _goes_on(repaired: Vec, seams: Index) -> bool:
    """Whether the repaired signal crosses at least half of its seams as it moves before and after them.

    A tip that slips also jumps once, but what a modulus then leaves is no motion between that before and that after.
    """
    steps = np.diff(repaired)
    before, after = steps[np.maximum(seams - 1, 0)], steps[np.minimum(seams + 1, steps.size - 1)]
    rough = float(np.percentile(np.abs(np.diff(steps)), 90.0))
    off = np.abs(steps[seams] - 0.5 * (before + after))
    return bool(np.mean(off <= np.abs(after - before) + _ROUGH * rough) >= 0.5)


def _held(signal: Vec, command: Vec, jumps: Index) -> bool:
    """Whether at least half of the jumps end a time in which the sensor kept its reading while the command moved."""
    changed = np.maximum.accumulate(np.where(np.diff(signal, prepend=np.nan) != 0, np.arange(signal.size), 0))
    travels = [float(np.ptp(command[changed[k] : k + 1])) for k in jumps]
    return float(np.median(travels)) > _KEPT * float(np.ptp(command))


def _unasked(command: Vec, jumps: Index, late: int) -> bool:
    """Whether the angle jumps without a preceding step of the command."""
    steps, least = np.abs(np.diff(command, prepend=command[:1])), _ASKED * float(np.ptp(command))
    before = np.cumsum(steps > least)
    return bool(np.all(before[jumps] == before[np.maximum(jumps - late, 0)]))


def _repairs(signal: Vec, jumps: Vec, usual: float) -> list[tuple[Key, float, Vec]]:
    """Possible encodings that explain the jumps, the nearest modulus first."""
    least, most, size = float(signal.min()), float(signal.max()), float(np.median(jumps))
    slack = 2 * usual + 0.02 * size
    if float(np.ptp(jumps)) > 4 * slack:
        return []
    repairs: list[tuple[Key, float, Vec]] = []
    bit = int(np.log2(max(most, 1.0)))
    if least >= 0 and bit >= _LEAST_BIT and np.all(signal == np.rint(signal)):
        low, high = signal[signal < 2.0**bit], signal[signal >= 2.0**bit] - 2.0**bit
        if max(float(low.max(initial=0.0)), float(high.max())) < 0.5 * 2.0**bit:
            repairs.append(("sign_bit", float(bit), sign_and_magnitude(signal, bit)))
    # A motion across the seam shortens the jump by its step: the modulus is no less than the longest one.
    steps = np.abs(np.diff(signal))
    grain = float(steps[steps > 0].min())  # a sensor of coarse steps leaves two moduli open: the usual one is chosen
    shortest = max(float(jumps.max()), most - least)
    longest = shortest + max(float(np.percentile(steps[steps <= usual], _USUAL)), grain) + _ROUNDED * shortest
    near = [m for m in MODULI if (1 - _ROUNDED) * shortest <= m <= longest] or [plainest(shortest, longest)]
    least_seam = min(_seam(signal, m) for m in near)
    near.sort(key=lambda m: (_seam(signal, m) > least_seam + grain, m in _UNUSUAL, _seam(signal, m)))
    return [*repairs, *(("wraps_at", float(m), unwrapped(signal, m)) for m in near)]


def _seam(signal: Vec, modulus: float) -> float:
    """Median mismatch between the jumps and a modulus, corrected for the motion during the jump."""
    steps = np.diff(signal)
    wrapped = np.flatnonzero(np.abs(steps) > 0.5 * modulus)
    neighbours = 0.5 * (steps[np.maximum(wrapped - 1, 0)] + steps[np.minimum(wrapped + 1, steps.size - 1)])
    moved = np.where(np.abs(neighbours) < 0.25 * modulus, np.abs(neighbours), 0.0)
    left = np.abs(steps[wrapped]) + moved - modulus
    return float(np.median(np.abs(left))) if left.size else np.inf


def _unexplained(signal: Vec, witness: Vec, late: int, is_command: bool) -> float:
    """Least unexplained variance share of a linear fit between the signals, over delays of up to `late` samples."""
    count = min(signal.size, witness.size)
    shares = []
    for lag in sorted({round(late * k / 12) for k in range(13)}):
        if count - lag < 10:
            break
        u, y = (signal, witness) if is_command else (witness, signal)
        u, y = u[: count - lag], y[lag:]
        u, y = u - u.mean(), y - y.mean()
        power = float((u @ u) * (y @ y))
        shares.append(1 - float(u @ y) ** 2 / power if power > 0 else 1.0)
    return min(shares, default=1.0)
