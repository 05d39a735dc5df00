"""Model and controllers of a device of two axes from recorded trials; the parts that one axis does otherwise."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.feedback import InversePidControllerSettings, PidControllerSettings
from hystmpc.ctrl.two_axes.tip_controller import TwoAxisTipController, TwoAxisTipSettings
from hystmpc.gap.report.words import closed_sentence, tracking_sentence
from hystmpc.gap.two_axes.diagnose import TwoAxisResult, diagnose_two_axes
from hystmpc.gap.two_axes.words import effect_sentence, headlines
from hystmpc.models.contract.metadata import DeviceLimits, Range
from hystmpc.models.simulator import ChainModel
from hystmpc.models.two_axes.evaluate import evaluate_two_axes
from hystmpc.models.two_axes.identify import TwoAxisFit, fit_two_axes
from hystmpc.models.two_axes.model import AXES, TwoAxisModel, load_two_axes
from hystmpc.rig.axes import NAMES, each
from hystmpc.sim.tuning.gains import PidLike, PidTuning, mean_square_of, searched_gains
from hystmpc.sim.two_axes.config import TwoAxisSimulationConfig
from hystmpc.sim.two_axes.study import TwoAxisStudy, prepare_two_axes
from hystmpc.trajectories.excitation import LEFT_OUT
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import FitError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress, parts

from .identify import (
    FIXED_FILE,
    MODEL_FILE,
    TIP_FILE,
    ControllerFiles,
    FittedModel,
    ModelDiagnosis,
    Subject,
    certified,
    evaluations,
    fit_request,
    start_gains,
    target_tolerance_deg,
    tuning_references,
    uniform_trials,
)
from .motions import ReachedAngles, ReachedPlane
from .stages import DIAGNOSIS

DECOUPLED_FILE = "decoupled.yaml"
"""Model of the PID: what joins the axes, without the friction that they share."""

_SHRINKS, _LEAST_BOX = 0.95, 0.2  # of the box of reached angles: each step, and the smallest one
_FITS = 6  # fits of an axis, at most: each, from what it does alone, and once more where the joint changes


def fit_both(subject: Subject, folder: Path, progress: Progress) -> FittedModel:
    """Identify both axes and what joins them without the motion left out, check on it, and write `model.yaml`.

    Raises:
        FitError: if they cannot be identified.
        KeyboardInterrupt: if the user ended it; nothing is kept.
    """
    limits: tuple[CommandLimits, ...] = each(subject.limits)
    kind, request = fit_request(subject, limits[0])
    trials = uniform_trials(subject)
    seen = [trial for trial in trials if not is_left_out(trial)]
    kind.check([], request)
    total = _FITS * (kind.steps(request) or 100)
    ends = [DeviceLimits(Range(lower=one.lower, upper=one.upper), one.rate) for one in limits]
    fitted = fit_two_axes(kind, seen, request, ends, lambda done, rmse: progress(done, total, f"best {rmse:.4f} deg"))
    if fitted.interrupted:
        raise KeyboardInterrupt
    fitted.model.save(folder / MODEL_FILE)
    checks = [evaluate_two_axes(fitted.model, trial).errors.rmse_deg for trial in trials if is_left_out(trial)]
    return _described(fitted, kind.name, max(checks, default=math.nan))


def is_left_out(trial: Trial) -> bool:
    """Whether a recording is the one that the identification does not see."""
    return Path(trial.source).stem == LEFT_OUT


def diagnose_both(subject: Subject, model: Path, folder: Path, progress: Progress) -> ModelDiagnosis:
    """Diagnose what joins the axes and each axis; write it, and `model.fixed.yaml` where that is certified better.

    Raises:
        GapError: if the recordings cannot be compared with the model.
        KeyboardInterrupt: if the user ended it; nothing is kept.
    """
    known, trials = load_two_axes(model), uniform_trials(subject)
    out, called = folder / DIAGNOSIS, {"sim": str(model)}
    done = diagnose_two_axes(
        trials, known, out=out, called=called, model=model, seed=subject.block.seed, progress=progress
    )
    corrected = certified_of_both(done)
    if corrected is not None:
        corrected.save(folder / FIXED_FILE)
    joins, first = done.diagnosis.joins, headlines(done.diagnosis)
    each_axis = zip(NAMES, (done.diagnosis.x, done.diagnosis.y), strict=True)
    more = [
        f"Axis {name}: {text}"
        for name, one in each_axis
        for text in (one.reason, closed_sentence(one), tracking_sentence(one))
        if text
    ]
    return ModelDiagnosis(
        verdict=(*(f"{line[0].upper()}{line[1:]}." for line in first), *map(effect_sentence, joins.effects), *more),
        corrected=corrected is not None,
        next="",
    )


def certified_of_both(done: TwoAxisResult) -> TwoAxisModel | None:
    """The simulator with what is better on held-out trials: the joins, and each axis for itself; None for nothing.

    Each axis was diagnosed with the joins taken off. Where these are not better by themselves, nothing is changed.
    """
    joins, diagnosis = done.diagnosis.joins, done.diagnosis
    if joins.effects and not joins.gap.joined_rmse_deg < joins.gap.nominal_rmse_deg:
        return None
    if not (joins.effects or certified(diagnosis.x) or certified(diagnosis.y)):
        return None
    return done.corrected(certified)


def _described(fitted: TwoAxisFit, kind: str, left_out_deg: float) -> FittedModel:
    """Result of the identification of both axes; sizes of errors are distances in their plane.

    `left_out_deg` is NaN where no motion was left out.
    """
    checked = f"; motion left out {left_out_deg:.3g} deg" if math.isfinite(left_out_deg) else ""
    noises = [axis.simulator.identification.noise for axis in fitted.axes if axis.simulator is not None]
    sensor = [math.nan if noise is None else noise.sensor_sigma_deg for noise in noises]
    model = [math.nan if n is None or n.model_sigma_deg is None else n.model_sigma_deg for n in noises]
    named = [(name, axis.parts) for name, axis in zip(NAMES, fitted.axes, strict=True) if axis.parts is not None]
    return FittedModel(
        report=f"{kind}: {fitted.report}; {_turned(fitted)}{checked}",
        parts=tuple((f"{n}: {r.part}", r.form, r.without_deg, r.with_deg) for n, p in named for r in p.rows),
        numbers=tuple((f"{n}: {r.owner} {r.name}", r.value, *r.ci90) for n, p in named for r in p.parameters),
        sensor_sigma_deg=math.hypot(*sensor),
        model_sigma_deg=math.hypot(*model),
        advice=tuple(f"{n}: {text}" for n, p in named for text in p.advice),
        sensor_step_deg=sensor_step_deg(fitted.model),
        left_out_deg=left_out_deg,
    )


def _turned(fitted: TwoAxisFit) -> str:
    """Turns of the tendons and of the sensor's frame, in words."""
    (tx, ty), (fx, fy) = turns_deg(fitted.model.mix), turns_deg(fitted.model.frame)
    return f"tendons turned by {tx:.1f} and {ty:.1f} deg, the sensor's frame by {fx:.1f} and {fy:.1f} deg"


def turns_deg(matrix: Sequence[Sequence[float]]) -> tuple[float, float]:
    """Turns of x and of y by the columns of a matrix [deg]: of the tendons by M, of the sensor's frame by A.

    Args:
        matrix: (2, 2).
    """
    (a, b), (c, d) = matrix
    return math.degrees(math.atan2(c, a)), math.degrees(math.atan2(-b, d))


def reached_plane(subject: Subject, model: TwoAxisModel) -> ReachedPlane:
    """Box of both angles for references: seen in the recordings, within the limits, its corners reachable at rest.

    Raises:
        FitError: if nothing of the box is reachable.
    """
    angles = np.vstack([trial.angles for trial in uniform_trials(subject)])
    allowed = subject.angle_limits or (-math.inf, math.inf)
    low, high = np.maximum(angles.min(axis=0), allowed[0]), np.minimum(angles.max(axis=0), allowed[1])
    tip, share = TwoAxisTipController(model, TwoAxisTipSettings(model=MODEL_FILE)), 1.0
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    corners = [np.array([a, b]) for a in (-1, 1) for b in (-1, 1)]
    while not all(tip.reachable(middle + share * half * corner) for corner in corners):
        share *= _SHRINKS
        if share < _LEAST_BOX:
            raise FitError(
                f"model: reaches no box of angles around {middle.round(1).tolist()} deg, expected what the recordings "
                "show; look at the free runs of the model"
            )
    speeds = [
        share * float(2 * h) / (one.upper - one.lower) * one.rate
        for h, one in zip(half, each(subject.limits), strict=True)
    ]
    ends = zip((middle - share * half).tolist(), (middle + share * half).tolist(), speeds, strict=True)
    x, y = (ReachedAngles(*one) for one in ends)
    return ReachedPlane(x, y)


def make_plane_controllers(
    subject: Subject, model: Path, sigma_deg: float, folder: Path, progress: Progress
) -> ControllerFiles:
    """Write `tip.yaml` next to the stage's folder, and `pid.yaml`, `inverse.yaml` and `inverse_pid.yaml` into it.

    The PID is decoupled by what joins the axes, in `decoupled.yaml`.

    Raises:
        HystmpcError: if the model cannot be used.
        KeyboardInterrupt: if the user ended the search; nothing is kept.
    """
    known = load_two_axes(model)
    reached = reached_plane(subject, known)
    apart = replace(known, cross_friction=None).save(folder / DECOUPLED_FILE)
    models, travel = {"pid": apart, "inverse_pid": model}, CommandLimits(*known.travel_limits()[0])
    first, shares = ChainModel(known.axes[0], "conditioned"), evaluations(subject)
    starts: dict[str, PidLike] = {
        "pid": PidControllerSettings(gains=start_gains(first, travel, PidControllerSettings().gains)),
        "inverse_pid": InversePidControllerSettings(
            gains=start_gains(first, travel, InversePidControllerSettings().gains)
        ),
    }
    tuned = dict[str, PidTuning]()
    for (name, start), part in zip(starts.items(), parts(progress, list(shares.values())), strict=True):
        square = partial(mean_square_of, _study(subject, model, models[name], reached, sigma_deg))
        tuned[name] = searched_gains(start, square, shares[name], subject.block.seed, part)
    step = sensor_step_deg(known)
    gains = {name: one.settings.gains.with_dead_zone(step).model_dump() for name, one in tuned.items()}
    files: dict[Path, dict[str, Any]] = {
        folder / "pid.yaml": {"kind": "pid", "gains": gains["pid"]},
        folder / "inverse_pid.yaml": {"kind": "inverse_pid", "gains": gains["inverse_pid"]},
        folder / "inverse.yaml": {"kind": "inverse"},
        folder.parent / TIP_FILE: {"kind": "linearised_mpc", "supervisor": {"pid": gains["pid"]}},
    }
    for file, controller in files.items():
        _write_tip(file, models.get(file.stem, model), controller, subject, reached, target_tolerance_deg(sigma_deg))
    return ControllerFiles(
        reached, gains["pid"], tuned["pid"].rmse_deg, gains["inverse_pid"], tuned["inverse_pid"].rmse_deg
    )


def sensor_step_deg(model: TwoAxisModel) -> float:
    """Greater resolution of both angles according to the model [deg]; 0 for a continuous sensor."""
    noises = (axis.identification.noise for axis in model.axes)
    return max(0.0 if noise is None else noise.sensor_resolution_deg for noise in noises)


def _study(subject: Subject, device: Path, model: Path, reached: ReachedPlane, sigma_deg: float) -> TwoAxisStudy:
    """Simulated study for the tuning: the identified device with the sensor's noise, and the controller's model."""
    motions, step = tuning_references(subject, reached), sensor_step_deg(load_two_axes(device))
    noise = math.sqrt(max(sigma_deg**2 / AXES - step**2 / 12.0, 0.0))  # of each angle, without its steps
    data: dict[str, Any] = {
        "plant": {"simulator": str(device), "noise_deg": noise, "quantisation_deg": step},
        "model": str(model),
        "motions": {name: motion.model_dump() for name, motion in motions.items()},
        "controllers": {"pid": {"kind": "pid"}},
        "limits": _limits(subject),
        "seed": subject.block.seed + 1,
    }
    return prepare_two_axes(TwoAxisSimulationConfig.parse(data, "tuning"))


def _limits(subject: Subject) -> dict[str, list[float]]:
    both: tuple[CommandLimits, ...] = each(subject.limits)
    return {
        "lower": [one.lower for one in both],
        "upper": [one.upper for one in both],
        "rate_per_s": [one.rate for one in both],
    }


def _write_tip(
    file: Path,
    model: Path,
    controller: Mapping[str, Any],
    subject: Subject,
    reached: ReachedPlane,
    tolerance_deg: float,
) -> Path:
    """Write the file of a `TipController` of two axes; the model's name is relative to it."""
    data = {
        "model": os.path.relpath(model, file.parent),
        "controller": dict(controller),
        "limits": _limits(subject),
        "motion": reached.motion.model_dump(),
        "start_command": list(each(subject.safe_command)),
        "tolerance_deg": tolerance_deg,
    }
    TwoAxisTipSettings.parse(data, str(file))
    return write_atomically(file, dump_yaml(data))
