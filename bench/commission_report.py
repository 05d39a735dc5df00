"""report.html of a commissioning: what the device is, before and after, device time, next steps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.models.evaluate import evaluate
from hystmpc.models.load import load_model
from hystmpc.trials.report import (
    COMMAND,
    DASHES,
    MEASURED,
    MODEL,
    REFERENCE,
    Heading,
    KeyValues,
    Paragraph,
    Piece,
    Plot,
    Report,
    Table,
    new_figure,
)

from .controller import TIP_FILE, ControllerMade
from .device import Track
from .identify import Checked, Diagnosed, Fitted, Subject, uniform_trials
from .motions import CONTROLLERS
from .verify import MPC, PID, TITLES, Tracks, Verified

_COLOURS = {MPC: MEASURED, "inverse": MODEL, PID: COMMAND}
_DASH = {MPC: DASHES[0], "inverse": DASHES[1], PID: DASHES[2]}
SHOWN = ("point_to_point", "fast_scan")
"""References in the figure."""


@dataclass(frozen=True, eq=False)
class Story:
    """All that the report tells.

    Attributes:
        range_words: how the range was found, or where the limits come from.
        model: file that the controller uses.
        used_s: device time, motions that were cut short included [s].
        tracks, verified: None after a commissioning from logs.
    """

    subject: Subject
    range_words: str
    checked: Checked
    fitted: Fitted
    diagnosed: Diagnosed | None
    made: ControllerMade
    model: Path
    used_s: float
    tracks: Tracks | None
    verified: Verified | None


def write_report(story: Story, path: Path) -> Path:
    """Write the page, whole or not at all.

    Raises:
        LogError: if a recording is not there any more.
    """
    return Report(f"Commissioning of {story.subject.name}", tuple(_pieces(story)), story.fitted.report).save(path)


def before_and_after(
    tracks: Tracks, unit: str, motions: tuple[str, ...] = SHOWN, width: float = 9.0, height: float = 5.2
) -> Figure:
    """Angle, error and command of each controller over time, a column a reference.

    Args:
        unit: of the command.
        motions: to show; those of the tracks where none of them is among these.
    """
    names = [name for name in motions if name in tracks] or list(tracks)[:2]
    with new_figure(width, height) as figure:
        grid = figure.subplots(3, len(names), sharex="col", height_ratios=(2, 1.3, 1.3), squeeze=False)
        for column, name in zip(grid.T, names, strict=True):
            _column(column, name, tracks[name])
        for axes, text in zip(grid[:, 0], ("tip angle [deg]", "error [deg]", f"command [{unit}]"), strict=True):
            axes.set_ylabel(text)
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=4)
    return figure


def _column(column: Sequence[Axes], name: str, runs: Mapping[str, Track]) -> None:
    """One reference: angles, errors, commands."""
    angle, error, command = column
    first = runs[MPC]
    angle.plot(first.t, first.reference_deg, color=REFERENCE, lw=2.5, label="reference")
    for controller in reversed(CONTROLLERS):
        run, look = runs[controller], {"color": _COLOURS[controller], "linestyle": _DASH[controller]}
        rms = float(np.sqrt(np.nanmean(run.error_deg**2)))
        angle.plot(run.t, run.measured_deg, lw=1.0, **look, label=TITLES[controller])
        error.plot(run.t, run.error_deg, lw=0.9, **look, label=f"{rms:.2f} deg RMS")
        command.plot(run.t, run.command, lw=0.9, **look)
    angle.set_title(name.replace("_", " "))
    error.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
    command.set_xlabel("time [s]")


def _pieces(story: Story) -> Iterator[Piece]:
    verified, subject = story.verified, story.subject
    if verified is None:
        yield Paragraph(
            "Made from logs alone: nothing was verified. The controller has not moved the device yet; "
            "begin with `hystmpc commission CONFIG --out DIR` at the bench, or with `hystmpc run` and slow references."
        )
    else:
        yield Paragraph(verified.verdict)
        for step in verified.steps:
            yield Paragraph(f"Next: {step}.")
    if story.tracks is not None and verified is not None:
        yield Heading("Before and after")
        yield Plot(
            before_and_after(story.tracks, subject.command_unit),
            "Fresh references with the PID and the inverse alone, and with the controller that was made; the error is "
            "measured less wanted angle, the sensor's noise included.",
            zoom=True,
        )
        yield _scores(verified)
    yield from _device(story)
    yield Heading("Controller")
    limits, motion = subject.limits, story.made.reached.motion
    yield KeyValues(
        {
            "file": TIP_FILE,
            "model": story.model.name + (" (corrected by the diagnosis)" if _corrected(story) else ""),
            f"command [{subject.command_unit}]": f"{limits.lower:g} to {limits.upper:g} at {limits.rate:g} per s",
            "angles for references [deg]": f"{story.made.reached.low_deg:.1f} to {story.made.reached.high_deg:.1f}",
            "motion of targets": f"{motion.velocity_deg_s:g} deg/s, {motion.acceleration_deg_s2:g} deg/s^2",
            "PID, tuned on the model": _gains(story.made.pid, story.made.pid_rmse_deg),
            "inverse with PID, tuned on it": _gains(story.made.inverse_pid, story.made.inverse_pid_rmse_deg),
        }
    )


def _scores(verified: Verified) -> Table:
    motions = next(iter(verified.scores.values())).by_motion
    columns = (
        "controller",
        "RMS",
        *motions,
        "greatest",
        "rest in holds [%]",
        "fallbacks [%]",
        "late [%]",
        "beyond limits",
    )
    rows = [
        (
            TITLES[name],
            score.rms_deg,
            *score.by_motion.values(),
            score.greatest_deg,
            _or_dash(round(100 * score.rest_share, 1)),
            round(100 * score.fallback_share, 1),
            round(100 * score.late_share, 1),
            score.beyond,
        )
        for name, score in verified.scores.items()
    ]
    return Table(
        columns,
        rows,
        f"Measured less wanted angle [deg]. The sensor's noise, {verified.sensor_sigma_deg:.3f} deg, is in all of "
        "them. Rest: share of the settled samples of holds in which the command did not move. Late: samples without "
        "time for the controller, as a deadline was missed.",
    )


def _device(story: Story) -> Iterator[Piece]:
    subject, fitted = story.subject, story.fitted
    yield Heading("What the device is")
    facts: dict[str, object] = {
        "range": story.range_words,
        "recordings": f"{story.checked.trials} trials, {story.checked.seconds:.0f} s",
        "sensor's noise [deg]": fitted.sensor_sigma_deg,
        **({"steps of its readings [deg]": fitted.sensor_step_deg} if fitted.sensor_step_deg else {}),
        "model's free run is off by [deg]": fitted.model_sigma_deg,
    }
    if story.used_s:
        facts["device time"] = f"{story.used_s / 60:.1f} min, motions that were cut short included"
    yield KeyValues(facts)
    if fitted.parts:
        rows = [(part, form, _or_dash(without), _or_dash(rmse)) for part, form, without, rmse in fitted.parts]
        yield Table(("part", "form", "without it", "with it"), rows, "RMSE on trials left out [deg].")
    if fitted.numbers:
        numbers = [(name, *map(_or_dash, values)) for name, *values in fitted.numbers]
        yield Table(("number", "value", "from", "to"), numbers, "Identified numbers, intervals of 90 %.")
    for line in (*fitted.advice, *story.checked.warnings):
        yield Paragraph(line)
    yield Plot(_free_run(subject, story.model), "Free run of the model beside the recording, worst trial.", zoom=True)
    if story.diagnosed is not None:
        yield Heading("What is left")
        for line in filter(None, story.diagnosed.verdict):
            yield Paragraph(line)
        if story.diagnosed.next:
            yield Paragraph(f"To know more: {story.diagnosed.next}.")


def _free_run(subject: Subject, model: Path) -> Figure:
    opened = load_model(model)
    runs = [evaluate(opened, trial, False) for trial in uniform_trials(subject)]
    worst = max(runs, key=lambda run: run.errors.rmse_deg)
    with new_figure(8.0, 2.6) as figure:
        axes = figure.subplots()
        axes.plot(worst.trial.t, worst.trial.angle, color=MEASURED, label="measured")
        axes.plot(worst.trial.t, worst.theta, color=MODEL, lw=0.9, label="model")
        name = Path(worst.trial.source).name
        axes.set(xlabel="time [s]", ylabel="angle [deg]", title=f"{name}: RMSE {worst.errors.rmse_deg:.3g} deg")
        axes.legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
    return figure


def _or_dash(value: float) -> object:
    return value if math.isfinite(value) else "-"


def _corrected(story: Story) -> bool:
    return story.diagnosed is not None and story.diagnosed.corrected


def _gains(gains: Mapping[str, float], rmse_deg: float) -> str:
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in gains.items())
    return f"{numbers}; {rmse_deg:.3f} deg on the model"
