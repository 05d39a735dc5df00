"""Evaluation of a model on recorded trials: free run from the command alone, and its error in degrees."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.trials.brief import brief, in_brief
from hystmpc.trials.errors import ModelError
from hystmpc.trials.segments import first_flexure_end, segment
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

from .contract.metadata import ModelMetadata
from .model import NO_INPUTS, LoadedModel
from .start import TrialStart, estimated_start, motion_line, search_box, trial_start

FORMAT = "hystmpc-evaluation/1"
INVERSE_FORMAT = "hystmpc-inverse-evaluation/1"
TWO_AXIS_FORMAT = "hystmpc-two-axis-evaluation/1"
ERROR_COLUMNS = ("trial", "RMSE", "bias", "no bias", "max", "NRMSE %", "hold drift")
TWO_AXIS_COLUMNS = ("trial", "RMSE x", "RMSE y", "tip", "bias", "max", "NRMSE %", "hold drift")  # the tip's last
HOLD_S, SETTLING_S = 10.0, 1.0
AT_REST = TrialStart(0.0, 0.0)
RANGE_SLACK = 1e-3  # share of the trained range within which a sample beyond its end counts as inside


@dataclass(frozen=True)
class Errors:
    """Errors of one free run, model minus measurement.

    Attributes:
        rmse_deg: root mean square error (S1 (RA-L 2021) eq. (8)).
        offset_free_rmse_deg: root mean square of the error less its mean.
        max_abs_error_deg: greatest absolute error (called MAE in S1 eq. (7)).
        nrmse: rmse over the range of the measured angle (S1 eq. (9)).
        hold_drift_deg: greatest range of the model's angle while the command is constant, from 1 s after it stopped:
            over the holds of the trial and over 10 s in which the trial's last command is held.
    """

    rmse_deg: float
    bias_deg: float
    offset_free_rmse_deg: float
    max_abs_error_deg: float
    nrmse: float
    hold_drift_deg: float
    __repr__ = brief


@dataclass(frozen=True, eq=False)
class TrialEvaluation:
    """Free run over one trial with its errors.

    Attributes:
        trial: the scored trial, at the model's sample time.
        theta: the model's angle [deg], shape (T,); angles (T, 2) of two axes.
        start: first sample that counts.
        outside: share of samples whose command lies outside the range of the model's identification, where its angle is
            an extrapolation.
        began: start of the free run; with a lead where the trial begins in motion.
        axes: errors of x and y of a model of two axes, whose `errors` are those of the tip.
    """

    trial: Trial
    theta: Vec
    start: int
    errors: Errors
    outside: float = 0.0
    began: TrialStart = AT_REST
    axes: tuple[Errors, ...] = ()

    @property
    def unscored_s(self) -> float:
        """Duration at the start of a trial in motion that is used to estimate the state [s]; else zero."""
        return self.began.lead * self.trial.dt

    @property
    def start_line(self) -> str:
        """Sentence on a trial that begins in motion; empty where it begins at rest."""
        name = Path(self.trial.source).name
        return "" if self.began.at_rest else motion_line(name, self.began, self.trial.dt)

    def __repr__(self) -> str:
        e, unit = self.errors, self.trial.units.angle
        numbers = f"RMSE {e.rmse_deg:.4g}, bias {e.bias_deg:.4g}, at most {e.max_abs_error_deg:.4g} {unit}"
        return in_brief(self, f"{Path(self.trial.source).name}: {numbers}")


def free_run(
    model: LoadedModel, commands: Vec, start: float | TrialStart, inputs: Mapping[str, Vec] = NO_INPUTS
) -> Vec:
    """Angles (T,) [deg] of a model over commands (T,), from a start and without any other measurement.

    Args:
        commands: (T,) [command unit].
        start: angle [deg] of the device at rest at the first command; or another start.
        inputs: measured inputs (T,) by name; their references where left out.
    """
    if not isinstance(start, TrialStart):
        start = TrialStart(float(commands[0]), start)
    whole = np.concatenate([start.approach, commands])
    first, early = {name: float(z[0]) for name, z in inputs.items()}, len(start.approach)
    along = {name: np.pad(z, (early, 0), mode="edge") for name, z in inputs.items()}
    if not inputs:
        return model.run_on(model.at_rest(start.angle, start.command)[None], whole[None])[0][0, early:]
    return model.run_on(model.at_rest(start.angle, start.command, first)[None], whole[None], along)[0][0, early:]


def started(model: LoadedModel, trial: Trial) -> TrialStart:
    """Start of a free run over a trial: at rest, or estimated by the model; see `models.start`."""
    start, facts = trial_start(trial.command, trial.angle, trial.dt, trial.inverted), model.metadata

    inputs = inputs_for(model, trial)

    def runs(commands: Vec, angles: Vec, plans: Vec) -> Vec:
        if not inputs:
            return model.run_on(model.resting(commands, angles), plans)[0]
        first, early = {name: float(z[0]) for name, z in inputs.items()}, plans.shape[1] - start.lead
        along = {name: np.r_[np.full(early, z[0]), z[: start.lead]] for name, z in inputs.items()}
        return model.run_on(model.resting(commands, angles, first), plans, along)[0]

    box = search_box(facts.trained_command, facts.trained_angle)
    return estimated_start(start, trial.command, trial.angle, trial.dt, box, runs)


def inputs_for(model: LoadedModel, trial: Trial) -> Mapping[str, Vec]:
    """Measured inputs of a trial on which the model depends, by name.

    Raises:
        LogError: if the trial lacks one.
    """
    return trial.with_inputs([given.name for given in model.inputs]).inputs if model.inputs else {}


def evaluate(
    model: LoadedModel, trial: Trial, skip_first_flexure: bool = False, before: Trial | None = None
) -> TrialEvaluation:
    """Evaluate the free run of a model over one trial at the model's sample time.

    An inverse map is evaluated on the swapped trial. In a trial that begins in motion, the first seconds serve to
    estimate the state and are not scored (`models.start`).

    Args:
        skip_first_flexure: score from the first reversal of the trial's command on.
        before: earlier samples of the same log, for a trial that is part of it. The free run begins with them, and they
            are not scored.

    Raises:
        ModelError: if sample times or units differ, or the model's angle is not finite.
        LogError: if the first flexure is to be skipped and the command never turns, or the trial lacks an input.
    """
    metadata = model.metadata
    trial = trial.swapped() if metadata.inverted and not trial.inverted else trial
    require_rate_and_units(trial, metadata)
    held = np.full(round(HOLD_S / trial.dt), trial.command[-1])
    began = before or trial
    began = began.swapped() if trial.inverted and not began.inverted else began
    lead = began.command if before else trial.command[:0]
    begin = started(model, began)
    commands = np.concatenate([lead, trial.command, held])
    inputs = {
        name: np.concatenate([inputs_for(model, began)[name] if before else z[:0], z, np.full(held.size, z[-1])])
        for name, z in inputs_for(model, trial).items()
    }
    theta = free_run(model, commands, begin, inputs)[lead.size :]
    if not np.all(np.isfinite(theta)):
        raise ModelError(
            f"{trial.source}: the model's angle is not finite from sample {np.argmin(np.isfinite(theta))} on"
        )
    begin = replace(begin, lead=max(begin.lead - lead.size, 0))
    start = max(first_flexure_end(trial) if skip_first_flexure else 0, begin.lead)
    holds = [(a, b) for a, b in segment(trial).holds if a >= start] + [(len(trial), theta.size)]
    errors = errors_of(trial, theta, start, holds)
    return TrialEvaluation(trial, theta[: len(trial)], start, errors, outside_share(trial, metadata), begin)


def require_rate_and_units(trial: Trial, metadata: ModelMetadata) -> None:
    """Refuse a trial of another sample time, or of other units than a model.

    Raises:
        ModelError: if sample times or units differ.
    """
    if abs(trial.dt - metadata.dt_s) > 1e-3 * metadata.dt_s:
        raise ModelError(f"{trial.source}: sampled every {trial.dt:.6g} s, expected {metadata.dt_s:.6g} s; resample it")
    if trial.units != Units(metadata.command_unit, metadata.angle_unit, metadata.inverted):
        raise ModelError(
            f"{trial.source}: {trial.units.command} in and {trial.units.angle} out, expected {metadata.command_unit} "
            f"and {metadata.angle_unit} as the model has them"
        )


def mean_errors(evaluations: Sequence[TrialEvaluation]) -> Errors:
    """Mean of each error over trials; the bias keeps its sign."""
    return _mean([e.errors for e in evaluations])


def _mean(errors: Sequence[Errors]) -> Errors:
    names = [field.name for field in fields(Errors)]
    return Errors(*(float(np.mean([getattr(e, name) for e in errors])) for name in names))


def evaluation_json(evaluations: Sequence[TrialEvaluation]) -> dict[str, Any]:
    """Evaluation as plain data in the format `hystmpc-evaluation/1`.

    That of an inverse map has another name, and that of two axes, where the keys of `tip`, `x` and `y` are the same.
    """
    if evaluations[0].axes:
        return _json_of_two_axes(evaluations)
    rows = [{"file": Path(e.trial.source).name, **vars(e.errors), "unscored_s": e.unscored_s} for e in evaluations]
    mean = dict(vars(mean_errors(evaluations)))
    if not evaluations[0].trial.inverted:
        return {"format": FORMAT, "trials": rows, "mean": mean}
    unit = evaluations[0].trial.units.angle
    plain = [{key.removesuffix("_deg"): value for key, value in row.items()} for row in (*rows, mean)]
    return {"format": INVERSE_FORMAT, "unit": unit, "trials": plain[:-1], "mean": plain[-1]}


def _json_of_two_axes(evaluations: Sequence[TrialEvaluation]) -> dict[str, Any]:
    def parts(tip: Errors, x: Errors, y: Errors) -> dict[str, Any]:
        return {"tip": dict(vars(tip)), "x": dict(vars(x)), "y": dict(vars(y))}

    rows = [
        {"file": Path(e.trial.source).name, **parts(e.errors, *e.axes), "unscored_s": e.unscored_s} for e in evaluations
    ]
    return {
        "format": TWO_AXIS_FORMAT,
        "trials": rows,
        "mean": parts(mean_errors(evaluations), *_mean_axes(evaluations)),
    }


def _mean_axes(evaluations: Sequence[TrialEvaluation]) -> tuple[Errors, ...]:
    return tuple(_mean(one) for one in zip(*(e.axes for e in evaluations), strict=True))


def start_sentences(results: Sequence[TrialEvaluation]) -> list[str]:
    """Sentences on the trials that begin in motion."""
    return [line for result in results if (line := result.start_line)]


def error_table(results: Sequence[TrialEvaluation]) -> tuple[Sequence[str], list[list[str]]]:
    """Columns, and rows of the errors of each trial and of their mean, in the unit of the output."""
    places = _decimals(max(float(np.ptp(result.trial.angles, axis=0).max()) for result in results))
    rows = [_row(Path(result.trial.source).name, result.errors, places, result.axes) for result in results]
    rows.append(_row("mean", mean_errors(results), places, _mean_axes(results)))
    return TWO_AXIS_COLUMNS if results[0].axes else ERROR_COLUMNS, rows


def error_sentence(results: Sequence[TrialEvaluation], which: str = "") -> str:
    """Sentence on the error of the free runs.

    Args:
        which: words behind their number, such as ` that the fit did not see`.
    """
    unit, mean = results[0].trial.units.angle, mean_errors(results)
    trials = "1 trial" if len(results) == 1 else f"{len(results)} trials"
    if results[0].axes:
        x, y = (f"{axis.rmse_deg:.3g}" for axis in _mean_axes(results))
        return (
            f"The free run errs by {mean.rmse_deg:.3g} {unit} RMS at the tip (x {x}, y {y} {unit}) on {trials}{which}"
        )
    size = f"{mean.rmse_deg:.3g} {unit} RMS ({100 * mean.nrmse:.2g} % of the range)"
    return f"The free run errs by {size} on {trials}{which}"


def _row(name: str, e: Errors, places: int, axes: Sequence[Errors]) -> list[str]:
    spread = () if axes else (e.offset_free_rmse_deg,)
    figures = (*(axis.rmse_deg for axis in axes), e.rmse_deg, e.bias_deg, *spread, e.max_abs_error_deg)
    return [name, *(f"{x:.{places}f}" for x in figures), f"{100 * e.nrmse:.3f}", f"{e.hold_drift_deg:.{places}f}"]


def _decimals(span: float) -> int:
    """Number of decimal places for errors in a table: three for a range of tens, more for a smaller one."""
    return 3 if span <= 0 else max(3, 4 - math.floor(math.log10(span)))


def outside_share(trial: Trial, metadata: ModelMetadata) -> float:
    """Share of samples whose command is outside the range of the model's identification."""
    trained = metadata.trained_command
    slack = RANGE_SLACK * (trained.upper - trained.lower)
    beyond = np.maximum(trained.lower - trial.command, trial.command - trained.upper)
    return float(np.mean(beyond > slack))


def errors_of(trial: Trial, theta: Vec, start: int, holds: list[tuple[int, int]]) -> Errors:
    """Errors of a free run from the sample `start` on; the holds (first and last sample) are within theta."""
    error = theta[start : len(trial)] - trial.angle[start:]
    rmse = math.sqrt(float(np.mean(error**2)))
    settling = round(SETTLING_S / trial.dt)
    ranges = [float(np.ptp(theta[a + settling : b])) for a, b in holds if b - a > settling + 1]
    return Errors(
        rmse,
        float(np.mean(error)),
        float(np.std(error)),
        float(np.max(np.abs(error))),
        rmse / float(np.ptp(trial.angle[start:])) if np.ptp(trial.angle[start:]) > 0 else math.inf,
        max(ranges),
    )
