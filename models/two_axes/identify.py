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
from .model import AXES, CrossFriction, TwoAxisModel, run_axis

Fits = tuple[Identified, Identified]
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
    """Identify a device with n commands and two angles.

    Of more than two commands, such as those of three tendons, the travels by each are identified too.

    First the joint of the axes, then a model of each axis by `kind`, then the joint's numbers once more with these
    models, and the friction that both axes share; where these change anything, the axes once more.

    At first each axis is identified twice: from all trials, and from those in which it moves alone, if both do in some.
    What both share is zero in these. From all trials an axis has less friction than alone, since the other one removes
    some, but knows more of its range. The fit is kept of which less is left once the shared friction is identified.

    Args:
        kind: readable kind of model of each axis, such as `auto`.
        trials: of commands (T, n) and two angles (T, 2), one rate and one pair of units.
        request: of every axis.
        limits: of every command; those of the trials where left out.
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
        moving = [_axis_trials(trials, begun, axis) for axis in range(AXES)]
        fits = _axes(kind, moving, request, 2 * number * AXES * each, each, progress)
        if any(fit.interrupted for fit in fits):
            break
        if number == 0 and joint is None:
            alone = [_axis_trials(trials, begun, axis, alone=True) for axis in range(AXES)]
            if all(alone):
                others = _axes(kind, alone, request, AXES * each, each, progress)
                fits = _better_fits(fits, others, trials, begun)
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


def _better_fits(fits: Fits, others: Fits, trials: Sequence[Trial], begun: _Begun) -> Fits:
    """Of each axis the fit of which less is left once the friction that both share is identified."""
    squares = []
    for one in (fits, others):
        axes = _simulators(one)
        shared = replace(begun, cross=_shared(axes, trials, begun))
        travels, left = _left(axes, trials, begun)
        unknown = [e - shared.shared(w, trials[0].dt) for w, e in zip(travels, left, strict=True)]
        squares.append(np.sum([np.sum((e - e.mean(0)) ** 2, axis=0) for e in unknown], axis=0))
    x, y = (other if better else fit for fit, other, better in zip(fits, others, squares[1] < squares[0], strict=True))
    return x, y


def _shared(axes: tuple[Simulator, Simulator], trials: Sequence[Trial], begun: _Begun) -> CrossFriction | None:
    """The friction that both axes share, by what their models leave of the trials."""
    return shared_friction(*_left(axes, trials, begun), trials[0].dt)


def _left(axes: tuple[Simulator, Simulator], trials: Sequence[Trial], begun: _Begun) -> tuple[list[Vec], list[Vec]]:
    """Travels (T, 2) of every trial, and what the models of the axes leave of its angles (T, 2) [deg]."""
    travels = [trial.commands @ begun.joint.mix.T for trial in trials]
    left = []
    for trial, w in zip(trials, travels, strict=True):
        y = trial.angles @ np.linalg.inv(begun.joint.frame).T
        runs = [run_axis(ChainModel(axis), w[:, i], float(y[0, i]), trial.inputs) for i, axis in enumerate(axes)]
        left.append(y - np.stack(runs, axis=1))
    return travels, left


def _axis_trials(trials: Sequence[Trial], begun: _Begun, axis: int, *, alone: bool = False) -> list[Trial]:
    """Trials in which an axis moves, or moves alone: its travel w, and its angle y without what both axes share."""
    back, mix = np.linalg.inv(begun.joint.frame), begun.joint.mix
    spans = np.array([np.ptp(trial.commands @ mix.T, axis=0) for trial in trials])
    share = spans / spans.max(axis=0)
    others = _RESTS if alone else np.inf
    moving = [trial for trial, one in zip(trials, share, strict=True) if one[axis] > _MOVES and one[1 - axis] < others]
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
    trials: Sequence[list[Trial]],
    request: FitRequest,
    done: int,
    each: int,
    progress: FitProgress | None,
) -> Fits:
    """A model of each axis from its trials."""
    made = []
    for axis in range(AXES):

        def tell(step: int, rmse: float, before: int = done + axis * each) -> None:
            if progress is not None:
                progress(before + step, rmse)

        made.append(identified(kind, trials[axis], request, tell))
    return made[0], made[1]


def _refined(axes: tuple[Simulator, Simulator], trials: Sequence[Trial], begun: _Begun) -> _Begun:
    """The joint's numbers of least error with these models of the axes."""
    models, joint, free = [ChainModel(axis) for axis in axes], begun.joint, list(FREE[begun.joint.name])
    if not free:
        return begun
    straight = joint.mix @ np.linalg.pinv(joint.order)
    start = np.array([straight[0, 1], straight[1, 0], joint.frame[0, 1], joint.frame[1, 0]])

    def error(values: Vec) -> Vec:
        q = start.copy()
        q[free] = values
        mix, frame = matrices(q)
        left = []
        for trial in trials:
            w, y = trial.commands @ (mix @ joint.order).T, np.linalg.solve(frame, trial.angles.T)
            runs = [run_axis(model, w[:, i], float(y[i, 0]), trial.inputs) for i, model in enumerate(models)]
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
    given = [*limits, *[DeviceLimits()] * u.shape[1]][: u.shape[1]]
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
    errors = [model.run(trial.commands, trial.angles[0], trial.inputs) - trial.angles for trial in trials]
    rmse = np.sqrt(np.mean(np.vstack(errors) ** 2, axis=0))
    return TwoAxisFit(model, fits, begun.joint.name, tried, rmse, any(fit.interrupted for fit in fits))
