"""Structure of motion and error that indicates a cause: stick-slip jumps, and lack of fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.models.identify.cross_validation import Hypothesis
from hystmpc.models.identify.runs import Run
from hystmpc.models.identify.selection import Selection
from hystmpc.trials.types import Mat, Vec

from ..logs.sensor import SensorSigns
from .trial_differences import differences_explained
from .verdict import STILL_OPEN

_KNOTS = 10  # of a curve, in each direction
_SLOW_S = 3.0
# A curved gain alone is no explanation if two free curves of the angle explain more than the first share of the
# remaining structural error, and more than the second share of the whole one.
_CURVE_LEFT, _CURVE_SIZE = 0.7, 0.012
_WANDER = 0.7  # slow change within trials, over the part explained by shifts, above which a shift is no explanation


def structure_left(selection: Selection, runs: Sequence[Run], everything: Sequence[Run], floor_mse: float) -> bool:
    """Lack of fit: whether the only selected effect leaves structure that contradicts it.

    A curved gain must leave no other curve of the angle, shifts between trials no slow change within them, and widths
    of single trials must form groups or follow a measured input.

    Args:
        everything: all runs; small groups show only in all of them.
        floor_mse: error below which there is no evidence [deg^2].
    """
    chosen, retuned = selection.chosen.hypothesis, selection.baseline.hypothesis
    widths = chosen.problem.terms.shift and chosen.problem.terms.width >= 0
    if widths and not differences_explained(chosen, everything):
        return True
    if chosen.effects == {"nonlinear_gain"}:
        before = retuned.mse - floor_mse
        if before <= 0 or chosen.mse < STILL_OPEN * floor_mse:
            return False
        left = remaining_curvature(chosen, runs, floor_mse)
        return left > _CURVE_LEFT and left * (chosen.mse - floor_mse) > _CURVE_SIZE * before
    if chosen.effects == {"trial_shift"}:
        # The model-form error is slow as well and is part of the floor.
        return slow_mse(chosen, runs) - floor_mse > _WANDER * (retuned.mse - chosen.mse)
    return False


def remaining_curvature(hypothesis: Hypothesis, runs: Sequence[Run], floor_mse: float) -> float:
    """Share of the remaining structural error that two free curves of the simulated angle explain, 0 to 1.

    One curve applies while the simulated angle rises and another while it falls, each piecewise linear between ten
    knots at quantiles of the angle. Errors below `floor_mse` [deg^2] are ignored.
    """
    angles, errors = [], []
    for run in runs:
        theta = hypothesis.angles(run)
        rises = np.gradient(theta) >= 0
        angles.append(np.stack([theta, rises], axis=1)[run.counts])
        errors.append((run.angle - theta)[run.counts])
    theta, rises = np.concatenate(angles).T
    error = np.concatenate(errors)
    structural = float(np.mean(error**2)) - floor_mse
    if structural <= 0:
        return 0.0
    columns = _hat_functions(theta)
    columns = np.concatenate([columns * rises[:, None], columns * (1 - rises)[:, None]], axis=1)
    weights = np.linalg.lstsq(columns, error, rcond=None)[0]
    explained = float(np.mean(error**2) - np.mean((error - columns @ weights) ** 2))
    return float(np.clip(explained / structural, 0.0, 1.0))


def slow_mse(hypothesis: Hypothesis, runs: Sequence[Run]) -> float:
    """Mean square of the remaining error after averaging over three seconds [deg^2]: slow change within trials."""
    total, count = 0.0, 0
    for run in runs:
        error, blocks = hypothesis.error(run), run.blocks(_SLOW_S)
        blocks = blocks - blocks.min()
        samples = np.bincount(blocks)
        means = np.bincount(blocks, error)[samples > 0] / samples[samples > 0]
        total, count = total + float(np.sum(means**2)), count + means.size
    return total / count


def _hat_functions(x: Vec) -> Mat:
    knots = np.unique(np.quantile(x, np.linspace(0.0, 1.0, _KNOTS)))
    return np.stack([np.interp(x, knots, row) for row in np.eye(knots.size)], axis=1)


_STEADY_S = 0.4  # of steady motion before and after a sample
_UNEVEN = 0.4  # greatest range of the speed in it, relative to its mean
_ONE_WAY = 1.2  # the same where such motion is rare, as in sines: it does not turn
_NOISES, _STEPS = 5.0, 3.0  # standard deviations and resolutions that the motion in a window has to exceed
_STUCK, _JUMPED, _BACK = 0.3, 2.0, -0.5  # of the simulated motion in a window
_ENOUGH = 100  # windows


@dataclass(frozen=True)
class Jumps:
    """Statistics of the tip motion while the simulated motion is steady.

    In each window, as short as noise and resolution allow, the measured motion is a multiple g of the simulated one.

    Attributes:
        stuck, jumped, back: share of the windows with g below 0.3, above 2, and below -0.5.
        carried: share of the measured motion in windows with g above 2.
        height_deg: median change of the tip's lead over the simulator in a jump [deg].
        fastest_deg_s: 90 % quantile of the simulated speeds of jumps [deg/s].
    """

    windows: int
    stuck: float
    jumped: float
    back: float
    carried: float
    height_deg: float
    fastest_deg_s: float

    @property
    def seen(self) -> bool:
        """Whether the pattern is that of stick-slip."""
        return self.windows >= _ENOUGH and self.stuck > 0.25 and self.carried > 0.25 and self.back < 0.1

    @property
    def absent(self) -> bool:
        """Whether there was enough steady motion to exclude stick-slip."""
        return self.windows >= _ENOUGH and (self.stuck < 0.1 or self.jumped < 0.01)

    @property
    def mse(self) -> float:
        """Mean square [deg^2] of a sawtooth with the height of the jumps: error that no free run can avoid."""
        return self.height_deg**2 / 12.0 if self.seen else 0.0

    def note(self, unit: str) -> str:
        """Note on the jumps for the report, with sizes in a given unit."""
        return (
            f"Stick-slip by its jumps: in {self.stuck:.0%} of {self.windows} windows of steady motion the tip stands "
            f"still, in {self.jumped:.0%} it jumps, by {self.height_deg:.2g} {unit}, at speeds up to "
            f"{self.fastest_deg_s:.2g} {unit}/s. When it lets go cannot be predicted in a free run: what it closes "
            "is the energy of a sawtooth of that height. Shifts between trials are not looked for, since every jump "
            "leaves the tip elsewhere."
        )

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of the effect in the result."""
        return {"jump_deg": self.height_deg, "fastest_deg_s": self.fastest_deg_s}


def find_jumps(runs: Sequence[Run], retuned: Hypothesis, signs: SensorSigns) -> Jumps:
    """Detect stick-slip jumps in steady motion."""
    least = max(_NOISES * signs.noise_deg, _STEPS * signs.quantisation_deg, 1e-9)
    simulated = [retuned.angles(run) for run in runs]
    steady = _pattern(runs, simulated, least, _UNEVEN)
    if steady.windows >= _ENOUGH:
        return steady
    one_way = _pattern(runs, simulated, least, _ONE_WAY)
    return one_way if one_way.seen else steady  # a fast motion may slide where a slow one sticks: it excludes nothing


def _pattern(runs: Sequence[Run], simulated: Sequence[Vec], least: float, uneven: float) -> Jumps:
    """Statistics of the windows in which the simulated speed varies by at most `uneven` of its mean."""
    windows = [_windows(run, theta, least, uneven) for run, theta in zip(runs, simulated, strict=True)]
    share, moved, ahead, speed = np.concatenate(windows).T
    if not share.size:
        return Jumps(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    jumped, whole = share > _JUMPED, float(np.abs(moved).sum())
    return Jumps(
        int(share.size),
        float(np.mean(share < _STUCK)),
        float(np.mean(jumped)),
        float(np.mean(share < _BACK)),
        float(np.abs(moved[jumped]).sum()) / whole if whole else 0.0,
        float(np.median(ahead[jumped])) if jumped.any() else 0.0,
        float(np.quantile(speed[jumped], 0.9)) if jumped.any() else 0.0,
    )


def _windows(run: Run, simulated: Vec, least: float, uneven: float) -> Mat:
    """Ratio of measured to simulated motion, measured motion, its lead [deg] and simulated speed [deg/s] (N, 4)."""
    speed, half = np.diff(simulated), max(round(_STEADY_S / run.dt_s), 1)
    if speed.size <= 2 * half:
        return np.empty((0, 4))
    around = np.lib.stride_tricks.sliding_window_view(speed, 2 * half)[:-1]
    mean = around.mean(axis=1)
    size, steady = np.abs(mean), np.ptp(around, axis=1) <= uneven * np.abs(mean)
    k = np.flatnonzero((mean != 0) & steady)
    length = np.clip(np.ceil(least / size[k]), 2, half + 1).astype(np.intp)
    k, length = k[length <= half], length[length <= half]  # a slower motion is too short to tell
    at = k + half  # the window's middle
    moved, expected = (x[at + length] - x[at] for x in (run.angle, simulated))
    shares = np.divide(moved, expected, out=np.full(k.size, np.nan), where=expected != 0)
    windows = np.stack([shares, moved, (moved - expected) * np.sign(mean[k]), size[k] / run.dt_s], axis=1)
    return np.asarray(windows[expected != 0], dtype=np.float64)
