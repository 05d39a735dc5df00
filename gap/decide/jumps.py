"""Jumps: stick-slip found by its pattern of motion, since the moment of a slip cannot be predicted in a free run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.models.identify.cross_validation import Hypothesis
from hystmpc.models.identify.runs import Run
from hystmpc.trials.types import Mat, Vec

from ..logs.sensor import SensorSigns

_STEADY_S = 0.4  # of steady motion before and after a sample
_UNEVEN = 0.4  # greatest range of the speed in it, relative to its mean
_ONE_WAY = 1.2  # the same where such motion is rare, as in sines: it does not turn
_NOISES, _STEPS = 5.0, 3.0  # standard deviations and resolutions that the motion in a window has to exceed
_STUCK, _JUMPED, _BACK = 0.3, 2.0, -0.5  # of the simulated motion in a window
_ENOUGH = 100  # windows


@dataclass(frozen=True)
class Jumps:
    """Statistics of the tip motion while the simulated motion is steady.

    In each window, as short as noise and resolution allow, the measured motion is a multiple g of the simulated one. A
    tip that sticks and slips does not move in many windows, moves several times too far in others, and never moves back
    as it would under a disturbance from outside.

    Attributes:
        windows: number of windows.
        stuck, jumped, back: share of them with g below 0.3, above 2, and below -0.5.
        carried: share of the measured motion in those above 2: rare jumps are large.
        height_deg: median change of the tip's lead over the simulator in a jump [deg].
        fastest_deg_s: 90 % quantile of the simulated speeds at which it jumps [deg/s].
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
        """Energy of a sawtooth of that height [deg^2], the part of it that no free run can predict."""
        return self.height_deg**2 / 12.0 if self.seen else 0.0

    def note(self, unit: str) -> str:
        """Note for the report, sizes in that unit."""
        return (
            f"Stick-slip by its jumps: in {self.stuck:.0%} of {self.windows} windows of steady motion the tip stands "
            f"still, in {self.jumped:.0%} it jumps, by {self.height_deg:.2g} {unit}, at speeds up to "
            f"{self.fastest_deg_s:.2g} {unit}/s. When it lets go cannot be predicted in a free run: what it closes "
            "is the energy of a sawtooth of that height."
        )

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of the effect in the result."""
        return {"jump_deg": self.height_deg, "fastest_deg_s": self.fastest_deg_s}


def find_jumps(runs: Sequence[Run], retuned: Hypothesis, signs: SensorSigns) -> Jumps:
    """Look for stick-slip in steady motion.

    Args:
        runs: of all trials.
        retuned: the simulator refitted.
        signs: noise and resolution of the sensor.
    """
    least = max(_NOISES * signs.noise_deg, _STEPS * signs.quantisation_deg, 1e-9)
    simulated = [retuned.problem.angles(retuned.q, run) for run in runs]
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
    kept = []
    for k in range(half, speed.size - half):
        around = speed[k - half : k + half]
        mean = float(around.mean())
        if mean == 0 or np.ptp(around) > uneven * abs(mean):
            continue
        length = max(int(np.ceil(least / abs(mean))), 2)
        if length > half:
            continue
        moved, expected = (float(x[k + length] - x[k]) for x in (run.angle, simulated))
        if expected:
            kept.append((moved / expected, moved, (moved - expected) * np.sign(mean), abs(mean) / run.dt_s))
    return np.array(kept, dtype=np.float64).reshape(-1, 4)
