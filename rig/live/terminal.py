"""The terminal view: is it tracking, what is it doing, is it in time, is anything wrong."""

from __future__ import annotations

import math
from typing import final

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from ..sample import Sample, Sink
from .braille import bar, columns_of, curves, limits_of, raster
from .state import WINDOW_S, Snapshot
from .view import Watched

PERIOD_S = 0.125
_LINE_EVERY = 80  # of the periods, where there is no terminal to draw on
_PLOT_ROWS = 9
_RECENT_S = 3.0  # a fault younger than this is shown as present
_STATE_COLOURS = {
    "mpc": "green",
    "stop": "white on red",
    "hold": "yellow",
    "inverse": "yellow",
    "shifted plan": "yellow",
}


@final
class TerminalView(Sink):
    """Draws the state of the run 8 times a second; on an output that is no terminal a line every 10 s.

    Drawing takes 10 to 30 ms of Python each time, so it belongs into another process than the loop; see `open_apart`.

    Args:
        unit: of the command.
        rate_hz: rate of the loop [Hz].
        page: address of the local page, to be named; empty without one.
        console: where to draw; standard error where None.

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
        self._watched = Watched(rate_hz, self._show, PERIOD_S)

    def put(self, sample: Sample) -> None:
        """Take a sample; never blocks, never raises, counts what it has to drop."""
        self._watched.put(sample)

    def tell(self, text: str) -> None:
        """Show a line, such as that recording has stopped."""
        self._watched.tell(text)

    def close(self) -> None:
        """Leave the last state on the screen."""
        self._watched.close()
        if self._live is not None:
            self._live.stop()

    def _show(self, snapshot: Snapshot) -> None:
        self._calls += 1
        if self._live is not None:
            self._live.update(self.render(snapshot), refresh=True)
        elif self._calls % _LINE_EVERY == 1:
            self._console.print(headline(snapshot, self._unit), soft_wrap=True)

    def render(self, snapshot: Snapshot) -> Panel:
        """The whole view."""
        width = max(min(self._console.width, 110) - 14, 20)
        parts: list[RenderableType] = [headline(snapshot, self._unit), Text(), _plot(snapshot, width), Text()]
        parts += [_command(snapshot, self._unit, width), *_timing(snapshot, self._rate_hz, width), *_faults(snapshot)]
        parts += [Text(note, style="bold red") for note in snapshot.notes]
        return Panel(Group(*parts), title="hystmpc", subtitle=self._page or None, expand=False)


def headline(snapshot: Snapshot, unit: str) -> Text:
    """Where the run is: time, source, angle, reference, error, command; one line."""
    last = snapshot.last
    error = last.reference_deg - last.measured_deg
    text = Text(f"{last.t_s:8.1f} s  ", no_wrap=True)
    text.append(f" {last.source.upper()} ", _STATE_COLOURS.get(last.source, "cyan"))
    angle = f"{last.measured_deg:7.2f}" if math.isfinite(last.measured_deg) else "     --"
    text.append(f"  angle {angle} deg", "bold cyan")
    text.append(f"  reference {last.reference_deg:7.2f}", "yellow")
    text.append(f"  error {error:+6.2f} (rms {snapshot.rms_deg:.2f})" if math.isfinite(error) else "  no angle")
    text.append(f"  command {last.command:.3f} {unit}", "magenta")
    if last.status and last.status != last.source:
        text.append(f"  {' '.join(last.status.split())}", "dim")
    return text


def _plot(snapshot: Snapshot, width: int) -> Table:
    low, high = limits_of(snapshot.reference, snapshot.angle, least_span=2.0)
    shape = low, high, width, _PLOT_ROWS
    fields = [
        (raster(snapshot.t, snapshot.reference, *shape), "yellow"),
        (raster(snapshot.t, snapshot.angle, *shape), "bold cyan"),
    ]
    axis = [f"{high:6.1f}°", *[""] * (_PLOT_ROWS - 2), f"{low:6.1f}°"]
    grid = Table.grid(padding=(0, 1))
    grid.add_row(Text("\n".join(axis)), curves(fields))
    grid.add_row("", Text(f"last {min(float(snapshot.t[-1] - snapshot.t[0]), WINDOW_S):.0f} s", style="dim"))
    return grid


def _command(snapshot: Snapshot, unit: str, width: int) -> Text:
    low, high = limits_of(snapshot.command, least_span=1e-3)
    text = Text("command ", no_wrap=True)
    text.append(bar(snapshot.last.command, low, high, max(width - 24, 8)), "magenta")
    text.append(f" {low:.2f} to {high:.2f} {unit}", "dim")
    return text


def _timing(snapshot: Snapshot, rate_hz: float, width: int) -> list[Text]:
    lines = []
    half = max(width // 2, 12)
    for name, histogram in (("late   ", snapshot.late), ("work   ", snapshot.total)):
        figures = histogram.summary()
        line = Text(f"{name} ", no_wrap=True)
        line.append(columns_of(histogram.counts, half), "blue")
        line.append(f" 0 to {2e3 / rate_hz:.0f} ms; median {1e3 * figures.median_s:.2f}, ")
        line.append(f"greatest {1e3 * figures.greatest_s:.2f} ms")
        lines.append(line)
    missed = Text(f"rate    {snapshot.rate_hz:.1f} of {rate_hz:g} Hz, deadlines missed ")
    missed.append(str(snapshot.missed), "bold red" if snapshot.missed else "green")
    return [*lines, missed]


def _faults(snapshot: Snapshot) -> list[Text]:
    if not snapshot.faults:
        return [Text("faults  none", style="green")]
    line = Text("faults  ")
    for name, count in snapshot.faults.items():
        ago = snapshot.last.t_s - snapshot.fault_s[name]
        present = ago < _RECENT_S
        line.append(f"{name} ×{count}" + ("" if present else f" ({ago:.0f} s ago)"), "bold red" if present else "dim")
        line.append("  ")
    return [line]
