"""report.html of a run at the bench: what was tracked, how punctual the loop was, what went wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from hystmpc.trials.html import Heading, KeyValues, Paragraph, Piece, Plot, Report, Table
from hystmpc.trials.plot_style import style
from hystmpc.trials.presets import CANONICAL
from hystmpc.trials.run_folder import Column, RunFolder

Vec = NDArray[np.float64]
_MOST_POINTS = 4000  # of a curve; more are not seen and make the page heavy


def write_report(run: RunFolder, dropped: int = 0, problem: str = "") -> Path:
    """Write report.html from the folder's log.csv.

    Args:
        run: a folder with a log.
        dropped: samples that are missing in the log.
        problem: why recording ended early; empty if it did not.

    Raises:
        LogError: if the log cannot be read.
    """
    log = run.log()
    command = CANONICAL.command_column(list(log))
    pieces: list[Piece] = [Paragraph(f"Recording ended early: {problem}")] if problem else []
    pieces += [Heading("Run"), KeyValues(_figures(log, dropped)), Heading("Tracking")]
    pieces.append(Plot(_tracking(log, command), "Reference, angle and command over time."))
    pieces += [Heading("Timing"), Table(("", "median", "p99", "greatest"), _timing(log), "Milliseconds.")]
    pieces.append(Plot(_histograms(log), "Time between samples, and lateness behind the deadline."))
    rows = [*_counted("faults", _words(log["faults"])), *_counted("source", _texts(log["source"]))]
    pieces += [Heading("Sources and faults"), Table(("kind", "name", "samples"), rows)]
    return run.write_report(Report("Run at the bench", tuple(pieces), str(run.path.name)).html())


def _figures(log: Mapping[str, Column], dropped: int) -> dict[str, object]:
    t, error = _numbers(log, "time_s"), _numbers(log, "reference_deg") - _numbers(log, "angle_deg")
    known = error[np.isfinite(error)]
    found: dict[str, object] = {
        "samples": t.size,
        "duration [s]": float(t[-1] - t[0]),
        "RMS tracking error [deg]": float(np.sqrt(np.mean(known**2))) if known.size else "no angle",
        "greatest error [deg]": float(np.abs(known).max()) if known.size else "no angle",
        "samples without an angle": int(np.count_nonzero(~np.isfinite(_numbers(log, "angle_deg")))),
        "deadlines missed": int(np.nansum(_numbers(log, "missed"))),
        "samples not in the log": dropped,
    }
    return found


def _tracking(log: Mapping[str, Column], command: str) -> Figure:
    t = _numbers(log, "time_s")
    part = slice(None, None, max(t.size // _MOST_POINTS, 1))
    with style():
        figure = Figure(figsize=(8, 4.5), layout="constrained")
        top, bottom = figure.subplots(2, sharex=True, height_ratios=(2, 1))
        top.plot(t[part], _numbers(log, "reference_deg")[part], label="reference", color="0.4", linestyle="--")
        top.plot(t[part], _numbers(log, "angle_deg")[part], label="angle")
        top.set_ylabel("angle [deg]")
        top.legend(loc="upper right")
        bottom.plot(t[part], _numbers(log, command)[part], color="C1")
        bottom.set_ylabel(f"command [{CANONICAL.command[command]}]")
        bottom.set_xlabel("time [s]")
    return figure


def _histograms(log: Mapping[str, Column]) -> Figure:
    with style():
        figure = Figure(figsize=(8, 2.5), layout="constrained")
        for axes, name in zip(figure.subplots(1, 2), ("period_s", "lateness_s"), strict=True):
            values = 1e3 * _numbers(log, name)
            axes.hist(values[np.isfinite(values)], bins=60, log=True)
            axes.set_xlabel(f"{name.removesuffix('_s')} [ms]")
            axes.set_ylabel("samples")
    return figure


def _timing(log: Mapping[str, Column]) -> list[tuple[object, ...]]:
    stages = [name for name in log if name.startswith("stage_")]
    rows: list[tuple[object, ...]] = []
    for name in ("period_s", "lateness_s", *stages):
        values = 1e3 * _numbers(log, name)
        values = values[np.isfinite(values)]
        if values.size:
            figures = (*np.quantile(values, (0.5, 0.99)), values.max())
            rows.append((name.removeprefix("stage_").removesuffix("_s").replace("_", " "), *map(float, figures)))
    return rows


def _counted(kind: str, words: list[str]) -> list[tuple[object, ...]]:
    return [(kind, word, count) for word, count in Counter(words).most_common()]


def _words(column: Column) -> list[str]:
    return [word for cell in _texts(column) for word in cell.split() if word != "-"]


def _texts(column: Column) -> list[str]:
    return [str(cell) for cell in column]


def _numbers(log: Mapping[str, Column], name: str) -> Vec:
    return np.asarray(log[name], dtype=np.float64)
