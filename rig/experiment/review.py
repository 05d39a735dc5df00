"""After a run: predicted against measured angle, and whether a new identification or a diagnosis is due."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hystmpc.ctrl.monitor import ChangeMonitor
from hystmpc.models.contract.metadata import Range
from hystmpc.models.evaluate import free_run
from hystmpc.models.load import load_model, model_path
from hystmpc.models.model import LoadedModel
from hystmpc.trials.errors import LogError
from hystmpc.trials.layouts import CANONICAL
from hystmpc.trials.run_folder import Column, RunFolder
from hystmpc.trials.types import Vec

from ..config import RunSettings
from ..recording.csv_log import TAKEN

TRIAL_FILE = "trial.csv"
_LEAST = 10  # samples that can be judged
_PREPARATION = ("move", "flexure")  # the first flexure differs from all later ones (S2)


@dataclass(frozen=True, eq=False)
class ReviewedRun:
    """A run, one row a sample (N,): the command of the sample and everything else at its end.

    Attributes:
        t: end of the sample [s].
        command: sent.
        measured_deg, reference_deg, predicted_deg: angle measured, wanted, and predicted one sample before [deg].
        free_deg: the model's free run over the commands, without any measurement [deg].
        counted: samples that are judged: with an angle, after the first flexure.
        monitor: of the model.
    """

    t: Vec
    command: Vec
    measured_deg: Vec
    reference_deg: Vec
    predicted_deg: Vec
    free_deg: Vec
    counted: NDArray[np.bool_]
    monitor: ChangeMonitor


@dataclass(frozen=True)
class Review:
    """What a run says about its model.

    Attributes:
        advice: one line: nothing is due, a new identification, or a diagnosis.
        tracking_deg: RMS of measured less wanted angle [deg]; NaN without a reference.
        one_step_deg: RMS of measured less the angle predicted one sample before, measurements included [deg].
        free_run_deg: RMS of measured less the model's free run [deg].
        offset_deg, gain: of the line that leads from the free run to the measured angle.
        corrected_deg: what is left of `free_run_deg` behind that line: the shape that the model does not have.
        change: whether the device has changed since identification, in a sentence; empty where too little was seen.
        greatest_deg: greatest distance of the measured from the wanted angle [deg]; NaN without a reference.
    """

    advice: str
    tracking_deg: float
    one_step_deg: float
    free_run_deg: float
    offset_deg: float
    gain: float
    corrected_deg: float
    change: str = field(default="", kw_only=True)
    greatest_deg: float = field(default=math.nan, kw_only=True)

    @property
    def lines(self) -> tuple[str, ...]:
        """Tracking error, advice and change, as far as they are known."""
        known = math.isfinite(self.tracking_deg)
        tracking = (
            f"tracking error {self.tracking_deg:.2f} deg RMS, {self.greatest_deg:.2f} deg at most" if known else ""
        )
        return tuple(line for line in (tracking, self.advice, self.change) if line)


def compare_with_model(run: RunFolder, settings: RunSettings) -> ReviewedRun:
    """The run's log against its model.

    Raises:
        LogError: if the log lacks a column or is too short.
        ModelError: if the model is not there any more.
    """
    log = run.log()
    wanted = ("time_s", "angle_deg", "reference_deg", "predicted_deg", "sequence", "source")
    if gone := [name for name in wanted if name not in log]:
        raise LogError(f"{run.path}: the log lacks {', '.join(gone)}, expected the log of a run at a bench")
    sequence = _numbers(log, "sequence").astype(np.int64)
    if sequence.size < _LEAST:
        raise LogError(f"{run.path}: {sequence.size} samples, expected at least {_LEAST} to be judged")
    command = _numbers(log, CANONICAL.command_column(list(log)))
    follows = np.flatnonzero(np.diff(sequence) == 1)  # rows whose end is the next row's beginning
    angle = _angles_when_taken(log)
    model = load_model(model_path(settings.controller.model), start="conditioned")
    free = _free_run(model, settings, command, sequence, angle)
    measured = angle[follows + 1]
    sources = [str(text) for text in log["source"]]
    past = max((k for k, name in enumerate(sources) if name in _PREPARATION), default=-1)
    return ReviewedRun(
        t=_numbers(log, "time_s")[follows] + settings.dt_s,
        command=command[follows],
        measured_deg=measured,
        reference_deg=_numbers(log, "reference_deg")[follows],
        predicted_deg=_numbers(log, "predicted_deg")[follows],
        free_deg=free[follows],
        counted=np.isfinite(measured) & np.isfinite(free[follows]) & (follows > past),
        monitor=ChangeMonitor(model.metadata.noise, settings.dt_s, _ends(model.metadata.trained_angle)),
    )


def review(found: ReviewedRun, due_above_deg: float) -> Review:
    """Figures and advice.

    The free run r over the commands sent is compared with the measured angle y. Up to `due_above_deg` nothing is due.
    Beyond it, the line y = offset + gain r decides: where it takes the error below the bar the model has the right
    shape and wants new numbers, otherwise something is missing in it.

    Raises:
        LogError: if too few samples can be judged.
    """
    y, r = found.measured_deg[found.counted], found.free_deg[found.counted]
    if y.size < _LEAST:
        raise LogError(f"review: {y.size} samples with an angle after preparation, expected at least {_LEAST}")
    moved = float(np.ptp(r)) > due_above_deg
    gain, offset = (float(c) for c in np.polyfit(r, y, 1)) if moved else (1.0, float(np.mean(y - r)))
    free, corrected = _rms(y - r), _rms(y - offset - gain * r)
    error = (found.measured_deg - found.reference_deg)[found.counted]
    error = error[np.isfinite(error)]
    return Review(
        advice=_advice(free, corrected, offset, gain, due_above_deg),
        tracking_deg=_rms(error),
        one_step_deg=_rms((found.measured_deg - found.predicted_deg)[found.counted]),
        free_run_deg=free,
        offset_deg=offset,
        gain=gain,
        corrected_deg=corrected,
        change=_change(found, r, y),
        greatest_deg=float(np.max(np.abs(error))) if error.size else math.nan,
    )


def _angles_when_taken(log: Mapping[str, Column]) -> Vec:
    """Angles (N,) [deg] in the rows of the times at which they were taken; NaN in all others."""
    angle = _numbers(log, "angle_deg")
    if TAKEN not in log:
        return angle
    time, taken = _numbers(log, "time_s"), _numbers(log, TAKEN)
    seen = np.flatnonzero(np.isfinite(angle))
    placed = np.full_like(angle, np.nan)
    when = np.where(np.isfinite(taken), taken, time)[seen]
    placed[np.searchsorted(0.5 * (time[1:] + time[:-1]), when)] = angle[seen]
    return placed


def _ends(angles: Range) -> tuple[float, float]:
    return angles.lower, angles.upper


def _change(found: ReviewedRun, free_deg: Vec, measured_deg: Vec) -> str:
    """In a sentence; empty where the model's file does not say how far it is usually off, or too little was seen."""
    change, when_s = found.monitor.along(free_deg, measured_deg)
    if math.isnan(change.probability):
        return ""
    if change.certain:
        return f"{change}, said {when_s:.0f} s after the preparation"
    return (
        f"the device is as it was identified (p of a change {change.probability:.3f}; the model is off by "
        f"{change.level:.1f} times its usual error)"
    )


def _free_run(model: LoadedModel, settings: RunSettings, command: Vec, sequence: NDArray[np.int64], angle: Vec) -> Vec:
    """The model's angles (N,) at the ends of the samples; commands are held where samples were skipped."""
    place = sequence - sequence[0]
    row = np.searchsorted(place, np.arange(place[-1] + 1), side="right") - 1
    sent, lag_s = command[row], settings.controller.actuator_lag_s
    if lag_s > 0:
        sent = _lagged(sent, 1 - math.exp(-settings.dt_s / lag_s))
    finite = angle[np.isfinite(angle)]
    return free_run(model, sent, float(finite[0]) if finite.size else 0.0)[place]


def _lagged(u: Vec, share: float) -> Vec:
    """Commands behind a first-order lag that makes `share` of every step within a sample."""
    out, now = np.empty_like(u), float(u[0])
    for k, target in enumerate(u.tolist()):
        now += share * (target - now)
        out[k] = now
    return out


def _advice(free: float, corrected: float, offset: float, gain: float, bar: float) -> str:
    if free <= bar:
        return f"nothing is due: the model's free run is off by {free:.2f} deg RMS, the bar is {bar:g} deg"
    if corrected <= bar:
        return (
            f"a new identification is due: the free run is off by {free:.2f} deg RMS, {corrected:.2f} deg behind a "
            f"line with gain {gain:.3f} and offset {offset:+.2f} deg; record trials and `fit` again"
        )
    return (
        f"a diagnosis is due: the free run is off by {free:.2f} deg RMS and by {corrected:.2f} deg even behind the "
        f"best line, so the model lacks an effect; `diagnose` takes {TRIAL_FILE} of this folder"
    )


def _rms(values: Vec) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if known.size else math.nan


def _numbers(log: Mapping[str, Column], name: str) -> Vec:
    return np.asarray(log[name], dtype=np.float64)
