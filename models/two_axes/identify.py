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
from .joints import Chosen, Joint, choose_joint, matrices
from .model import AXES, TwoAxisModel

_CHANGED = 0.005  # change of a joint's number after which the axes are identified once more
_ROUNDS = 2


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
        return f"two axes joined by {self.joint} (parts left out: {tried} deg); free runs {x:.3g} and {y:.3g} deg"


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
    models; where they change, the axes once more.

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
    known, each = chosen.joint, kind.steps(request) or 0
    fits: tuple[Identified, Identified] | None = None
    for number in range(_ROUNDS):
        steps = number * AXES * each
        fits = _axes(kind, trials, known, request, steps, each, progress)
        simulators = fits[0].simulator, fits[1].simulator
        assert simulators[0] is not None
        assert simulators[1] is not None
        better = _refined((simulators[0], simulators[1]), trials, known)
        moved = max(float(np.abs(better.mix - known.mix).max()), float(np.abs(better.frame - known.frame).max()))
        known = better
        if moved < _CHANGED or any(fit.interrupted for fit in fits):
            break
    assert fits is not None
    return _assembled(fits, trials, replace(chosen, joint=known), limits)


def axis_trials(trials: Sequence[Trial], joint: Joint, axis: int) -> list[Trial]:
    """Trials of one axis: its travel w, and its angle y."""
    back = np.linalg.inv(joint.frame)
    return [
        replace(
            trial,
            command=np.ascontiguousarray(trial.commands @ joint.mix[axis]),
            angle=np.ascontiguousarray(trial.angles @ back[axis]),
            source=f"{trial.source} ({'xy'[axis]})",
            channels={},
        )
        for trial in trials
    ]


def _axes(
    kind: ModelKind,
    trials: Sequence[Trial],
    joint: Joint,
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

        made.append(identified(kind, axis_trials(trials, joint, axis), request, tell))
    return made[0], made[1]


def _refined(axes: tuple[Simulator, Simulator], trials: Sequence[Trial], joint: Joint) -> Joint:
    """The joint's numbers of least error with these models of the axes."""
    models, free = [ChainModel(axis) for axis in axes], _free(joint.name)
    if not free:
        return joint
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
            left.append((frame @ (np.stack(runs) - y)).ravel())
        return np.concatenate(left)

    found = least_squares(error, start[free], diff_step=1e-3, max_nfev=10)
    q = start.copy()
    q[free] = found.x
    mix, frame = matrices(q)
    return replace(joint, mix=mix @ joint.order, frame=frame)


def _free(name: str) -> list[int]:
    return {"none": [], "tendons": [0, 1], "frame": [2, 3], "both": [0, 1, 2, 3]}[name]


def _assembled(
    fits: tuple[Identified, Identified], trials: Sequence[Trial], chosen: Chosen, limits: Sequence[DeviceLimits]
) -> TwoAxisFit:
    simulators = fits[0].simulator, fits[1].simulator
    assert simulators[0] is not None
    assert simulators[1] is not None
    u = np.vstack([trial.commands for trial in trials])
    rates = np.max([np.abs(np.diff(trial.commands, axis=0)).max(0) / trial.dt for trial in trials], axis=0)
    given = [*limits, *[DeviceLimits()] * AXES][:AXES]
    ranges = tuple(
        one.command or Range(lower=float(u[:, k].min()), upper=float(u[:, k].max())) for k, one in enumerate(given)
    )
    rests = np.median([trial.commands[0] for trial in trials], axis=0)
    model = TwoAxisModel(
        (simulators[0], simulators[1]),
        tuple(tuple(row) for row in chosen.joint.mix.tolist()),
        tuple(tuple(row) for row in chosen.joint.frame.tolist()),
        ranges,
        tuple(float(one.rate_per_s or rates[k]) for k, one in enumerate(given)),
        tuple(float(np.clip(rest, each.lower, each.upper)) for rest, each in zip(rests, ranges, strict=True)),
        chosen.errors,
    )
    errors = [model.run(trial.commands, trial.angles[0]) - trial.angles for trial in trials]
    rmse = np.sqrt(np.mean(np.vstack(errors) ** 2, axis=0))
    return TwoAxisFit(model, fits, chosen.joint.name, chosen.errors, rmse, any(fit.interrupted for fit in fits))
