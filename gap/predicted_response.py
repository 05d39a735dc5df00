"""Explanations as simulators of a motion that was not recorded yet: settled at its start, on a used device."""

from __future__ import annotations

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.identify.cross_validation import Hypothesis
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.identify.problem import Problem
from hystmpc.models.operators.slow_changes import Drift, FirstFlexure
from hystmpc.trials.types import Vec

from .next_motion import OpenHypothesis, Simulate
from .preparation import Prepared

_STEP = 0.3  # of the unknowns' typical changes
_SETTLE_S, _SETTLE_DT = 1800.0, 2.0


def contender_of(name: str, hypothesis: Hypothesis, prepared: Prepared) -> OpenHypothesis:
    """A fitted explanation as `propose` takes it; its retunings move one unknown each.

    What each trial has of its own (`trial_shift`, the phase of a disturbance) is not part of the run: in a single
    further motion the first is a matter of retuning, and the second would be a new one.

    Args:
        name: of the effect that it stands for.
        hypothesis: fitted.
        prepared: trials, for where the device has been.
    """
    problem, q = hypothesis.problem, hypothesis.q
    nudges = [np.clip(q + _STEP * row, problem.lower, problem.upper) for row in np.eye(problem.size)]
    moved = [nudge for nudge in nudges if not np.array_equal(nudge, q)]
    return OpenHypothesis(name, _simulator(problem, q, prepared), [_simulator(problem, n, prepared) for n in moved])


def settled(chain: Chain, command: float, angle: float, bent: float, clock_s: float) -> Vec:
    """State (S,) of a chain after a long rest.

    The rule for a start at rest takes each operator alone; creep before a play, for one, moves on from there. The
    command is therefore held for half an hour. Clocks and running maxima are set afterwards: a rest is no use.

    Args:
        chain: with its numbers.
        command: held [cmd].
        angle: about what the device shows [deg].
        bent: greatest command that the device has seen [cmd]; the rest command for one that forgets.
        clock_s: of the device [s].
    """
    staged = StagedChain(chain)
    start = staged.rest(np.array([command]), np.array([angle]))
    held = np.full((round(_SETTLE_S / _SETTLE_DT), 1), command)
    state: Vec = staged.simulate(held, _SETTLE_DT, start)[1][:, 0]
    at = 0
    for operator in chain.operators:
        if isinstance(operator, Drift):
            state[at], state[at + 1] = clock_s, 0.0  # time and travel
        if isinstance(operator, FirstFlexure):
            state[at] = max(float(state[at]), bent)
        at += len(operator.states)
    return state


def _simulator(problem: Problem, q: Vec, prepared: Prepared) -> Simulate:
    """Free run of a chain from a settled start at the motion's first command."""
    chain, runs = problem.fitted_chain(q), prepared.everything
    staged = StagedChain(chain)
    carried = {c.carries for c in problem.effects}
    last = runs[-1]
    bent = max(last.bent_before, float(last.command.max())) if "bend" in carried else -np.inf
    clock = last.clock_s + last.command.size * last.dt_s if "clock" in carried else 0.0

    rested: dict[float, Vec] = {}  # every motion of a menu starts at one command

    def simulate(command: Vec, dt: float) -> Vec:
        first = float(command[0])
        if first not in rested:
            rested[first] = settled(chain, first, runs[0].rest_angle, bent, clock)
        state = rested[first]
        return np.asarray(staged.simulate(command[:, None], dt, state[:, None])[0][:, 0])

    return simulate
