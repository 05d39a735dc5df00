"""Review of a run: predicted and measured angle, recommended work, and the page report.html of the run folder."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hystmpc.ctrl.monitor import ChangeMonitor
from hystmpc.models.evaluate import free_run
from hystmpc.models.load import load_model, model_path
from hystmpc.models.model import LoadedModel
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import LogError, TrajectoryError
from hystmpc.trials.figure_data import draw_long
from hystmpc.trials.from_outside import only_reads
from hystmpc.trials.json_text import mapping_in
from hystmpc.trials.layouts import CANONICAL
from hystmpc.trials.report import Heading, KeyValues, Paragraph, Piece, Plot, Report, Table, style
from hystmpc.trials.run_folder import Column, RunFolder
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec, lagged, rms

from ..axes import from_the_first
from ..config import BenchSettings, RunSettings
from ..recording.report import Log, causes, numbers, timing_table, tracked
from ..recording.sample import TAKEN

TRIAL_FILE = "trial.csv"
_LEAST = 10  # samples that can be judged
_PREPARATION = ("move", "flexure")  # the first flexure differs from all later ones (S2)


@dataclass(frozen=True, eq=False)
class ReviewedRun:
    """Signals of a run, one row for each sample (N,): the command of the sample, all else at its end."""

    t: Vec  # end of the sample [s]
    command: Vec
    measured_deg: Vec
    reference_deg: Vec
    predicted_deg: Vec  # one sample before [deg]
    free_deg: Vec  # the model's free run over the commands, without any measurement [deg]
    counted: NDArray[np.bool_]  # samples that are judged: with an angle, after the first flexure
    monitor: ChangeMonitor  # of the model
    inputs: Mapping[str, Vec] = field(default_factory=dict)  # measured inputs in each sample, by name


@dataclass(frozen=True)
class Review:
    """Assessment of a model by a run: tracking error, prediction errors, and advice."""

    advice: str  # one line: nothing is due, a new identification, or a diagnosis
    tracking_deg: float  # RMS of measured minus wanted angle [deg]; NaN without a reference
    one_step_deg: float  # RMS of measured minus the angle predicted one sample before, measurements included [deg]
    free_run_deg: float  # RMS of measured minus the model's free run [deg]
    offset_deg: float  # of the line from the free run to the measured angle
    gain: float  # of that line
    corrected_deg: float  # rest of `free_run_deg` after that line: the shape that the model does not have
    change: str = field(default="", kw_only=True)  # sentence on a change of the device; empty with too little data
    greatest_deg: float = field(default=math.nan, kw_only=True)  # greatest of measured minus wanted angle [deg]

    @property
    def lines(self) -> tuple[str, ...]:
        """Available lines on tracking error, advice and change."""
        known = math.isfinite(self.tracking_deg)
        tracking = (
            f"tracking error {self.tracking_deg:.2f} deg RMS, {self.greatest_deg:.2f} deg at most" if known else ""
        )
        return tuple(line for line in (tracking, self.advice, self.change) if line)


def compare_with_model(run: RunFolder, settings: RunSettings) -> ReviewedRun:
    """Compare the samples of the log with the free run of the model.

    Raises:
        LogError: if the log lacks a column or is too short.
        ModelError: if the model is missing.
    """
    log = run.log()
    wanted = ("time_s", "angle_deg", "reference_deg", "predicted_deg", "sequence", "source")
    if gone := [name for name in wanted if name not in log]:
        raise LogError(f"{run.path}: the log lacks {', '.join(gone)}, expected the log of a run at a bench")
    sequence = numbers(log, "sequence").astype(np.int64)
    if sequence.size < _LEAST:
        raise LogError(f"{run.path}: {sequence.size} samples, expected at least {_LEAST} to be judged")
    command = numbers(log, CANONICAL.command_column(list(log)))
    follows = np.flatnonzero(np.diff(sequence) == 1)  # rows whose end is the next row's beginning
    angle = _angles_when_taken(log)
    model = load_model(model_path(settings.controller.model), start="conditioned")
    inputs = logged_inputs(log, settings.inputs)
    free = _free_run(model, settings, command, sequence, angle, inputs)
    measured, trained = angle[follows + 1], model.metadata.trained_angle
    sources = [str(text) for text in log["source"]]
    past = max((k for k, name in enumerate(sources) if name in _PREPARATION), default=-1)
    return ReviewedRun(
        t=numbers(log, "time_s")[follows] + settings.dt_s,
        command=command[follows],
        measured_deg=measured,
        reference_deg=numbers(log, "reference_deg")[follows],
        predicted_deg=numbers(log, "predicted_deg")[follows],
        free_deg=free[follows],
        counted=np.isfinite(measured) & np.isfinite(free[follows]) & (follows > past),
        monitor=ChangeMonitor(model.metadata.noise, settings.dt_s, (trained.lower, trained.upper)),
        inputs={name: values[follows] for name, values in inputs.items()},
    )


def logged_inputs(log: Log, names: Sequence[str]) -> Mapping[str, Vec]:
    """Measured inputs (N,) of a log by name, see `from_the_first`; without those that have no value."""
    made = {name: from_the_first(numbers(log, name)) for name in names if name in log}
    return {name: values for name, values in made.items() if values.size}


def review(rows: ReviewedRun, due_above_deg: float) -> Review:
    """Compute the tracking and prediction errors of a run, and the advice that follows from them.

    The free run r over the commands sent is compared with the measured angle y. Up to `due_above_deg` nothing is due.
    Beyond it, the line y = offset + gain r decides: where it takes the error below the bar the model has the right
    shape and needs new numbers, otherwise an effect is missing in it.

    Raises:
        LogError: if too few samples can be judged.
    """
    y, r = rows.measured_deg[rows.counted], rows.free_deg[rows.counted]
    if y.size < _LEAST:
        raise LogError(f"review: {y.size} samples with an angle after preparation, expected at least {_LEAST}")
    moved = float(np.ptp(r)) > due_above_deg
    gain, offset = (float(c) for c in np.polyfit(r, y, 1)) if moved else (1.0, float(np.mean(y - r)))
    free, corrected = rms(y - r), rms(y - offset - gain * r)
    error = (rows.measured_deg - rows.reference_deg)[rows.counted]
    error = error[np.isfinite(error)]
    return Review(
        advice=_advice(free, corrected, offset, gain, due_above_deg),
        tracking_deg=rms(error),
        one_step_deg=rms((rows.measured_deg - rows.predicted_deg)[rows.counted]),
        free_run_deg=free,
        offset_deg=offset,
        gain=gain,
        corrected_deg=corrected,
        change=_change(rows, r, y),
        greatest_deg=float(np.max(np.abs(error))) if error.size else math.nan,
    )


def _angles_when_taken(log: Mapping[str, Column]) -> Vec:
    """Angles (N,) [deg] in the rows of their measurement times; NaN in all other rows."""
    angle = numbers(log, "angle_deg")
    if TAKEN not in log:
        return angle
    time, taken = numbers(log, "time_s"), numbers(log, TAKEN)
    seen = np.flatnonzero(np.isfinite(angle))
    placed = np.full_like(angle, np.nan)
    when = np.where(np.isfinite(taken), taken, time)[seen]
    placed[np.searchsorted(0.5 * (time[1:] + time[:-1]), when)] = angle[seen]
    return placed


def _change(rows: ReviewedRun, free_deg: Vec, measured_deg: Vec) -> str:
    """Sentence on a change of the device; empty without the model's noise or with too few samples."""
    change, when_s = rows.monitor.along(free_deg, measured_deg)
    if math.isnan(change.probability):
        return ""
    if change.certain:
        return f"{change}, said {when_s:.0f} s after the preparation"
    return (
        f"the device is as it was identified (p of a change {change.probability:.3f}; the model is off by "
        f"{change.level:.1f} times its usual error)"
    )


def _free_run(
    model: LoadedModel,
    settings: RunSettings,
    command: Vec,
    sequence: NDArray[np.int64],
    angle: Vec,
    inputs: Mapping[str, Vec],
) -> Vec:
    """Model's angles (N,) at the ends of the samples; commands are held over skipped samples."""
    place = sequence - sequence[0]
    row = np.searchsorted(place, np.arange(place[-1] + 1), side="right") - 1
    sent, lag_s = command[row], settings.controller.actuator_lag_s
    if lag_s > 0:
        sent = lagged(sent, math.exp(-settings.dt_s / lag_s))
    finite = angle[np.isfinite(angle)]
    known = {one.name: inputs[one.name][row] for one in model.inputs if one.name in inputs}
    return free_run(model, sent, float(finite[0]) if finite.size else 0.0, known)[place]


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


@only_reads()
def review_run(folder: Path, more: Sequence[Piece] = ()) -> Review:
    """Review a run folder and write its `trial.csv` (for `fit` and `diagnose`) and `report.html`.

    A run that is too short for a review still gets a report; `more` is shown after the advice.

    Raises:
        LogError: if the folder holds no readable run.
        ConfigError: if its settings are not those of a run.
    """
    run = RunFolder.open(folder)
    settings = RunSettings.parse(run.config(), str(folder / "config.yaml"))
    rows = None
    try:
        rows = compare_with_model(run, settings)
        verdict = review(rows, settings.review.due_above_deg)
        usable = np.isfinite(rows.measured_deg)
        signals = rows.t[usable], rows.command[usable], rows.measured_deg[usable]
        inputs = {name: values[usable] for name, values in rows.inputs.items()}
        write_csv(Trial(*signals, inputs, Units(settings.command_unit)), folder / TRIAL_FILE)
    except (LogError, TrajectoryError) as error:
        verdict = Review(f"not judged: {error}", *(math.nan,) * 6)
    write_page(run, settings, rows, verdict, more)
    return verdict


def write_page(
    run: RunFolder, settings: RunSettings, rows: ReviewedRun | None, verdict: Review, more: Sequence[Piece] = ()
) -> Path:
    """Write report.html of a run; `rows` is None with too few samples, `more` follows the advice."""
    timing, log = mapping_in(run.path / "timing.json"), run.log()
    pieces = [*ending_pieces(timing), *line_pieces(verdict.lines)]
    pieces += [*more, Heading("Run"), KeyValues(_figures(settings, verdict, log, timing))]
    if rows is not None:
        figure = tracked(rows.t, rows.reference_deg, rows.measured_deg, rows.command, settings.command_unit)
        pieces += [
            Heading("Tracking"),
            Plot(figure, "Reference, measured angle and command over time.", True),
            Heading("Predicted and measured angle"),
            Plot(_prediction(rows), "Measured less predicted angle: one sample ahead, and in a free run.", True),
        ]
    pieces += [*timing_pieces(timing, settings.dt_s), Heading("Stages of a sample"), timing_table(log), *causes(log)]
    run_page = Report("Run at the bench", tuple(pieces), f"{settings.name}, {run.meta.get('start', '')}")
    return run.write_report(run_page)


def ending_pieces(timing: Mapping[str, Any]) -> Iterator[Piece]:
    """What a report says first of a run that was stopped or killed; `timing` is that of `timing.json`."""
    if not timing:
        killed = "The program was killed before it could say how the run ended: there is no timing.json."
        yield Paragraph(killed)
    elif timing.get("outcome", {}).get("cause"):
        yield Heading(f"Stopped: {timing['outcome']['cause']}")
        yield Paragraph("The stop is latched. Look at the device, then run again with `--reset`.")


def line_pieces(lines: Sequence[str]) -> list[Piece]:
    """A paragraph for each line of a review."""
    return [Paragraph(line[0].upper() + line[1:] + ".") for line in lines]


def _figures(settings: RunSettings, verdict: Review, log: Log, timing: Mapping[str, Any]) -> dict[str, object]:
    judged = {
        "RMS tracking error [deg]": verdict.tracking_deg,
        "greatest tracking error [deg]": verdict.greatest_deg,
        "RMS prediction error, one sample ahead [deg]": verdict.one_step_deg,
        "RMS prediction error, free run [deg]": verdict.free_run_deg,
        "... behind the best line [deg]": verdict.corrected_deg,
        "gain of that line": verdict.gain,
        "offset of that line [deg]": verdict.offset_deg,
    }
    return run_figures(settings, settings.controller.model, judged, numbers(log, "angle_deg"), timing)


def run_figures(
    settings: BenchSettings, model: str, judged: Mapping[str, float], angles: Vec, timing: Mapping[str, Any]
) -> dict[str, object]:
    """Names and values of the table of a run.

    Args:
        model: file of the model.
        judged: errors by name; what is not finite is left out.
        angles: measured angles (N,) [deg], not-a-number where one is missing.
        timing: of `timing.json`.
    """
    wire, outcome = timing.get("wire", {}), timing.get("outcome", {})
    sent = outcome.get("samples", 0) - timing.get("skipped", 0)
    return {
        "device": settings.name,
        "transport": settings.transport.kind,
        "model": model,
        "rate [Hz]": settings.rate_hz,
        "samples": angles.size,
        "samples without an angle": int(np.count_nonzero(~np.isfinite(angles))),
        "samples not in the log": sent - angles.size if timing else "unknown",
        **{name: value for name, value in judged.items() if math.isfinite(value)},
        "deadlines missed, samples skipped": f"{timing.get('missed', '?')}, {timing.get('skipped', '?')}",
        "commands limited at the last line": outcome.get("clipped", "unknown"),
        "measurements lost on the way": wire.get("lost", "unknown"),
        "messages rejected": ", ".join(f"{n} {c}" for c, n in wire.get("rejected", {}).items()) or "none",
    }


def _prediction(rows: ReviewedRun) -> Figure:
    with style():
        figure = Figure(figsize=(8, 3), layout="constrained")
        axes = figure.subplots()
        draw_long(axes, rows.t, rows.measured_deg - rows.free_deg, label="free run", color="C1")
        draw_long(axes, rows.t, rows.measured_deg - rows.predicted_deg, label="one sample ahead", color="C0")
        axes.axhline(0.0, color="0.6", linewidth=0.8)
        axes.set_xlabel("time [s]")
        axes.set_ylabel("measured less predicted [deg]")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2)
    return figure


def timing_pieces(timing: Mapping[str, Any], dt_s: float) -> Iterator[Piece]:
    """Table and histograms of period, execution and jitter; `timing` is that of `timing.json`."""
    if not timing:
        return
    yield Heading("Timing")
    keys = ("median_s", "p99_s", "p999_s", "greatest_s")
    rows = []
    for name in ("period", "execution", "jitter"):
        summary = timing[name]["summary"]
        rows.append((name, *(float("nan") if summary[k] is None else 1e3 * summary[k] for k in keys)))
    yield Table(("", "median", "p99", "p99.9", "greatest"), rows, "Milliseconds; jitter is lateness of the wake-up.")
    with style():
        figure = Figure(figsize=(8, 2.6), layout="constrained")
        for axes, name in zip(figure.subplots(1, 3), ("period", "execution", "jitter"), strict=True):
            width = 1e3 * timing[name]["bin_s"]
            counts = {int(k): n for k, n in timing[name]["counts"].items()}
            axes.bar([width * (k + 0.5) for k in counts], list(counts.values()), width=width, log=True)
            axes.set_xlabel(f"{name} [ms]")
            axes.axvline(1e3 * dt_s, color="0.4", linestyle=":", linewidth=1)
        figure.axes[0].set_ylabel("samples")
    yield Plot(figure, "Counts of the control thread itself; dotted: sample time; the last bin holds all beyond it.")
