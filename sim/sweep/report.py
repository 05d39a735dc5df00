"""Report of a sweep: tables by factor, box plots by controller, the worst runs with their ids."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from hystmpc.trials.report import REFERENCE, Heading, KeyValues, Paragraph, Piece, Plot, Report, Table, new_figure
from hystmpc.trials.types import Vec

from ..results import colours
from .plan import AXIS_COLUMNS
from .table import Column, table_of

_FEW = ((100.0, (1,)), (8.0, (1, 2, 5)))  # from this ratio of the ends on only these leading digits are shown
_FIGURES = (
    "rmse_deg",
    *AXIS_COLUMNS,
    "max_abs_deg",
    "hold_error_deg",
    "command_travel",
    "limit_violations",
    "step_mean_s",
    "cpu_s",
)
_NAMES = ("id", "status", "message", "controller", "motion", "seed", *_FIGURES)
_WORST = 20
_LEVELS = 8  # a factor with more numbers is shown by its quarters
_SHORT = 28


def plain_log(axis: Axis) -> None:
    """Label a logarithmic axis with 0.4, 1, 2 in place of powers of ten; fewer labels over more decades."""

    def text(value: float, _: object) -> str:
        low, high = sorted(axis.get_view_interval())
        digits = next((shown for ratio, shown in _FEW if high > ratio * low), range(1, 10))
        leading = round(value / 10.0 ** math.floor(math.log10(value) + 1e-9)) if value > 0 else 0
        return f"{value:g}" if leading in digits else ""

    axis.set_major_formatter(FuncFormatter(text))
    axis.set_minor_formatter(FuncFormatter(text))


@dataclass(frozen=True, eq=False)
class SweepView:
    """Rows of one plan: columns (N,) of the table, and types of the factors."""

    table: Mapping[str, Column]
    factors: Mapping[str, str]

    @classmethod
    def of(cls, folder: Path, factors: Mapping[str, str], ids: set[str]) -> SweepView:
        """Read the columns of the rows with these ids."""
        table = table_of(folder, dict.fromkeys([*_NAMES, *factors]))
        return cls(table, factors).rows(np.array([str(identity) in ids for identity in table["id"]], dtype=bool))

    def rows(self, chosen: NDArray[np.bool_]) -> SweepView:
        """Return the rows selected by a mask (N,)."""
        k, columns = np.flatnonzero(chosen), self.table.items()
        part = {name: c[k] if isinstance(c, np.ndarray) else [c[j] for j in k] for name, c in columns}
        return SweepView(part, self.factors)

    def done(self) -> SweepView:
        """Rows whose run succeeded."""
        return self.rows(np.array(self.table["status"]) == "done")

    def failed(self) -> list[tuple[str, str]]:
        """Id and error of every failed row."""
        columns = (self.table[name] for name in ("id", "status", "message"))
        return [(str(i), str(message)) for i, status, message in zip(*columns, strict=True) if status != "done"]

    def where(self, name: str, value: str) -> SweepView:
        """Return the rows with this text in a column."""
        return self.rows(np.array(self.texts(name)) == value)

    def names(self, name: str) -> tuple[str, ...]:
        """Distinct texts of a column, in order."""
        return tuple(dict.fromkeys(self.texts(name)))

    def texts(self, name: str) -> list[str]:
        """Return a column as texts, numbers to six digits, missing values as empty texts."""
        values = self.table[name]
        return ["" if v is None else v if isinstance(v, str) else f"{float(v):.6g}" for v in values]

    @property
    def axes(self) -> tuple[str, ...]:
        """Columns of the errors of x and y, of two axes; empty of one."""
        return AXIS_COLUMNS if np.isfinite(self.figures(AXIS_COLUMNS[0])).any() else ()

    def figures(self, name: str) -> Vec:
        """Return a column of numbers (N,)."""
        return np.asarray(self.table[name], dtype=np.float64)


def sweep_report(view: SweepView, meta: Mapping[str, Any]) -> Report:
    """Make the report of a sweep."""
    done, failed = view.done(), view.failed()
    pieces: list[Piece] = [Heading("Runs"), KeyValues(_facts(view, done, meta))]
    if failed:
        pieces.append(Table(("row", "error"), failed[:_WORST], f"Runs that could not be made, {len(failed)} in all."))
    if len(done.table["id"]):
        pieces += [*_overall(done), *_by_factor(done), *_worst(done)]
    return Report("Closed-loop sweep", tuple(pieces), f"{len(view.table['id'])} runs, simulated")


def _facts(view: SweepView, done: SweepView, meta: Mapping[str, Any]) -> dict[str, object]:
    busy, beyond = view.figures("cpu_s"), done.figures("limit_violations")
    return {
        "runs": len(busy),
        "failed": len(view.failed()),
        "varied": ", ".join(view.factors) or "nothing but controller, motion and seed",
        "commands beyond a limit": int(np.sum(beyond)),
        "runs with one": int(np.sum(beyond > 0)),
        "processor time": f"{np.sum(busy) / 60:.1f} min, {np.mean(busy):.2f} s a run",
        "hystmpc": meta["versions"].get("hystmpc"),
        "started": meta["start"],
    }


def _overall(done: SweepView) -> Iterator[Piece]:
    axes = done.axes
    medians = ("median", *(f"{name}, median" for name in "xy"[: len(axes)]))
    columns = ("motion", "controller", "runs", *medians, "mean", "90 %", "worst", "hold, median", "travel, median")
    rows = []
    for motion in done.names("motion"):
        for controller in done.names("controller"):
            part = done.where("motion", motion).where("controller", controller)
            if (e := part.figures("rmse_deg")).size:
                each = (_median(part.figures(name)) for name in axes)
                errors = _median(e), *each, float(np.mean(e)), float(np.quantile(e, 0.9)), float(np.max(e))
                held, travel = _median(part.figures("hold_error_deg")), _median(part.figures("command_travel"))
                rows.append((motion, controller, len(part.table["id"]), *errors, held, travel))
    yield Heading("Controllers")
    caption = "RMSE of the tip angle without sensor noise [deg]; error in holds [deg]; command travel [command unit]."
    if axes:
        caption = f"Errors are distances of both angles from the reference; x and y: of one angle. {caption}"
    yield Table(columns, rows, caption)
    yield _boxes(done)


def _boxes(done: SweepView) -> Plot:
    motions, controllers = done.names("motion"), done.names("controller")
    colour = colours(controllers)
    with new_figure(7.0, 0.8 + len(motions) * (0.5 + 0.28 * len(controllers))) as figure:
        rows = figure.subplots(len(motions), 1, sharex=True, squeeze=False)[:, 0]
        for axes, motion in zip(rows, motions, strict=True):
            part = done.where("motion", motion)
            sets = {name: part.where("controller", name).figures("rmse_deg") for name in controllers}
            _box(axes, {name: values for name, values in sets.items() if values.size}, colour)
            axes.set_title(motion)
        rows[-1].set_xlabel("RMSE of the tip angle [deg]")
    caption = (
        "Tracking error over all runs, logarithmic: box from the first to the third quarter with the median, lines to "
        "the 5th and 95th percentile, points beyond them."
    )
    return Plot(figure, caption)


def _box(axes: Axes, sets: Mapping[str, Vec], colour: Mapping[str, str]) -> None:
    boxes = axes.boxplot(
        list(sets.values()),
        orientation="horizontal",
        widths=0.6,
        whis=(5, 95),
        patch_artist=True,
        tick_labels=list(sets),
        medianprops={"color": REFERENCE},
        flierprops={"marker": ".", "markersize": 3, "alpha": 0.5},
    )
    for patch, name in zip(boxes["boxes"], sets, strict=True):
        patch.set(facecolor=colour[name], alpha=0.7)
    axes.set_xscale("log")
    plain_log(axes.xaxis)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")


def _by_factor(done: SweepView) -> Iterator[Piece]:
    if not done.factors:
        return
    yield Heading("By factor")
    yield Paragraph(
        "Median and, after the stroke, 90th percentile of the RMSE [deg] over all motions and other factors."
    )
    controllers = done.names("controller")
    for path, kind in done.factors.items():
        rows = []
        for level, rows_of in _levels(done, path, kind):
            part = done.rows(rows_of)
            errors = [part.where("controller", name).figures("rmse_deg") for name in controllers]
            rows.append((level, len(part.table["id"]), *(_pair(e) for e in errors)))
        yield Table((path, "runs", *controllers), rows)


def _levels(done: SweepView, path: str, kind: str) -> Iterable[tuple[str, NDArray[np.bool_]]]:
    """Name and rows of every level of a factor, or of its quarters."""
    if kind == "number" and len(np.unique(values := done.figures(path))) > _LEVELS:
        edges = np.quantile(values, [0.0, 0.25, 0.5, 0.75, 1.0])
        for k in range(4):
            last = values <= edges[k + 1] if k == 3 else values < edges[k + 1]
            yield f"{edges[k]:.3g} to {edges[k + 1]:.3g}", (values >= edges[k]) & last
        return
    if kind == "number":
        for value in np.unique(done.figures(path)):
            yield f"{value:.4g}", done.figures(path) == value
        return
    levels = np.array(done.texts(path))
    for level in done.names(path):
        yield _short(level), levels == level


def _worst(done: SweepView) -> Iterator[Piece]:
    order = np.argsort(-done.figures("rmse_deg"), kind="stable")[:_WORST]
    errors = ["rmse_deg", *done.axes, "max_abs_deg"]
    shown = ["id", "controller", "motion", "seed", *done.factors, *errors, "limit_violations"]
    columns = {name: done.table[name] for name in shown}
    rows = [[_cell(columns[name][k]) for name in shown] for k in order]
    yield Heading("Worst runs")
    yield Table(shown, rows, "`hystmpc simulate --row DIR ID` makes one of them again; with --out it leaves its log.")


def _median(values: Vec) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else math.nan


def _pair(values: Vec) -> str:
    return f"{np.median(values):.3g} / {np.quantile(values, 0.9):.3g}" if values.size else "-"


def _cell(value: Any) -> object:
    return _short(value or "") if value is None or isinstance(value, str) else float(value)


def _short(text: str) -> str:
    return text if len(text) <= _SHORT else f"{text[: _SHORT - 3]}..."
