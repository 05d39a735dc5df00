"""Terminal view of a run: tracking, command, timing, faults."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from hystmpc.trials.types import Vec

from ..axes import NAMES, PerAxis, each, in_words, is_known, spread
from .state import WINDOW_S, LiveState, LiveView

_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
_EMPTY = 0x2800
_LINE_EVERY = 80  # of the periods, where there is no terminal to draw on
_PLOT_ROWS = 9
_RECENT_S = 3.0  # a fault younger than this is shown as present
_FALLBACKS = dict.fromkeys(("hold", "inverse", "shifted plan"), "yellow")
_STATE_COLOURS = {"mpc": "green", "stop": "white on red", **_FALLBACKS}


def limits_of(*curves: Vec, least_span: float) -> tuple[float, float]:
    """Lowest and highest value of all curves, at least `least_span` apart; 0 and 1 where nothing is finite."""
    values = np.concatenate([curve[np.isfinite(curve)] for curve in curves])
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    missing = max(least_span - (high - low), 0.0) / 2
    return low - missing, high + missing


def raster(t: Vec, y: Vec, low: float, high: float, width: int, height: int) -> NDArray[np.int64]:
    """Braille dots of a curve y (T,) over t (T,) as character codes, (height, width); 0 without a dot.

    Values that are not finite leave a gap. `low` and `high` bound the vertical axis.
    """
    cells = np.zeros((height, width), dtype=np.int64)
    known = np.isfinite(y) & np.isfinite(t)
    if not known.any() or not t[-1] > t[0]:
        return cells
    x = ((t[known] - t[0]) / (t[-1] - t[0]) * (2 * width - 1)).round().astype(int)
    level = np.clip((y[known] - low) / max(high - low, 1e-12), 0, 1)
    row = ((1 - level) * (4 * height - 1)).round().astype(int)
    np.bitwise_or.at(cells, (row // 4, np.clip(x, 0, 2 * width - 1) // 2), _DOTS[row % 4, x % 2])
    return cells


def curves(fields: list[tuple[NDArray[np.int64], str]]) -> Text:
    """Superposed rasters as text; within one character the last one determines the colour."""
    text = Text(no_wrap=True)
    height, width = fields[0][0].shape
    for row in range(height):
        for column in range(width):
            code, colour = 0, ""
            for cells, name in fields:
                if cells[row, column]:
                    code, colour = code | int(cells[row, column]), name
            text.append(chr(_EMPTY + code) if code else " ", colour)
        text.append("\n" if row < height - 1 else "")
    return text


def bar(value: float, low: float, high: float, width: int) -> str:
    """Text bar of `width` characters for a value between two limits, with a resolution of an eighth of a character."""
    share = min(max((value - low) / max(high - low, 1e-12), 0.0), 1.0) if np.isfinite(value) else 0.0
    eighths = round(share * 8 * width)
    full = "█" * (eighths // 8) + (" ▏▎▍▌▋▊▉"[eighths % 8] if eighths % 8 else "")
    return full.ljust(width, "·")


def columns_of(counts: NDArray[np.int64], width: int) -> str:
    """Histogram as one line of `width` characters; the height is the logarithm of the count."""
    groups = np.array([part.sum() for part in np.array_split(counts, width)], dtype=np.float64)
    if not groups.any():
        return " " * width
    levels = np.ceil(8 * np.log1p(groups) / np.log1p(groups.max())).astype(int)
    return "".join(" ▁▂▃▄▅▆▇█"[level] for level in levels)


@final
class TerminalView(LiveView):
    """Terminal view of the run, drawn 8 times a second; without a terminal it prints a line every 10 s.

    Drawing takes 10 to 30 ms of Python each time, so it belongs into another process than the loop, see
    `open_recorder_process`. `page` is the address of the local page, empty without one.

    Raises:
        ConfigError: if the rate is not positive.
    """

    def __init__(self, unit: str, rate_hz: float, page: str = "", console: Console | None = None) -> None:
        self._unit, self._rate_hz, self._page = unit, rate_hz, page
        self._console = console or Console(stderr=True)
        self._calls = 0
        self._live: Live | None = None
        if self._console.is_terminal:
            self._live = Live(console=self._console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)
            self._live.start()
        super().__init__(rate_hz)

    def close(self) -> None:
        """Leave the last state on the screen and end."""
        super().close()
        if self._live is not None:
            self._live.stop()

    def _show(self, state: LiveState) -> None:
        self._calls += 1
        if self._live is not None:
            self._live.update(self.render(state), refresh=True)
        elif self._calls % _LINE_EVERY == 1:
            self._console.print(headline(state, self._unit), soft_wrap=True)

    def render(self, state: LiveState) -> Panel:
        """Render the panel of the whole view."""
        width = max(min(self._console.width, 110) - 14, 20)
        parts: list[RenderableType] = [headline(state, self._unit), Text(), _plot(state, width), Text()]
        parts += [_command(state, self._unit, width), *_timing(state, self._rate_hz, width), *_faults(state)]
        parts += [Text(note, style="bold red") for note in state.notes]
        return Panel(Group(*parts), title="hystmpc", subtitle=self._page or None, expand=False)


def headline(state: LiveState, unit: str) -> Text:
    """One line of the run's state: time, source, angle, reference, error, command."""
    last = state.last
    axes = len(each(last.command))
    parts = zip(spread(last.reference_deg, axes), spread(last.measured_deg, axes), strict=True)
    errors = [wanted - angle for wanted, angle in parts]
    text = Text(f"{last.t_s:8.1f} s  ", no_wrap=True)
    text.append(f" {last.source.upper()} ", _STATE_COLOURS.get(last.source, "cyan"))
    text.append(f"  angle {_angle(last.measured_deg)} deg", "bold cyan")
    text.append(f"  reference {_angle(last.reference_deg)}", "yellow")
    if all(map(math.isfinite, errors)):
        error = f"{errors[0]:+6.2f}" if axes == 1 else f"{math.hypot(*errors):6.2f}"
        text.append(f"  error {error} (rms {state.rms_deg:.2f})")
    elif not is_known(last.measured_deg):
        text.append("  no angle")
    text.append(f"  command {in_words(last.command, '.3f')} {unit}", "magenta")
    if last.status and last.status != last.source:
        text.append(f"  {' '.join(last.status.split())}", "dim")
    return text


def _angle(value: PerAxis) -> str:
    return " ".join(f"{one:7.2f}" if math.isfinite(one) else "     --" for one in each(value))


def _plot(state: LiveState, width: int) -> Table:
    """Reference and angle of the last 20 s, of two axes one over the other."""
    grid = Table.grid(padding=(0, 1))
    axes = [""] if state.angle.ndim == 1 else NAMES
    rows = _PLOT_ROWS // len(axes)
    for k, name in enumerate(axes):
        reference, angle = (values if values.ndim == 1 else values[:, k] for values in (state.reference, state.angle))
        low, high = limits_of(reference, angle, least_span=2.0)
        shape = low, high, width, rows
        fields = [
            (raster(state.t, reference, *shape), "yellow"),
            (raster(state.t, angle, *shape), "bold cyan"),
        ]
        scale = [f"{high:6.1f}°", *([""] * (rows - 2)), f"{low:6.1f}°"]
        if name:
            scale[1] = f"{name:>6} "
        grid.add_row(Text("\n".join(scale)), curves(fields))
    legend = Text(f"last {min(float(state.t[-1] - state.t[0]), WINDOW_S):.0f} s  ", style="dim")
    grid.add_row("", legend.append("━ reference  ", "not dim yellow").append("━ measured angle", "not dim bold cyan"))
    return grid


def _command(state: LiveState, unit: str, width: int) -> Text:
    """Bar of each command within its range of the last 20 s."""
    text, several = Text(no_wrap=True), state.command.ndim > 1
    for k, (value, series) in enumerate(zip(each(state.last.command), np.atleast_2d(state.command.T), strict=True)):
        low, high = limits_of(series, least_span=1e-3)
        text.append(f"{chr(10) if k else ''}command {f'{NAMES[k]} ' if several else ''}")
        text.append(bar(value, low, high, max(width - 24, 8)), "magenta")
        text.append(f" {low:.2f} to {high:.2f} {unit}", "dim")
    return text


def _timing(state: LiveState, rate_hz: float, width: int) -> list[Text]:
    lines = []
    half = max(width // 2, 12)
    for name, histogram in (("late   ", state.late), ("work   ", state.total)):
        figures = histogram.summary()
        line = Text(f"{name} ", no_wrap=True)
        line.append(columns_of(histogram.counts, half), "blue")
        line.append(f" 0 to {2e3 / rate_hz:.0f} ms; median {1e3 * figures.median_s:.2f}, ")
        line.append(f"greatest {1e3 * figures.greatest_s:.2f} ms")
        lines.append(line)
    missed = Text(f"rate    {state.rate_hz:.1f} of {rate_hz:g} Hz, deadlines missed ")
    missed.append(str(state.missed), "bold red" if state.missed else "green")
    return [*lines, missed]


def _faults(state: LiveState) -> list[Text]:
    if not state.faults:
        return [Text("faults  none", style="green")]
    line = Text("faults  ")
    for name, count in state.faults.items():
        ago = state.last.t_s - state.fault_s[name]
        present = ago < _RECENT_S
        line.append(f"{name} ×{count}" + ("" if present else f" ({ago:.0f} s ago)"), "bold red" if present else "dim")
        line.append("  ")
    return [line]
