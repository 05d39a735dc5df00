"""Page report.html of a recording: commands and angles, timing of the loop, faults."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hystmpc.trials.figures import TrackedLine, TrackedMotion, tracking_figure
from hystmpc.trials.layouts import CANONICAL
from hystmpc.trials.report import MEASURED, Heading, KeyValues, Paragraph, Piece, Plot, Report, Table, style
from hystmpc.trials.run_folder import Column, RunFolder
from hystmpc.trials.types import Vec, rms

from ..axes import NAMES, columns

Log = Mapping[str, Column]


def write_report(run: RunFolder, dropped: int = 0, problem: str = "") -> Path:
    """Write report.html from the folder's log.csv.

    `problem` is the cause of an early end of recording, empty without one.

    Raises:
        LogError: if the log cannot be read.
    """
    log = run.log()
    pieces: list[Piece] = [Paragraph(f"Recording ended early: {problem}")] if problem else []
    pieces += [Heading("Run"), KeyValues(_figures(log, dropped)), Heading("Angle and command")]
    for axis in _axes(log):
        shown = {name.replace(f"_{axis}", "", 1): name for name in log} if axis else {name: name for name in log}
        command = CANONICAL.command_column(list(shown))
        names = ("time_s", *(shown[name] for name in ("reference_deg", "angle_deg", command)))
        t, reference, angle, sent = (numbers(log, name) for name in names)
        figure = tracked(t, reference, angle, sent, CANONICAL.command[command])
        pieces.append(Plot(figure, f"Axis {axis} over time." if axis else "Over time.", True))
    pieces += [Heading("Timing"), timing_table(log, ("period_s", "lateness_s"))]
    pieces += [Plot(_histograms(log), "Time between samples, and lateness behind the deadline."), *causes(log)]
    return run.write_report(Report("Recording at the bench", tuple(pieces), str(run.path.name)))


def tracked(t: Vec, reference: Vec, angle: Vec, command: Vec, unit: str) -> Figure:
    """Plot of reference and measured angle [deg] above, command [unit] below, over time [s]; (N,) each."""
    line = TrackedLine(t, angle, command, {"color": MEASURED, "label": "measured"})
    return tracking_figure([TrackedMotion(t, reference, [line])], f"command [{unit}]")


def timing_table(log: Log, more: tuple[str, ...] = ()) -> Table:
    """Table of median, 99th percentile and maximum of every stage of a sample, and of other columns [ms]."""
    rows: list[tuple[object, ...]] = []
    for name in (*more, *(name for name in log if name.startswith("stage_"))):
        values = 1e3 * numbers(log, name)
        values = values[np.isfinite(values)]
        if values.size:
            figures = (*np.quantile(values, (0.5, 0.99)), values.max())
            rows.append((name.removeprefix("stage_").removesuffix("_s").replace("_", " "), *map(float, figures)))
    return Table(("", "median", "p99", "greatest"), rows, "Milliseconds, from the log.")


def causes(log: Log) -> Iterator[Piece]:
    """Table of the number of samples by source of the command and by fault."""
    sources = Counter(str(cell) for cell in log["source"])
    faults = Counter(word for cell in log.get("faults", ()) for word in str(cell).split() if word != "-")
    rows: list[tuple[object, ...]] = [("source", name, n) for name, n in sources.most_common()]
    rows += [("fault", name, n) for name, n in faults.most_common()]
    yield Heading("Sources and faults")
    yield Table(("kind", "name", "samples"), rows, "Samples by what gave the command, and by what went wrong.")


def numbers(log: Log, name: str) -> Vec:
    """Numbers of a column (N,)."""
    return np.asarray(log[name], dtype=np.float64)


def _axes(log: Log) -> tuple[str, ...]:
    """Names of the axes of a log; one empty name for a single axis."""
    return NAMES if columns(CANONICAL.angle, 0.0, len(NAMES)).keys() <= log.keys() else ("",)


def _figures(log: Log, dropped: int) -> dict[str, object]:
    t, parts = numbers(log, "time_s"), [f"_{axis}" if axis else "" for axis in _axes(log)]
    angles = [numbers(log, f"angle{part}_deg") for part in parts]
    angle = angles[0] if len(angles) == 1 else np.hypot(*angles)
    # wanted for the end of a sample, measured at the next one; of two axes the distance in their plane
    errors = [numbers(log, f"reference{p}_deg")[:-1] - one[1:] for p, one in zip(parts, angles, strict=True)]
    error = errors[0] if len(errors) == 1 else np.hypot(*errors)
    known = error[np.isfinite(error)]
    figures: dict[str, object] = {"samples": t.size, "duration [s]": float(t[-1] - t[0])}
    if known.size:
        figures["RMS tracking error [deg]"] = rms(known)
        figures["greatest error [deg]"] = float(np.abs(known).max())
    return figures | {
        "samples without an angle": int(np.count_nonzero(~np.isfinite(angle))),
        "deadlines missed": int(np.nansum(numbers(log, "missed"))),
        "samples not in the log": dropped,
    }


def _histograms(log: Log) -> Figure:
    with style():
        figure = Figure(figsize=(8, 2.5), layout="constrained")
        for axes, name in zip(figure.subplots(1, 2), ("period_s", "lateness_s"), strict=True):
            values = 1e3 * numbers(log, name)
            axes.hist(values[np.isfinite(values)], bins=60, log=True)
            axes.set_xlabel(f"{name.removesuffix('_s')} [ms]")
            axes.set_ylabel("samples")
    return figure
