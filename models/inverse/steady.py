"""The inverse of a model in steps short enough to be exact and long enough to be steady."""

from __future__ import annotations

import math

import numpy as np

from ..model import Inverse, InvertiblePredictor
from ..prediction.compiled import CompiledPredictor
from .drive import DrivenInverse
from .one_step import CompiledInverse

_HOLDS = (2, 4)  # samples; what a model answers to the speed of its command is gone after them, or never
_MOST_INSTRUCTIONS = 1000  # of the step of a hold: numba compiles more for minutes
_RAMP_S, _REST_S = 2.0, 0.4
_SAMPLES = (10, 200)  # of the ramp
_SHARE = 0.5  # of the range of angles
_BACK = 1e-6  # of the range of commands, that counts as a move


def steady_inverse(predictor: InvertiblePredictor, low: float, high: float) -> CompiledInverse:
    """The inverse sample by sample, or after a hold where the former goes back and forth.

    The angle of some models falls at first when the command speeds up: plays whose thresholds grow with the speed
    stand still while the next move is faster than the last. Sampled, with r_i = alpha i + beta |u_k - u_{k-1}| / dt,

        theta_k = (A - B / dt) u_k + (B / dt) u_{k-1} + ...,   A = sum_i a_i,   B = beta sum_{i>0} a_i

    has its zero at (B / dt) / (B / dt - A), outside the unit circle where B / dt > A / 2. Its exact inverse is then
    unstable: along a steady ramp of the angle the command is fast and still by turns. The command that shows the angle
    after being held for some samples has no such zero, and meets the same angle at rest.

    Args:
        predictor: the model.
        low, high: least and greatest command among which the inverse searches.

    Source: Astrom, Hagander and Sternby, Zeros of sampled systems, Automatica 20 (1984), for the zeros.
    """
    exact = CompiledInverse(predictor, low, high)
    if not isinstance(predictor, CompiledPredictor) or not goes_back(exact, predictor):
        return exact
    for samples in _HOLDS:
        if samples * predictor.transition.n_instructions() > _MOST_INSTRUCTIONS:
            break
        held = CompiledInverse(predictor.held(samples), low, high, samples)
        if not goes_back(held, predictor):
            return held
    return exact


def inverted_after_a_hold(inverse: Inverse) -> bool:
    """Whether an inverse, behind its drives, is that after a hold: along a motion it is late, a first guess only."""
    inner = inverse.inner if isinstance(inverse, DrivenInverse) else inverse
    return isinstance(inner, CompiledInverse) and inner.held > 1


def goes_back(inverse: CompiledInverse, predictor: InvertiblePredictor) -> bool:
    """Whether the commands that follow a ramp of the angle, up and down again, ever move against it."""
    low, high = predictor.command_range
    rest = max(2, round(_REST_S / predictor.dt))
    samples = min(max(round(_RAMP_S / predictor.dt), _SAMPLES[0]), _SAMPLES[1])
    state = predictor.initial(0.0, low)
    plans = np.array([[low] * (rest + 1), [high] * (rest + 1)])
    first, last = predictor.rollout(state, plans)[:, -1].tolist()
    for _ in range(rest):
        _, state = predictor.advance(state, low)
    if not (math.isfinite(first) and math.isfinite(last)):
        return False
    up = first + _SHARE * (last - first) * np.arange(1, samples + 1) / samples
    u = low
    for direction, ramp in ((1.0, up), (-1.0, up[::-1])):
        for theta in ramp.tolist():
            before, u = u, inverse.command(state, theta, u)
            if direction * (u - before) < -_BACK * (high - low):
                return True
            _, state = predictor.advance(state, u)
    return False
