"""Changes of a device that are likely as a whole: another friction, another drive in front of the model.

A device that differs from its model has seldom changed in one weight of the basis; its friction has grown, or its drive
answers later. Both move many weights at once, in proportions that the model tells: a few frames determine how far such
a change has gone, where twenty free weights take minutes.
"""

from __future__ import annotations

import numpy as np

from hystmpc.core.library import engine
from hystmpc.models.model import Predictor
from hystmpc.trials.types import Vec

from ..command import attempt
from ..mpc_settings import AdaptationSettings
from .bank import PLAYS, SIZE, FilterBank

_TURNS: Vec = np.array([0.0, 1.0, 0.0, 1.0, 0.0, 0.6, 0.3, 1.0, 0.5, 0.7, 0.1])  # of the motion, shares of the range
_BEFORE = 2.0  # way to the first return to the start, from which on the motion counts
_SPEED = 0.25  # of the motion [ranges/s]
_ERROR = 0.01  # standard deviation that the fit of the basis assumes, as a share of the model's range
_CORRECTIONS = 500  # at most that many samples of the motion are used
_FREE = AdaptationSettings(walk_share=0.0)


def likely_changes(model: Predictor, scale: float) -> Vec:
    """Return two changes of z = (offset, w_c, w), each with a standard deviation of one (2, K) [1, deg].

    The model along a slow motion with inner loops, written in the basis: m - m_0 ~ sum_i w_i f_i(u), by least squares
    with the free weights' variances. Then

        friction:   play i hands its weight on to play i + 1, about twice as wide; the widest keeps its own
        drive:      w_c = -1 and the weights w, so that theta = m_0 + sum_i w_i f_i(v): m behind the drive of v

    Both are zero where the model fails.

    Args:
        scale: angle of the model over the whole range of commands [deg].
    """
    weights = attempt(lambda: _in_basis(model, scale))[0]
    changes = np.zeros((2, SIZE))
    if weights is None or not np.any(weights):
        return changes  # the model fails, or none of its angles was finite
    plays = weights[PLAYS]
    wider = np.concatenate([[0.0], plays[:-1]])
    wider[-1] += plays[-1]
    changes[0, PLAYS] = wider - plays
    changes[1] = weights
    changes[1, :2] = 0.0, -1.0
    return changes


def _in_basis(model: Predictor, scale: float) -> Vec:
    """Offset, w_c = 0 and weights (K,) by which the basis alone does what the model does."""
    low, high = model.command_range
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(_TURNS)))])
    shares = np.interp(np.arange(0.0, way[-1], _SPEED * model.dt), way, _TURNS)
    commands, first = low + (high - low) * shares, round(_BEFORE / (_SPEED * model.dt))
    angles = model.rollout(model.initial(0.0, low), commands[None])[0]
    bank = FilterBank(model.dt, model.command_range, scale, _ERROR * scale, 0, _FREE, drift=0.0)
    state, every = bank.init(0.0, low, 0.0), max(1, commands.size // _CORRECTIONS)
    learner, past, filters = bank.struct().address, state.past, state.filters
    for k in range(first, commands.size):
        engine().filters_advance(learner, past, commands.item(k))
        if k % every == 0:
            engine().filters_correct(learner, past, filters, angles.item(k) - angles.item(first - 1), 0.0, 0.0)
    return np.array(state.z[0, :, 0])
