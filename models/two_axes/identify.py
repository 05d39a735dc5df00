"""Identification of a device with two axes: what joins them, then a model of each, then both once more together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..contract.metadata import DeviceLimits, Range
from ..kinds.kind import FitRequest, Identified, ModelKind, identified
from ..model import FitProgress
from ..simulator import ChainModel, Simulator
from .cross import shared_friction
from .joints import FREE, Chosen, Joint, choose_joint, matrices
from .model import AXES, CrossFriction, TwoAxisModel

_CHANGED = 0.005  # change of a joint's number after which the axes are identified once more
_ROUNDS = 2
_MOVES = 0.1  # of the greatest range of its travel: an axis that moves less in a trial is not identified from it
_RESTS = 0.02  # of the same: an axis that moves less leaves the other one alone


@dataclass(frozen=True, eq=False)
class TwoAxisFit:
    """Identified model of two axes.

    Attributes:
        model: the device.
        axes: what was identified for each axis.
        joint: `none`, `tendons`, `frame` or `both`, see `choose_joint`.
        errors: by joint, on parts left out [deg].
        rmse_deg: error of free runs over all trials (2,) [deg].
        interrupted: whether Ctrl-C kept the best so far.
    """

    model: TwoAxisModel
    axes: tuple[Identified, Identified]
    joint: str
    errors: dict[str, float]
    rmse_deg: Vec
    interrupted: bool = False

    @property
    def report(self) -> str:
        """What joins the axes, with errors, in one line."""
        tried = ", ".join(f"{name} {error:.3g}" for name, error in self.errors.items())
        x, y = self.rmse_deg
        shared = " and a friction that both share" if self.model.cross_friction is not None else ""
        return f"two axes joined by {self.joint}{shared} (parts left out: {tried} deg); free runs {x:.3g}, {y:.3g} deg"


def fit_two_axes(
    kind: ModelKind,
    trials: Sequence[Trial],
    request: FitRequest,
    limits: Sequence[DeviceLimits] = (),
    progress: FitProgress | None = None,
    joint: Chosen | None = None,
) -> TwoAxisFit:
    """Identify a device with two commands and two angles.

    First the joint of the axes, then a model of each axis by `kind`, then the joint's numbers once more with these
    models, and the friction that both axes share; where these change anything, the axes once more.

    An axis is first identified from the trials in which it moves alone, if there are any: what both share is zero there.
    From all trials it would have less friction than it has alone, since the other axis removes some, and what both share
    would be identified from what is left by that.

    Args:
        kind: readable kind of model of each axis, such as `auto`.
        trials: of two commands (T, 2) and two angles (T, 2), one rate and one pair of units.
        request: of every axis.
        limits: of both commands; those of the trials where left out.
        progress: gets the steps of both axes one after the other, and the best error.
        joint: what joins the axes, where it is known.

    Raises:
        FitError: as `choose_joint` and `ModelKind.fit`, or if the kind is not readable.
    """
    if not kind.readable:
        raise FitError(f"{kind.name}: has no readable form, expected auto or an operator for two axes")
    chosen = joint or choose_joint(trials)
    begun = _Begun(chosen.joint, None)
    each, fits = kind.steps(request) or 0, None
    for number in range(_ROUNDS):
        fits = _axes(kind, trials, begun, request, number * AXES * each, each, progress)
        if any(fit.interrupted for fit in fits):
            break
        better = _refined(_simulators(fits), trials, begun)
        if joint is None:
            better = replace(better, cross=_shared(_simulators(fits), trials, better))
        moved = max(_apart(better.joint.mix, begun.joint.mix), _apart(better.joint.frame, begun.joint.frame))
        changed = moved > _CHANGED or (better.cross is not None and begun.cross is None)
        begun = better
        if not changed:
            break
    assert fits is not None
    return _assembled(fits, trials, chosen.errors, begun, limits)


@dataclass(frozen=True, eq=False)
class _Begun:
    """What is known of the device so far, but for its axes."""

    joint: Joint
    cross: CrossFriction | None

    def shared(self, travels: Vec, dt_s: float) -> Vec:
        """Friction that both axes share (T, 2) [deg]."""
        return np.zeros((len(travels), AXES)) if self.cross is None else self.cross.run(travels, dt_s)


def _apart(one: Vec, other: Vec) -> float:
    return float(np.abs(one - other).max())


def _simulators(fits: tuple[Identified, Identified]) -> tuple[Simulator, Simulator]:
    x, y = (fit.simulator for fit in fits)
    assert x is not None
    assert y is not None
    return x, y


def _shared(axes: tuple[Simulator, Simulator], trials: Sequence[Trial], begun: _Begun) -> CrossFriction | None:
    """The friction that both axes share, by what their models leave of the trials."""
    travels = [trial.commands @ begun.joint.mix.T for trial in trials]
    left = []
    for trial, w in zip(trials, travels, strict=True):
        y = trial.angles @ np.linalg.inv(begun.joint.frame).T
        runs = [ChainModel(axis).run(np.ascontiguousarray(w[:, i]), float(y[0, i])) for i, axis in enumerate(axes)]
        left.append(y - np.stack(runs, axis=1))
    return shared_friction(travels, left, trials[0].dt)


def _axis_trials(trials: Sequence[Trial], begun: _Begun, axis: int) -> list[Trial]:
    """Trials in which an axis moves: its travel w, and its angle y without the friction that both axes share."""
    back, mix = np.linalg.inv(begun.joint.frame), begun.joint.mix
    spans = np.array([np.ptp(trial.commands @ mix.T, axis=0) for trial in trials])
    share = spans / spans.max(axis=0)
    moving = [trial for trial, one in zip(trials, share, strict=True) if one[axis] > _MOVES]
    alone = [trial for trial, one in zip(trials, share, strict=True) if one[axis] > _MOVES and one[1 - axis] < _RESTS]
    if begun.cross is None and alone:
        moving = alone
    return [
        replace(
            trial,
            command=np.ascontiguousarray(trial.commands @ mix[axis]),
            angle=trial.angles @ back[axis] - begun.shared(trial.commands @ mix.T, trial.dt)[:, axis],
            source=f"{trial.source} ({'xy'[axis]})",
            channels={},
        )
        for trial in moving
    ]


def _axes(
    kind: ModelKind,
    trials: Sequence[Trial],
    begun: _Begun,
    request: FitRequest,
    done: int,
    each: int,
    progress: FitProgress | None,
) -> tuple[Identified, Identified]:
    made = []
    for axis in range(AXES):

        def tell(step: int, rmse: float, before: int = done + axis * each) -> None:
            if progress is not None:
                progress(before + step, rmse)

        made.append(identified(kind, _axis_trials(trials, begun, axis), request, tell))
    return made[0], made[1]


def _refined(axes: tuple[Simulator, Simulator], trials: Sequence[Trial], begun: _Begun) -> _Begun:
    """The joint's numbers of least error with these models of the axes."""
    models, joint, free = [ChainModel(axis) for axis in axes], begun.joint, list(FREE[begun.joint.name])
    if not free:
        return begun
    straight = joint.mix @ np.linalg.inv(joint.order)
    start = np.array([straight[0, 1], straight[1, 0], joint.frame[0, 1], joint.frame[1, 0]])

    def error(values: Vec) -> Vec:
        q = start.copy()
        q[free] = values
        mix, frame = matrices(q)
        left = []
        for trial in trials:
            w, y = trial.commands @ (mix @ joint.order).T, np.linalg.solve(frame, trial.angles.T)
            runs = [model.run(np.ascontiguousarray(w[:, i]), float(y[i, 0])) for i, model in enumerate(models)]
            left.append((frame @ (np.stack(runs) + begun.shared(w, trial.dt).T - y)).ravel())
        return np.concatenate(left)

    answer = least_squares(error, start[free], diff_step=1e-3, max_nfev=10)
    q = start.copy()
    q[free] = answer.x
    mix, frame = matrices(q)
    return replace(begun, joint=replace(joint, mix=mix @ joint.order, frame=frame))


def _assembled(
    fits: tuple[Identified, Identified],
    trials: Sequence[Trial],
    tried: dict[str, float],
    begun: _Begun,
    limits: Sequence[DeviceLimits],
) -> TwoAxisFit:
    u = np.vstack([trial.commands for trial in trials])
    rates = np.max([np.abs(np.diff(trial.commands, axis=0)).max(0) / trial.dt for trial in trials], axis=0)
    given = [*limits, *[DeviceLimits()] * AXES][:AXES]
    ranges = tuple(
        one.command or Range(lower=float(u[:, k].min()), upper=float(u[:, k].max())) for k, one in enumerate(given)
    )
    rests = np.median([trial.commands[0] for trial in trials], axis=0)
    model = TwoAxisModel(
        _simulators(fits),
        tuple(tuple(row) for row in begun.joint.mix.tolist()),
        tuple(tuple(row) for row in begun.joint.frame.tolist()),
        ranges,
        tuple(float(one.rate_per_s or rates[k]) for k, one in enumerate(given)),
        tuple(float(np.clip(rest, each.lower, each.upper)) for rest, each in zip(rests, ranges, strict=True)),
        tried,
        begun.cross,
    )
    errors = [model.run(trial.commands, trial.angles[0]) - trial.angles for trial in trials]
    rmse = np.sqrt(np.mean(np.vstack(errors) ** 2, axis=0))
    return TwoAxisFit(model, fits, begun.joint.name, tried, rmse, any(fit.interrupted for fit in fits))
