"""Time shift between command and output that no device explains: two clocks in one log."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .segments import turning_points
from .types import Index, Vec, lagged

DELAY_S = 2.0
"""Greatest plausible delay of an angle after its command [s]; smaller shifts are not distinguished from it."""

IMPOSSIBLE_S = 0.5
"""Lead of an angle that no response explains, even with a slow sensor of the command [s]."""

_EARLY_S = 0.25  # greatest delay of a measured command
_GRID = 1500  # greatest number of evaluated samples
_LEAST = 50  # least number of evaluated samples of a signal
_LONGEST = 0.5  # greatest shift as a share of the log; the rest is the common part
_LIKE = 0.9  # least correlation at a reported shift
_TURNS, _TURN = 4, 0.1  # compared reversals, and their size in ranges of the command: fewer may be like by chance
_KNOWN = 0.8  # correlation above which an angle follows its command, or a command its own past
_GONE = 0.5  # correlation below which a command no longer repeats itself
_BETTER = 0.3  # of the variance that no delay of a device explains
_LAGS_S = np.geomspace(0.1, 60.0, 9)  # time constants of a slow device, the alternative to a shift


@dataclass(frozen=True)
class ClockShift:
    """Shift of the angle's time stamps against the command's."""

    late_s: float  # delay of the angle's stamps [s]; negative if they are early
    correlation: float  # of angle and command after removal of the shift
    without: float  # correlation before removal of the shift

    @property
    def text(self) -> str:
        """Description of the shift, with the key of a mapping file that removes it."""
        late = "later" if self.late_s > 0 else "earlier"
        return (
            f"the angle answers {abs(self.late_s):.3g} s {late} than the command was given (correlation "
            f"{self.without:.2f}, {self.correlation:.2f} without this shift): two clocks? A mapping file with "
            f"`angle: {{..., shift_s: {-self.late_s:.3g}}}` moves it"
        )


def clock_shift(t: Vec, command: Vec, angle: Vec) -> ClockShift | None:
    """Time shift between command and angle that no device explains; None if there is none.

    A shift is reported if it gives a correlation of at least 0.9 and leaves less than 0.3 of the variance that remains
    after every delay of up to `DELAY_S` and every first-order lag. If a delay of a device gives such a correlation too,
    only a lead beyond `IMPOSSIBLE_S` is reported. No shift is reported if the command repeats itself after this time:
    shifts by a period are indistinguishable.
    """
    duration = float(t[-1] - t[0])
    dt = max(duration / _GRID, float(np.median(np.diff(t))))
    grid = np.arange(t[0], t[-1], dt)
    if grid.size < _LEAST or np.ptp(command) == 0 or np.ptp(angle) == 0:
        return None
    u, y = np.interp(grid, t, command), np.interp(grid, t, angle)
    lags, like = correlations(u, y, round(_LONGEST * grid.size))
    size = np.abs(like)
    best = int(np.argmax(size))
    device = (lags * dt >= -_EARLY_S) & (lags * dt <= DELAY_S)
    if device[best] or size[best] < _LIKE:
        return None
    common = u[: u.size - lags[best]] if lags[best] > 0 else u[-lags[best] :]
    if turning_points(common, _TURN * float(np.ptp(u)))[1].size < _TURNS:
        return None
    as_it_is = _like_a_device(u, y, int(lags[best]), dt, size[device])
    excused = as_it_is > _LIKE and lags[best] * dt >= -IMPOSSIBLE_S
    if excused or _repeats(u, int(lags[best]), round(DELAY_S / dt)):
        return None
    left, left_by_device = 1 - size[best] ** 2, 1 - as_it_is**2
    if left > _BETTER * left_by_device or left > _BETTER * _left_by_lags(u, y, dt):
        return None
    return ClockShift(float(lags[best] * dt), float(like[best]), float(like[lags == 0][0]))


def _repeats(u: Vec, lag: int, slack: int) -> bool:
    """Whether the command is so periodic that delays of `lag` and of up to `slack` samples are indistinguishable."""
    near, far = (lag - slack, lag) if lag > 0 else (-lag, slack - lag)
    _, like = correlations(u, u, min(far, u.size - 10))
    later = np.abs(like[like.size // 2 :])  # from no lag on
    gone = int(np.argmax(later < _GONE)) if np.any(later < _GONE) else later.size
    return bool(np.any(later[max(near, gone) :] > _KNOWN))


def _like_a_device(u: Vec, y: Vec, lag: int, dt: float, whole: Vec) -> float:
    """Greatest correlation at a plausible delay of a device: of the whole log, and of the compared parts."""
    greatest, count = [float(whole.max())], u.size - abs(lag)
    for part in (slice(0, count), slice(u.size - count, u.size)):
        lags, like = correlations(u[part], y[part], round(DELAY_S / dt))
        greatest.append(float(np.abs(like[lags * dt >= -_EARLY_S]).max()))
    return max(greatest)


def shift_between(command_t: Vec, command: Vec, angle_t: Vec, angle: Vec) -> ClockShift | None:
    """Time shift between two signals with separate clocks; None if they do not correlate."""
    duration = max(float(np.ptp(command_t)), float(np.ptp(angle_t)))
    dt = duration / _GRID
    if not dt > 0:
        return None
    first, second = (np.arange(t[0], t[-1], dt) for t in (command_t, angle_t))
    if min(first.size, second.size) < _LEAST:
        return None
    u, y = np.interp(first, command_t, command), np.interp(second, angle_t, angle)
    lags, like = correlations(u, y, round(_LONGEST * min(u.size, y.size)))
    best = int(np.argmax(np.abs(like)))
    if abs(like[best]) < _LIKE:
        return None
    return ClockShift(float(lags[best] * dt + angle_t[0] - command_t[0]), float(like[best]), float("nan"))


def correlations(u: Vec, y: Vec, most: int) -> tuple[Index, Vec]:
    """Lags (L,) from -`most` to `most` samples, and correlations (L,) of y(k + lag) with u(k) over common samples."""
    n, m = u.size, y.size
    u, y = u - u.mean(), y - y.mean()
    size = 1 << (n + m).bit_length()
    lags = np.arange(-most, most + 1)

    def cross(a: Vec, b: Vec) -> Vec:
        spectrum = np.conj(np.fft.rfft(a, size)) * np.fft.rfft(b, size)
        return np.asarray(np.fft.irfft(spectrum, size)[lags], dtype=np.float64)

    ones_u, ones_y = np.ones(n), np.ones(m)
    count = np.maximum(cross(ones_u, ones_y), 1.0)
    sum_u, sum_y = cross(u, ones_y), cross(ones_u, y)
    power_u = cross(u * u, ones_y) - sum_u**2 / count
    power_y = cross(ones_u, y * y) - sum_y**2 / count
    together = cross(u, y) - sum_u * sum_y / count
    # With hardly any motion in the common part, correlation is due to chance.
    moves = (power_u > 0.1 * count * u.var()) & (power_y > 0.1 * count * y.var())
    scale = np.sqrt(np.where(moves, power_u * power_y, 1.0))
    return lags, np.asarray(np.where(moves, together / scale, 0.0), dtype=np.float64)


def _left_by_lags(u: Vec, y: Vec, dt: float) -> float:
    """Least unexplained variance share of y, over models of u: first-order lag plus direct term."""
    least = 1.0
    for tau in _LAGS_S:
        columns = np.column_stack([np.ones(u.size), lagged(u, math.exp(-dt / tau)), u])
        residual = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
        least = min(least, float(residual.var() / y.var()))
    return least
