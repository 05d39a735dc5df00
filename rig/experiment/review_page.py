"""The review of a run folder and its report.html: a recording's page, the advice, predicted against measured angle."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import LogError, TrajectoryError
from hystmpc.trials.figure_data import draw_long
from hystmpc.trials.from_outside import only_reads
from hystmpc.trials.report import Heading, KeyValues, Paragraph, Piece, Plot, Report, Table, style
from hystmpc.trials.run_folder import RunFolder
from hystmpc.trials.trial import Trial, Units

from ..config import RunSettings
from ..recording.report import Log, causes, numbers, timing_table, tracked
from .review import TRIAL_FILE, Review, ReviewedRun, compare_with_model, review


@only_reads()
def review_run(folder: Path, more: Sequence[Piece] = ()) -> Review:
    """Judge a run folder, write `trial.csv` (for `fit` and `diagnose`) and `report.html`.

    A run that is too short to be judged gets a report all the same.

    Args:
        more: shown behind the advice.

    Raises:
        LogError: if the folder holds no readable run.
        ConfigError: if its settings are not those of a run.
    """
    run = RunFolder.open(folder)
    settings = RunSettings.parse(run.config(), str(folder / "config.yaml"))
    found = None
    try:
        found = compare_with_model(run, settings)
        verdict = review(found, settings.review.due_above_deg)
        usable = np.isfinite(found.measured_deg)
        trial = Trial(
            found.t[usable], found.command[usable], found.measured_deg[usable], units=Units(settings.command_unit)
        )
        write_csv(trial, folder / TRIAL_FILE)
    except (LogError, TrajectoryError) as error:
        verdict = Review(f"not judged: {error}", *(math.nan,) * 6)
    write_page(run, settings, found, verdict, more)
    return verdict


def write_page(
    run: RunFolder, settings: RunSettings, found: ReviewedRun | None, verdict: Review, more: Sequence[Piece] = ()
) -> Path:
    """Write the page.

    Args:
        found: samples; None where there are too few.
        more: shown behind the advice.

    Raises:
        LogError: if the log cannot be read.
    """
    timing = _timing(run.path / "timing.json")
    outcome = timing.get("outcome", {})
    pieces: list[Piece] = []
    if not timing:
        pieces.append(
            Paragraph("The program was killed before it could say how the run ended: there is no timing.json.")
        )
    elif outcome.get("cause"):
        pieces.append(Heading(f"Stopped: {outcome['cause']}"))
        pieces.append(Paragraph("The stop is latched. Look at the device, then run again with `--reset`."))
    pieces += [Paragraph(line[0].upper() + line[1:] + ".") for line in verdict.lines]
    log = run.log()
    pieces += [*more, Heading("Run"), KeyValues(_figures(settings, verdict, log, timing))]
    if found is not None:
        pieces += [
            Heading("Tracking"),
            Plot(
                tracked(found.t, found.reference_deg, found.measured_deg, found.command, settings.command_unit),
                "Reference, measured angle and command over time.",
                zoom=True,
            ),
            Heading("Predicted and measured angle"),
            Plot(_prediction(found), "Measured less predicted angle: one sample ahead, and in a free run.", True),
        ]
    pieces += [*_timing_pieces(timing, settings.dt_s), Heading("Stages of a sample"), timing_table(log), *causes(log)]
    run_page = Report("Run at the bench", tuple(pieces), f"{settings.name}, {run.meta.get('start', '')}")
    return run.write_report(run_page)


def _timing(file: Path) -> dict[str, Any]:
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _figures(settings: RunSettings, verdict: Review, log: Log, timing: Mapping[str, Any]) -> dict[str, object]:
    wire, outcome = timing.get("wire", {}), timing.get("outcome", {})
    angles = numbers(log, "angle_deg")
    sent = outcome.get("samples", 0) - timing.get("skipped", 0)
    judged = {
        "RMS tracking error [deg]": verdict.tracking_deg,
        "greatest tracking error [deg]": verdict.greatest_deg,
        "RMS prediction error, one sample ahead [deg]": verdict.one_step_deg,
        "RMS prediction error, free run [deg]": verdict.free_run_deg,
        "... behind the best line [deg]": verdict.corrected_deg,
        "gain of that line": verdict.gain,
        "offset of that line [deg]": verdict.offset_deg,
    }
    return {
        "device": settings.name,
        "transport": settings.transport.kind,
        "model": settings.controller.model,
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


def _prediction(found: ReviewedRun) -> Figure:
    with style():
        figure = Figure(figsize=(8, 3), layout="constrained")
        axes = figure.subplots()
        draw_long(axes, found.t, found.measured_deg - found.free_deg, label="free run", color="C1")
        draw_long(axes, found.t, found.measured_deg - found.predicted_deg, label="one sample ahead", color="C0")
        axes.axhline(0.0, color="0.6", linewidth=0.8)
        axes.set_xlabel("time [s]")
        axes.set_ylabel("measured less predicted [deg]")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2)
    return figure


def _timing_pieces(timing: Mapping[str, Any], dt_s: float) -> Iterator[Piece]:
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
