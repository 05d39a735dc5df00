"""Laws of every figure: numbers on each axis, legends that name every line, words and lines that are told apart."""

from __future__ import annotations

import itertools
import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from shutil import which
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator

from hystmpc.bench.device import Track
from hystmpc.bench.motions import CONTROLLERS
from hystmpc.bench.report import before_and_after
from hystmpc.ctrl.command import CommandLimits
from hystmpc.gap.report.figures import closed_loop_figure
from hystmpc.gap.report.page import diagnosis_report
from hystmpc.gap.report.report_data import TrackingCurve
from hystmpc.models.evaluate import evaluate
from hystmpc.models.evaluation_report import evaluation_report
from hystmpc.models.load import load_model
from hystmpc.sim.results import controllers_figure, looks
from hystmpc.trials.report import PALETTE, Folded, Piece, Plot, figure_svg, new_figure, style, three_ticks
from hystmpc.trials.trial import Trial

from ..gap.report_examples import report_data

T = 0.04 * np.arange(500)
SINE = 50.0 + 20.0 * np.sin(0.8 * T)


def trials() -> list[Trial]:
    model = load_model("builtin:backlash")
    command = 3.0 + 2.5 * np.sin(0.8 * T)
    angle = np.asarray(model.run(command, 30.0))  # type: ignore[attr-defined]  # a chain
    return [
        Trial(T, command, angle + k * 0.1 * np.sin(7.0 * T), source=f"/logs/trial_of_a_day_{k}.csv") for k in range(3)
    ]


class _Run:
    """What the figures of a study read of a run."""

    def __init__(self, k: int) -> None:
        log = {"time_s": T, "reference_deg": SINE, "command": 3.0 + 0.02 * k + 2.0 * np.sin(0.8 * T)}
        self.log = type("Log", (), log)()
        self.true_deg, self.first, self.dt = SINE + 0.05 * k, 20, 0.04


class _Result:
    def __init__(self, k: int, name: str) -> None:
        self.controller, self.run, self.limits = name, _Run(k), CommandLimits(0.0, 6.0, 10.0)


def _track(k: int) -> Track:
    measured = SINE + 0.03 * (k + 1) * np.sin(3.0 * T)
    return Track(T, SINE, measured, 3.0 + 0.01 * k + 2.0 * np.sin(0.8 * T), ("mpc",) * T.size)


def study() -> Figure:
    names = ["inverse", "pid", "inverse_pid", "linearised_mpc", "sampling_mpc"]
    results: Any = [_Result(k, name) for k, name in enumerate(names)]
    return controllers_figure(results, looks(names), "mm")


def commissioned() -> Figure:
    runs: Any = {name: {c: _track(k) for k, c in enumerate(CONTROLLERS)} for name in ("point_to_point", "fast_scan")}
    return before_and_after(runs, "mm")


def gap_tracking() -> Figure:
    return closed_loop_figure([TrackingCurve("slow_scan", T, SINE, SINE + 0.5, SINE + 0.1, 10)] * 2)


def evaluated(number: int) -> Figure:
    """A figure of the page of an evaluation."""
    runs = [evaluate(load_model("builtin:backlash"), trial) for trial in trials()]
    plots = [piece for piece in evaluation_report("", "", [("", runs)]).pieces if isinstance(piece, Plot)]
    return plots[number].figure


FIGURES: Mapping[str, Any] = MappingProxyType({
    "trial": lambda: trials()[0].plot(),
    "evaluation over time": lambda: evaluated(0),
    "evaluation loops": lambda: evaluated(1),
    "study": study,
    "commissioning": commissioned,
    "tracking gap": gap_tracking,
})  # fmt: skip


@pytest.fixture(scope="module")
def drawn() -> dict[str, Figure]:
    """Every figure, as a page has it."""
    found = {name: make() for name, make in FIGURES.items()}
    for k, piece in enumerate(pieces_of(diagnosis_report(report_data("named")).pieces)):
        if isinstance(piece, Plot):
            found[f"diagnosis, {k}: {piece.caption[:30]}"] = piece.figure
    for figure in found.values():
        figure_svg(figure)
    return found


def pieces_of(pieces: Sequence[Piece]) -> Iterator[Piece]:
    for piece in pieces:
        yield from pieces_of(piece.pieces) if isinstance(piece, Folded) else (piece,)


def numbered(axes: Axes) -> Iterator[tuple[str, list[str]]]:
    """Axes that have numbers, and these."""
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        ticks = [tick for tick in axis.get_major_ticks() if low - 1e-9 <= tick.get_loc() <= high + 1e-9]
        written = any(tick.label1.get_visible() and tick.label1.get_text() for tick in ticks)
        if not isinstance(axis.get_major_locator(), FixedLocator) and written:
            yield axis.axis_name, [tick.label1.get_text() for tick in ticks if tick.label1.get_visible()]


def looks_of(line: Line2D) -> tuple[str, str]:
    return to_hex(line.get_color()), str(line._dash_pattern)  # type: ignore[attr-defined]  # what is drawn


def named(figure: Figure) -> set[str]:
    """Colours that legends name."""
    legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes if axes.get_legend())]
    lines = {to_hex(handle.get_color()) for legend in legends for handle in legend.get_lines()}
    return lines | {to_hex(handle.get_facecolor()) for legend in legends for handle in legend.get_patches()}


@pytest.mark.slow
def test_every_axis_has_three_numbers(drawn: dict[str, Figure]) -> None:
    for name, figure in drawn.items():
        for axes in figure.axes:
            for which_axis, labels in numbered(axes):
                assert len([label for label in labels if label]) >= 3, (name, which_axis, labels)


def test_whatever_an_axis_spans_it_has_three_numbers() -> None:
    random = np.random.default_rng(0)
    with new_figure(40.0, 0.9) as figure:
        row = figure.subplots(1, 24)
        for k, axes in enumerate(row):
            low, span = random.uniform(-1e4, 1e4), 10.0 ** random.uniform(-3.0, 4.0)
            if k % 2:
                low, span = 10.0 ** random.uniform(-3.0, 3.0), 0.0
                axes.set_yscale("log")
                span = low * 10.0 ** random.uniform(0.1, 5.0)
            axes.plot([0.0, 1.0], [low, low + span])
    three_ticks(figure)
    FigureCanvasAgg(figure).draw()
    for k, axes in enumerate(figure.axes):
        for name, labels in numbered(axes):
            assert name == "x" or len([label for label in labels if label]) >= 3, (k, axes.get_ylim(), labels)


@pytest.mark.slow
def test_legends_name_every_line(drawn: dict[str, Figure]) -> None:
    for name, figure in drawn.items():
        known = named(figure)
        if not known:
            assert all(len(axes.get_lines()) <= 1 for axes in figure.axes), name
            continue
        for axes in figure.axes:
            for line in axes.get_lines():
                if line.get_label() == "_nolegend_":  # the ends of an interval
                    continue
                zero = len(set(np.ravel(np.asarray(line.get_ydata(), dtype=float)).tolist())) == 1
                assert zero or to_hex(line.get_color()) in known, (name, axes.get_ylabel(), line.get_label())


@pytest.mark.slow
def test_where_four_lines_share_an_axis_more_than_colour_tells_them_apart(drawn: dict[str, Figure]) -> None:
    for name, figure in drawn.items():
        for axes in figure.axes:
            named_ = [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
            lines = [line for line in named_ if line.get_linestyle() != "None"]
            if len(lines) >= 4:
                grey = [(looks_of(line)[1], round(line.get_linewidth(), 1)) for line in lines]
                assert len(set(grey)) == len(lines), name


@pytest.mark.slow
def test_no_two_words_of_a_figure_meet(drawn: dict[str, Figure]) -> None:
    """At 480 pixels: a drawing is scaled whole, so that what does not meet there meets nowhere."""
    for name, figure in drawn.items():
        with style():
            figure.set_dpi(480.0 / figure.get_figwidth())
            FigureCanvasAgg(figure).draw()
        boxes = [(text.get_text(), text.get_window_extent()) for text in words(figure)]
        for (first, a), (second, b) in itertools.combinations(boxes, 2):
            wide = min(a.x1, b.x1) - max(a.x0, b.x0)
            high = min(a.y1, b.y1) - max(a.y0, b.y0)
            assert not (wide > 1.0 and high > 1.0), (name, first, second)


def words(figure: Figure) -> Iterator[Text]:
    """What is written; tick labels only where they are drawn."""
    own: list[Text] = []
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
            own += [label for tick in ticks for label in (tick.label1, tick.label2)]
            yield from (tick.label1 for tick in ticks if low <= tick.get_loc() <= high and said(tick.label1))
    for text in figure.findobj(Text):
        if isinstance(text, Text) and said(text) and not any(text is label for label in own):
            yield text


def said(text: Text) -> bool:
    return text.get_visible() and bool(text.get_text().strip())


def turned(colour: str) -> np.ndarray:
    """A colour after invert(0.9) hue-rotate(180deg), as browsers compute it, between 0 and 1."""
    r, g, b = 0.9 - 0.8 * np.array(to_rgb(colour))
    rotate = np.array([[-0.574, 1.43, 0.144], [0.426, 0.43, 0.144], [0.426, 1.43, -0.856]])
    return np.clip(rotate @ (r, g, b), 0.0, 1.0)


def luminance(rgb: np.ndarray) -> float:
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


def test_curves_and_words_stand_out_in_the_dark() -> None:
    """Contrast as the Web Content Accessibility Guidelines compute it: 3 for what is drawn, 7 for ink."""
    css = files("hystmpc.trials").joinpath("report.css").read_text(encoding="utf-8")
    assert "filter: invert(0.9) hue-rotate(180deg)" in css
    paper = luminance(turned("#ffffff"))
    for colour in (*PALETTE, "#222222"):
        contrast = (luminance(turned(colour)) + 0.05) / (paper + 0.05)
        assert contrast >= (7.0 if colour == "#222222" else 3.0), colour


@pytest.mark.skipif(which("node") is None, reason="no JavaScript")
def test_the_ticks_of_a_figure_that_zooms_are_three_at_least(tmp_path: Path) -> None:
    script = files("hystmpc.trials").joinpath("zoom.js").read_text(encoding="utf-8")
    (ticks,) = re.findall(r"(const ticks = .*?\n  \};)", script, re.DOTALL)
    tried = (
        "for (let k = 0; k < 5000; k++) {"
        " const low = 1e3 * (Math.random() - 0.5), high = low + 10 ** (6 * Math.random() - 3);"
        " const n = ticks(low, high, 3).length; if (n < 3 || n > 12) throw new Error([low, high, n]); }"
        " if (ticks(-4.9, 4.9, 3).length < 3) throw new Error('one');"
    )
    (tmp_path / "ticks.js").write_text(f"{ticks}\n{tried}", encoding="utf-8")
    done = subprocess.run(["node", str(tmp_path / "ticks.js")], capture_output=True, text=True, timeout=30)
    assert done.returncode == 0, done.stderr
