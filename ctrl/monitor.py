"""Online change detection: whether the device differs from its identified model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from hystmpc.models.contract.metadata import NoiseModel
from hystmpc.trials.types import Vec

SIGNS = ("offset", "lag", "friction", "stiffness", "slack", "creep")
"""Signs of a change, see `ChangeMonitor`."""

_MEMORY_S = 20.0  # of motion, over which the residual is judged
_LEAST_S = 12.0  # of motion, before a result is given
_RESTED_S = 1.0  # a rest counts as part of the motion for so long
_MOVING = 0.005  # of the range of angles in a second
_PLAY = 0.08  # of the range of angles: half of the width of the play that tells the direction
_SLACK = 0.3  # of the range of angles, at its lower end
_CREEP_S = 8.0
_LEAST_MODEL = 1e-3  # of the range of angles: no model is closer
_HEALTHY, _CHANGED = (0.0, 0.5), (2.0, 1.0)  # mean and standard deviation of the logarithm of the level
_PRIOR = 0.05  # prior probability of a change
_INDEPENDENT_S = 2.0  # motion after which a model's error counts as independent
_ROWS = len(SIGNS) + 1
_SAID = 0.95  # probability from which on a change is reported
_NAMED = 0.1  # probability from which on a sign is named


@dataclass(frozen=True)
class Change:
    """Result of a change monitor.

    Attributes:
        probability: that the device has changed since identification; not-a-number while there is too little motion.
        level: root mean square of the model's slow error, relative to the usual one of this model.
        signs: name and probability of each sign, the most likely first, given that there is a change.
    """

    probability: float
    level: float
    signs: tuple[tuple[str, float], ...]

    @property
    def certain(self) -> bool:
        """Whether the probability of a change is high enough to report it."""
        return self.probability >= _SAID

    @property
    def sign(self) -> str:
        """Text of the change and its likeliest sign, constant while these do not change."""
        return f"the device has changed since identification: {self.signs[0][0]}"

    def __str__(self) -> str:
        named = ", ".join(f"{name} {share:.2f}" for name, share in self.signs if share >= _NAMED)
        return (
            f"the device has changed since identification (p = {self.probability:.3f}; {named}): the model is off by "
            f"{self.level:.1f} times its usual error"
        )


@dataclass(frozen=True, eq=False)
class MonitorState:
    """Memory of a `ChangeMonitor`.

    Attributes:
        model_deg, residual_deg: of the last sample [deg].
        stop_deg: position within the play that tells the direction [deg].
        slow_deg: the model's angle behind a lag of 8 s [deg].
        rested_s: time since the last motion [s].
        seen_s: motion seen so far [s].
        sums: forgetting sums of products of (1, signs, residual) (K, K).
        changes: forgetting sum of squared changes of the residual from sample to sample [deg^2].
    """

    model_deg: float
    residual_deg: float
    stop_deg: float
    slow_deg: float
    rested_s: float
    seen_s: float
    sums: Vec
    changes: float


@final
class ChangeMonitor:
    """Change detection by the residual r = measured angle - free run of the model, over the last 20 s of motion.

    The level l relates its slow part to the usual one of this model, s_m (`model_sigma_deg` of its file):

        l^2 = (mean r^2 - mean (r_k - r_{k-1})^2 / 2) / s_m^2

    ln l is taken for normal, with mean 0 and standard deviation 0.5 of a device as identified, 2.0 and 1.0 of one that
    has changed. The probability of a change follows from Bayes' rule with 0.05 for its prior. Each window is judged for
    itself: the error of a sound model repeats with the motion, so that its repetition proves nothing. A change is
    reported from a probability of 0.95 on, which is a level of 5.8.

    Signs are regressors of the residual, each with a constant: -d theta/dt (lag), the position within a play of 8 % of
    the range (friction), theta (stiffness), theta where it is within the lowest 30 % (slack), theta minus its value
    behind a lag of 8 s (creep); the constant alone is the offset. With the share e of the residual's energy that a sign
    explains and n independent samples its probability is proportional to (1 - e)^(-n / 2).

    Args:
        angle_range_deg: least and greatest angle of the model.
    """

    def __init__(self, noise: NoiseModel | None, dt_s: float, angle_range_deg: tuple[float, float]) -> None:
        low, high = angle_range_deg
        self._low, self._span, self.dt = low, max(high - low, 1e-9), dt_s
        usual = None if noise is None else noise.model_sigma_deg
        self._usual = None if usual is None else max(usual, _LEAST_MODEL * self._span)
        self._kept = math.exp(-dt_s / _MEMORY_S)
        self._follows = 1.0 - math.exp(-dt_s / _CREEP_S)

    def init(self, model_deg: float, measured_deg: float) -> MonitorState:
        """Return the state at rest."""
        residual = measured_deg - model_deg if math.isfinite(measured_deg) else 0.0
        return MonitorState(model_deg, residual, 0.0, model_deg, math.inf, 0.0, np.zeros((_ROWS, _ROWS)), 0.0)

    def advance(self, state: MonitorState, model_deg: float, measured_deg: float) -> MonitorState:
        """Return the state one sample later; a measurement of NaN changes only the memory of the model."""
        span, moved = self._span, model_deg - state.model_deg
        bound = _PLAY * span
        stop = min(max(state.stop_deg + moved, -bound), bound)
        slow = state.slow_deg + self._follows * (model_deg - state.slow_deg)
        rested = 0.0 if abs(moved) > _MOVING * span * self.dt else state.rested_s + self.dt
        residual = measured_deg - model_deg
        sums, changes, seen, kept = state.sums, state.changes, state.seen_s, self._kept
        if rested <= _RESTED_S and math.isfinite(residual):
            x = (model_deg - self._low) / span
            row = np.array(
                [
                    1.0,
                    -moved / self.dt / span,
                    stop / bound,
                    x - 0.5,
                    max(_SLACK - x, 0.0) / _SLACK,
                    (model_deg - slow) / span,
                    residual,
                ]
            )
            sums = kept * sums + row[:, None] * row
            changes = kept * changes + (residual - state.residual_deg) ** 2
            seen += self.dt
        residual = residual if math.isfinite(residual) else state.residual_deg
        return MonitorState(model_deg, residual, stop, slow, rested, seen, sums, changes)

    def change(self, state: MonitorState) -> Change:
        """Return the result for the last 20 s of motion."""
        weight = float(state.sums[0, 0])
        if self._usual is None or state.seen_s < _LEAST_S:
            return Change(math.nan, math.nan, ())
        square = max(float(state.sums[-1, -1]) - 0.5 * state.changes, 0.0) / weight
        level = math.sqrt(square) / self._usual
        log = math.log(min(max(level, 1e-3), 1e3))
        odds = _PRIOR / (1.0 - _PRIOR) * math.exp(_log_normal(log, *_CHANGED) - _log_normal(log, *_HEALTHY))
        probability = odds / (1.0 + odds) if log > 0 else 0.0
        return Change(probability, level, self._signs(state.sums, state.changes))

    def along(self, model_deg: Vec, measured_deg: Vec) -> tuple[Change, float]:
        """Return the first reported change along angles (N,) [deg] and its time [s]; else the final result and NaN."""
        state, every = self.init(float(model_deg[0]), float(measured_deg[0])), max(round(1.0 / self.dt), 1)
        for k, (model, measured) in enumerate(zip(model_deg.tolist(), measured_deg.tolist(), strict=True)):
            state = self.advance(state, model, measured)
            if k % every == 0 and (change := self.change(state)).certain:
                return change, k * self.dt
        return self.change(state), math.nan

    def _signs(self, sums: Vec, changes: float) -> tuple[tuple[str, float], ...]:
        """Probabilities of the signs, given a change."""
        total = max(sums[-1, -1] - 0.5 * changes, 1e-12)
        left = [1.0 - min(sums[0, -1] ** 2 / (sums[0, 0] * total), 1.0)]
        for k in range(1, len(SIGNS)):
            both = np.ix_((0, k), (0, k))
            target = sums[[0, k], -1]
            gained = target @ np.linalg.lstsq(sums[both], target, rcond=1e-9)[0]
            left.append(1.0 - min(float(gained) / total, 1.0))
        independent = sums[0, 0] * self.dt / _INDEPENDENT_S
        logs = -0.5 * independent * np.log(np.maximum(left, 1e-3))
        logs[1:] -= 0.5 * math.log(max(independent, 1.0))  # each sign has one parameter more than the offset
        shares = np.exp(logs - logs.max())
        shares /= shares.sum()
        order = np.argsort(-shares)
        return tuple((SIGNS[k], float(shares[k])) for k in order)


def _log_normal(x: float, mean: float, deviation: float) -> float:
    return -0.5 * ((x - mean) / deviation) ** 2 - math.log(deviation)
