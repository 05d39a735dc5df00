"""Page report.html of a commissioning and of an investigation: the verdict first, then its derivation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.ctrl.config import AnyControllerSettings
from hystmpc.ctrl.feedback import InversePidControllerSettings, PidControllerSettings
from hystmpc.ctrl.linear.report import loops_of
from hystmpc.gap.report.words import in_words, listed, percent
from hystmpc.models.evaluate import evaluate
from hystmpc.models.evaluation_report import free_run_figure
from hystmpc.models.load import load_model
from hystmpc.models.two_axes.evaluate import evaluate_two_axes
from hystmpc.models.two_axes.model import load_two_axes
from hystmpc.models.two_axes.report import joint_pieces
from hystmpc.rig.axes import NAMES, each
from hystmpc.trials.axes import both_axes
from hystmpc.trials.csv_files import read_csv
from hystmpc.trials.read import read_trials
from hystmpc.trials.recording import SEPARATION_COLUMN
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
    Points,
    Report,
    Table,
    new_figure,
)
from hystmpc.trials.run_folder import RunFolder
from hystmpc.trials.types import rms

from .device import Track
from .identify import TIP_FILE, IdentifiedDevice, Subject, uniform_trials
from .motions import CONTROLLERS, AnyReached, ReachedAngles
from .round_plan import PlanePlan, RoundPlan
from .rounds import FIRST, Ending, Investigated, PlaneVerdict, Round, round_folder
from .stages import DIAGNOSIS
from .verify import MPC, PID, TITLES, Tracks, Verification

_COLOURS = {MPC: MEASURED, "inverse": MODEL, PID: COMMAND}
_DASH = {MPC: DASHES[0], "inverse": DASHES[1], PID: DASHES[2]}
SHOWN = ("point_to_point", "fast_scan")
"""References in the figure."""

TO_DO: dict[Ending, str] = {
    "": "",
    "named": "use the corrected simulator; commission again with it where the tracking error matters",
    "no_gap": "use the simulator, retuned; what is left is noise and the simulator's own form",
    "nothing_gained": "read the last diagnosis: what is not told apart stays so with such motions on this device; "
    "change load, orientation or pretension, or look at the device",
    "budget": "run it again with more minutes, in another folder",
}

_ANGLES = (
    ("angle_deg", MEASURED, 2.4, "measured"),
    ("nominal_deg", REFERENCE, 0.9, "simulator as given"),
    ("with_effects_deg", MODEL, 1.0, "corrected"),
)


def write_commission(
    path: Path,
    identified: IdentifiedDevice,
    range_words: str,
    used_s: float,
    tracks: Tracks,
    verified: Verification | None,
) -> Path:
    """Write the page of a commissioning, whole or not at all.

    Args:
        range_words: origin of the range, or of the limits.
        used_s: device time, interrupted motions included [s].
        tracks, verified: none after a commissioning from logs.
    """
    pieces = *_verdict(tracks, verified, identified.subject.command_unit), *_device(identified, range_words, used_s)
    title = f"Commissioning of {identified.subject.name}"
    return Report(title, (*pieces, *_controller(identified)), identified.fitted.report).save(path)


def write_investigation(made: Investigated, name: str, command_unit: str) -> Path:
    """Write the page of an investigation, whole or not at all."""
    subtitle = f"simulator {made.model.name}, {len(made.rounds)} rounds, {made.device_s:.0f} s of device time"
    pieces = tuple(_investigated(made, command_unit))
    return Report(f"Investigation of {name}", pieces, subtitle).save(made.report)


def before_and_after(tracks: Tracks, unit: str) -> Figure:
    """Plot of angle, error and command [unit] of each controller over time, a column for each shown reference."""
    names = [name for name in SHOWN if name in tracks] or list(tracks)[:2]
    axes = tracks[names[0]][MPC].angles_deg.shape[1]
    parts = ("",) if axes == 1 else tuple(f" {name}" for name in NAMES)
    heights = [2.0] * axes + [1.3] * (1 + axes)
    with new_figure(9.0, 5.2 if axes == 1 else 8.2) as figure:
        grid = figure.subplots(len(heights), len(names), sharex="col", height_ratios=heights, squeeze=False)
        for column, name in zip(grid.T, names, strict=True):
            _column(column, name, tracks[name])
        angles, commands = [f"tip angle{p} [deg]" for p in parts], [f"command{p} [{unit}]" for p in parts]
        for row, text in zip(grid[:, 0], (*angles, "error [deg]", *commands), strict=True):
            row.set_ylabel(text)
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=4)
    return figure


def _column(column: Sequence[Axes], name: str, runs: Mapping[str, Track]) -> None:
    """Draw one reference: angles, errors, commands."""
    first = runs[MPC]
    axes = first.angles_deg.shape[1]
    angles, error, commands = column[:axes], column[axes], column[axes + 1 :]
    for row, reference in zip(angles, first.reference_deg.reshape(len(first.t), -1).T, strict=True):
        row.plot(first.t, reference, color=REFERENCE, lw=2.5, label="reference")
    for controller in reversed(CONTROLLERS):
        run, look = runs[controller], {"color": _COLOURS[controller], "linestyle": _DASH[controller]}
        for row, angle in zip(angles, run.angles_deg.T, strict=True):
            row.plot(run.t, angle, lw=1.0, **look, label=TITLES[controller])
        error.plot(run.t, run.error_deg, lw=0.9, **look, label=f"{rms(run.error_deg):.2f} deg RMS")
        for row, command in zip(commands, run.commands.T, strict=True):
            row.plot(run.t, command, lw=0.9, **look)
    angles[0].set_title(name.replace("_", " "))
    error.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
    commands[-1].set_xlabel("time [s]")


def _verdict(tracks: Tracks, verified: Verification | None, unit: str) -> Iterator[Piece]:
    if verified is None:
        yield Paragraph(
            "Made from logs alone: nothing was verified. The controller has not moved the device yet; "
            "begin with `hystmpc commission CONFIG --out DIR` at the bench, or with `hystmpc run` and slow references."
        )
        return
    yield Paragraph(verified.verdict)
    for step in verified.steps:
        yield Paragraph(f"Next: {step}.")
    yield Heading("Before and after")
    yield Plot(
        before_and_after(tracks, unit),
        "Fresh references with the PID and the inverse alone, and with the controller that was made; the error is "
        "measured less wanted angle, the sensor's noise included.",
        zoom=True,
    )
    yield _scores(verified)


def _controller(identified: IdentifiedDevice) -> Iterator[Piece]:
    subject, made = identified.subject, identified.made
    motion = made.reached.motion
    corrected = identified.diagnosed is not None and identified.diagnosed.corrected
    yield Heading("Controller")
    yield KeyValues(
        {
            "file": TIP_FILE,
            "model": identified.model.name + (" (corrected by the diagnosis)" if corrected else ""),
            **_ranges(subject, made.reached),
            "motion of targets": f"{motion.velocity_deg_s:g} deg/s, {motion.acceleration_deg_s2:g} deg/s^2",
            "PID, tuned on the model": _gains(made.pid, made.pid_rmse_deg),
            "inverse with PID, tuned on it": _gains(made.inverse_pid, made.inverse_pid_rmse_deg),
        }
    )
    if isinstance(subject.limits, tuple):  # the analysis of loops is of one axis
        return
    loops: dict[str, AnyControllerSettings] = {
        "PID": PidControllerSettings.parse({"gains": dict(made.pid)}),
        "inverse with PID": InversePidControllerSettings.parse({"gains": dict(made.inverse_pid)}),
    }
    model = load_model(identified.model, "conditioned")
    yield Heading("Loops around the model")
    yield from loops_of(model, identified.model.name, loops, subject.limits).summary()


def _ranges(subject: Subject, reached: AnyReached) -> dict[str, object]:
    """Ranges of commands and angles, by their names."""
    limits, angles = each(subject.limits), (reached,) if isinstance(reached, ReachedAngles) else (reached.x, reached.y)
    parts = ("",) if len(limits) == 1 else tuple(f" {name}" for name in NAMES)
    rows: dict[str, object] = {}
    for part, one, seen in zip(parts, limits, angles, strict=True):
        rows[f"command{part} [{subject.command_unit}]"] = f"{one.lower:g} to {one.upper:g} at {one.rate:g} per s"
        rows[f"angles{part} for references [deg]"] = f"{seen.low_deg:.1f} to {seen.high_deg:.1f}"
    return rows


def _scores(verified: Verification) -> Table:
    motions = next(iter(verified.scores.values())).by_motion
    shares = ("rest in holds [%]", "fallbacks [%]", "late [%]")
    columns = ("controller", "RMS", *motions, "greatest", *shares, "beyond limits")
    rows = [
        (
            TITLES[name],
            score.rms_deg,
            *score.by_motion.values(),
            score.greatest_deg,
            round(100 * score.rest_share, 1),
            round(100 * score.fallback_share, 1),
            round(100 * score.late_share, 1),
            score.beyond,
        )
        for name, score in verified.scores.items()
    ]
    return Table(
        columns,
        rows,
        "Measured less wanted angle [deg], of two axes the distance in their plane. "
        f"The sensor's noise, {verified.sensor_sigma_deg:.3f} deg, is in all of "
        "them. Rest: share of the settled samples of holds in which the command did not move. Late: samples without "
        "time for the controller, as a deadline was missed.",
    )


def _device(identified: IdentifiedDevice, range_words: str, used_s: float) -> Iterator[Piece]:
    fitted, checked, diagnosed = identified.fitted, identified.checked, identified.diagnosed
    yield Heading("What the device is")
    facts: dict[str, object] = {
        "range": range_words,
        "recordings": f"{checked.trials} trials, {checked.seconds:.0f} s",
        "sensor's noise [deg]": fitted.sensor_sigma_deg,
        **({"steps of its readings [deg]": fitted.sensor_step_deg} if fitted.sensor_step_deg else {}),
        "model's free run is off by [deg]": fitted.model_sigma_deg,
    }
    if math.isfinite(fitted.left_out_deg):
        facts["on the motion left out by [deg]"] = fitted.left_out_deg
    if used_s:
        facts["device time"] = f"{used_s / 60:.1f} min, motions that were cut short included"
    yield KeyValues(facts)
    if fitted.parts:
        yield Table(("part", "form", "without it", "with it"), fitted.parts, "RMSE on trials left out [deg].")
    if fitted.numbers:
        yield Table(("number", "value", "from", "to"), fitted.numbers, "Identified numbers, intervals of 90 %.")
    for line in (*fitted.advice, *checked.warnings):
        yield Paragraph(line)
    if identified.subject.axes > 1:
        yield from joint_pieces(load_two_axes(identified.model))
    figure = _free_run(identified.subject, identified.model)
    yield Plot(figure, "Free run of the model beside the recording, worst trial.", True)
    if diagnosed is not None:
        yield Heading("What is left")
        for line in filter(None, diagnosed.verdict):
            yield Paragraph(line)
        if diagnosed.next:
            yield Paragraph(f"To know more: {diagnosed.next}.")


def _free_run(subject: Subject, model: Path) -> Figure:
    trials = uniform_trials(subject)
    if subject.axes > 1:
        both = load_two_axes(model)
        runs = [evaluate_two_axes(both, trial) for trial in trials]
    else:
        opened = load_model(model)
        runs = [evaluate(opened, trial, False) for trial in trials]
    return free_run_figure([max(runs, key=lambda run: run.errors.rmse_deg)])


def _gains(gains: Mapping[str, float], rmse_deg: float) -> str:
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in gains.items())
    return f"{numbers}; {rmse_deg:.3f} deg on the model"


def _investigated(made: Investigated, unit: str) -> Iterator[Piece]:
    last = made.verdict
    if isinstance(last, PlaneVerdict):
        yield Heading("What it says")
        each_axis = (f"Axis {name}: {one.headline}" for name, one in zip(NAMES, last.axes, strict=True))
        yield Points((last.joins.headline, *each_axis))
    else:
        yield Heading(last.headline)
    yield Paragraph(last.reason)
    yield Paragraph(f"Ended: {made.why}.")
    yield Paragraph(f"What to do: {TO_DO[made.ended]}.")
    yield KeyValues(
        {
            "device time": f"{made.device_s:.0f} s of {made.budget_s:.0f} s, motions that were cut short included",
            "corrected simulator": "none" if made.fixed is None else _relative(made.fixed, made.folder),
            "whole diagnosis": _relative(_diagnosis(made, made.rounds[-1]) / "report.html", made.folder),
        }
    )
    yield _overview(made)
    for one in made.rounds:
        yield from _round(made, one, unit)


def _diagnosis(made: Investigated, one: Round) -> Path:
    return round_folder(made.folder, one.number) / "diagnose" / DIAGNOSIS


def _relative(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix()


def _overview(made: Investigated) -> Table:
    rows: list[tuple[object, ...]] = []
    for one in made.rounds:
        judged, recorded = one.judged, one.recorded
        if isinstance(judged, PlaneVerdict):
            said = judged.joins.headline, *(axis.headline for axis in judged.axes)
            sizes = judged.retuned_deg, judged.left_deg
            rows.append((one.number, f"{recorded.device_s:.0f}", len(recorded.names), *said, *sizes))
            continue
        odds = percent(judged.probability) if math.isfinite(judged.probability) else "-"
        facts = one.number, f"{recorded.device_s:.0f}", len(recorded.names), judged.headline
        rows.append((*facts, odds, judged.retuned_deg, judged.left_deg))
    said_in: tuple[str, ...] = ("verdict", "probability")
    if isinstance(made.verdict, PlaneVerdict):
        said_in = ("between the axes", "x", "y")
    columns = ("round", "device time [s]", "motions", *said_in, "retuned [deg]", "with effects [deg]")
    return Table(columns, rows, "Verdict after each round, on all trials so far; RMSE on trials kept for the end.")


def _round(made: Investigated, one: Round, unit: str) -> Iterator[Piece]:
    yield Heading(f"Round {one.number}: {one.judged.headline}")
    if isinstance(one.plan, PlanePlan):
        for name, plan in zip(NAMES, (one.plan.x, one.plan.y), strict=True):
            yield Paragraph(f"Axis {name}: {'no further motion' if plan is None else why_these(plan)}")
        yield Paragraph(f"Both axes: {listed([in_words(motion) for motion in one.plan.both], 'and') or 'no motion'}.")
        yield Plot(_plane_figure(made, one, unit), "Above: both commands. Below: both angles, and the simulator.", True)
        return
    yield Paragraph(why_these(one.plan))
    yield Paragraph(f"Verdict on {one.judged.trials} trials: {one.judged.reason}.")
    yield Plot(
        _figure(made, one, unit),
        "Above: command. Middle: measured angle, the simulator as given, and the corrected one after this round. "
        "Below: what was expected to stay apart between the explanations when each is retuned.",
        zoom=True,
    )


def _plane_figure(made: Investigated, one: Round, unit: str) -> Figure:
    """Figure of both commands and both angles of each motion of a round, a column each, with the simulator's run."""
    names, model = one.recorded.names, load_two_axes(made.model)
    folder = round_folder(made.folder, one.number) / "record" / "trials"
    recorded = read_trials([folder / f"{name}.csv" for name in names], rate_hz=1 / model.dt_s)
    trials = both_axes(recorded) or []
    with new_figure(9.0, 4.6) as figure:
        grid = figure.subplots(2, len(trials), sharex="col", sharey="row", squeeze=False)
        for (command, angle), trial in zip(grid.T, trials, strict=True):
            t, run = trial.t - trial.t[0], evaluate_two_axes(model, trial)
            for k, (name, colour) in enumerate(zip(NAMES, (MEASURED, COMMAND), strict=True)):
                command.plot(t, trial.commands[:, k], color=colour, lw=1.0, label=name)
                angle.plot(t, trial.angles[:, k], color=colour, lw=1.6)
                angle.plot(t, run.theta[:, k], color=REFERENCE, lw=0.8)
            command.set_title(Path(trial.source).stem.replace("_", " "), fontsize=7.0)
            angle.set_xlabel("time [s]")
        for axes, text in zip(grid[:, 0], (f"command [{unit}]", "angle [deg]"), strict=True):
            axes.set_ylabel(text)
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


def why_these(plan: RoundPlan) -> str:
    """Reason for the motions of a round, in words."""
    names = listed([in_words(name) for name in plan.separates], "and")
    odds = f"{percent(plan.probability)} expected for the right name, {percent(1 / len(plan.separates))} by chance"
    if len(plan.motions) > 1:
        return (
            f"Before any angle was seen, {len(plan.motions)} motions were chosen from the commands and the simulator "
            f"alone, to tell apart {names}: {odds}. The last one repeats the first."
        )
    if plan.undirected:
        return (
            "The last motion did not change the verdict, or none could be designed. This one is of a kind that was not "
            f"recorded yet. It was chosen as the first ones were, to tell apart {names}: {odds}."
        )
    aim = "to put the verdict to the test against" if plan.confirms else "to tell apart"
    text = f"The motion was designed {aim} {names}: {odds}. {plan.looked_at} motions were compared."
    if plan.menu and math.isfinite(plan.menu_gain):
        text += (
            f" It is expected to tell {plan.menu_gain:.1f} times as much per second as the best motion of the menu, "
            f"{in_words(plan.menu)}."
        )
    return text


def _figure(made: Investigated, one: Round, unit: str) -> Figure:
    """Figure of command, angles and expected separation of each motion of a round, a column each."""
    log = RunFolder.open(_diagnosis(made, one)).log()
    motions = made.folder / FIRST if one.number == 1 else _diagnosis(made, made.rounds[one.number - 2]).parent
    names = one.recorded.names
    with new_figure(9.0, 4.6) as figure:
        grid = figure.subplots(3, len(names), sharex="col", sharey="row", height_ratios=(1, 1.6, 0.8), squeeze=False)
        for (command, angle, separation), name in zip(grid.T, names, strict=True):
            rows = np.asarray(log["trial"]) == f"{name}.csv"
            t = np.asarray(log["time_s"], dtype=np.float64)[rows]
            sent = log.get("command", log.get("command_bar"))
            command.plot(t - t[0], np.asarray(sent)[rows], color=COMMAND)
            for column, colour, width, label in _ANGLES:
                angle.plot(t - t[0], np.asarray(log[column])[rows], color=colour, lw=width, label=label)
            planned = read_csv(motions / f"{name}.csv")
            separation.plot(planned.t, planned.channels[SEPARATION_COLUMN], color=REFERENCE)
            command.set_title(name.replace("_", " "))
            separation.set_xlabel("time [s]")
        for axes, text in zip(grid[:, 0], (f"command [{unit}]", "tip angle [deg]", "apart [deg]"), strict=True):
            axes.set_ylabel(text)
        figure.legend(*grid[1, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return figure
