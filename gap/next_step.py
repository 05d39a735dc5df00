"""What next: the motion that separates the explanations that these trials leave open."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hystmpc.ctrl.limits import CommandLimits

from .diagnosis import NextMotion
from .floor import Floor
from .hypothesis import Hypothesis
from .motion_menu import menu
from .next_motion import Contender, Noise, Proposal, propose
from .preparation import Prepared
from .recording import Run
from .select import Selection
from .verdict import Ruling

Vec = NDArray[np.float64]
_STEP = 0.3  # of the unknowns' typical changes


def next_step(
    prepared: Prepared, selection: Selection, ruling: Ruling, floor: Floor
) -> tuple[Proposal | None, NextMotion | None]:
    """A motion for the first set of effects that stand for one another; none where nothing is open.

    Args:
        prepared: trials and baseline.
        selection: with every explanation that was judged.
        ruling: with its ambiguity.
        floor: what a separation counts against.
    """
    if not ruling.ambiguity:
        return None, None
    rivals = ruling.ambiguity[0]
    chosen = selection.chosen.hypothesis
    rest = chosen.effects - {rivals[0]}
    fitted = {name: selection.tried.get(rest | {name}) for name in rivals}
    contenders = [
        _contender(name, judged.hypothesis, prepared)
        for name, judged in fitted.items()
        if judged is not None and judged.hypothesis.problem.effects
    ]
    if len(contenders) < 2:
        return None, None
    noise = Noise(max(floor.noise_deg, 1e-3))
    proposal = propose(contenders, menu(_limits(prepared), prepared.checked.dt), noise)
    return proposal, proposal.summary()


def _limits(prepared: Prepared) -> CommandLimits:
    """Commands and speeds that were recorded, and no others."""
    low = min(float(run.command.min()) for run in prepared.everything)
    high = max(float(run.command.max()) for run in prepared.everything)
    fastest = max(float(np.abs(np.diff(run.command)).max()) / run.dt_s for run in prepared.everything)
    return CommandLimits(low, high, fastest)


def _contender(name: str, hypothesis: Hypothesis, prepared: Prepared) -> Contender:
    problem, q = hypothesis.problem, hypothesis.q
    start = prepared.everything[0]

    def simulated(at: Vec, command: Vec, dt: float) -> Vec:
        return problem.angles(at, _planned(start, command, dt))

    def at(point: Vec) -> object:
        return lambda command, dt: simulated(point, command, dt)

    nudges = [np.clip(q + _STEP * row, problem.lower, problem.upper) for row in np.eye(problem.size)]
    return Contender(name, at(q), [at(point) for point in nudges])  # type: ignore[arg-type,misc]


def _planned(start: Run, command: Vec, dt: float) -> Run:
    """A motion that was not recorded yet, from where the first trial rested."""
    return Run(
        name="planned",
        command=np.ascontiguousarray(command),
        angle=np.zeros(command.size),
        dt_s=dt,
        rest_command=float(command[0]),
        rest_angle=start.rest_angle,
        counts=np.ones(command.size, dtype=np.bool_),
        bent_before=start.bent_before,
        clock_s=0.0,
        correction=np.zeros(command.size),
    )
