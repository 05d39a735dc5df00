"""What a soak found, and its table: one column a run over a wire."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.table import Table

from bare_loop import Floor  # isort: skip

RATIO = 1.10


@dataclass(frozen=True)
class Soaked:
    """One run.

    Attributes:
        transport, rate_hz: of the run.
        ended: empty for a run that came to its end, else the last thing it said.
        samples, missed, skipped: of the run.
        execution, jitter: `median_s`, `p99_s`, `greatest_s` and others, see `TimingSummary`, and `least_s` of the
            samples that were planned [s].
        tracking_deg: RMS of measured less wanted angle [deg].
        sources: tracking samples by what gave the command.
        floor: what the sleeping process saw meanwhile.
        beside_stall: missed samples at whose time the sleeper was late, too.
        taken_s: processor time that a host took from this machine meanwhile [s]; NaN where that is not told.
        refused: what of the run's scheduling the system did not permit.
        in_c: samples that were taken whole in C.
        left_c: how often Python had to go on, by why.
    """

    transport: str
    rate_hz: float
    ended: str
    samples: int
    missed: int
    skipped: int
    execution: dict[str, float]
    jitter: dict[str, float]
    tracking_deg: float
    sources: dict[str, int]
    floor: Floor
    beside_stall: int
    taken_s: float
    refused: tuple[str, ...]
    in_c: int
    left_c: dict[str, int]


@dataclass(frozen=True)
class Row:
    """A run over a wire beside the same one in process, and what a loop that only spins as long misses."""

    wire: Soaked
    in_process: Soaked
    spinner: Floor

    @property
    def ratio(self) -> float:
        """Tracking error over the wire by that in process."""
        return self.wire.tracking_deg / self.in_process.tracking_deg

    @property
    def passed(self) -> bool:
        """No deadline missed, the error within the bar, both runs at their end."""
        return not (self.wire.ended or self.in_process.ended) and self.wire.missed == 0 and self.ratio <= RATIO


def table(rows: Sequence[Row]) -> Table:
    """One column a run over a wire."""
    grid = Table("ms, deg RMS")
    figures = [_figures(row) for row in rows]
    sources = sorted({name for row in rows for name in row.wire.sources})
    for row in rows:
        grid.add_column(f"{row.wire.transport} {row.wire.rate_hz:g} Hz", justify="right")
    for name in figures[0]:
        grid.add_row(name, *(found[name] for found in figures))
    for name in sources:
        grid.add_row(f"commands by {name}", *(str(row.wire.sources.get(name, 0)) for row in rows))
    return grid


def _figures(row: Row) -> dict[str, str]:
    one, sleeper, spinner = row.wire, row.wire.floor, row.spinner
    return {
        "samples": str(one.samples),
        "... taken in C": str(one.in_c),
        "... left to Python": ", ".join(f"{count} {reason}" for reason, count in one.left_c.items()) or "-",
        "missed (bar 0)": str(one.missed),
        "... beside a stall": str(one.beside_stall),
        "taken by the host, s": f"{one.taken_s:.2f}",
        "execution, least": f"{1e3 * one.execution['least_s']:.2f}",
        "execution, median": f"{1e3 * one.execution['median_s']:.2f}",
        "execution, p99": f"{1e3 * one.execution['p99_s']:.2f}",
        "execution, p99.9": f"{1e3 * one.execution['p999_s']:.2f}",
        "execution, greatest": f"{1e3 * one.execution['greatest_s']:.2f}",
        "wake-up jitter, p99": f"{1e3 * one.jitter['p99_s']:.2f}",
        "wake-up jitter, greatest": f"{1e3 * one.jitter['greatest_s']:.2f}",
        "error over the wire": f"{one.tracking_deg:.3f}",
        "error in process": f"{row.in_process.tracking_deg:.3f}",
        f"ratio (bar {RATIO:.2f})": f"{row.ratio:.3f}",
        "sleeper: wake-ups": str(sleeper.wake_ups),
        "sleeper: beyond a period": str(sleeper.late),
        "sleeper: p99 late": f"{1e3 * sleeper.p99_s:.2f}",
        "sleeper: greatest": f"{1e3 * sleeper.greatest_s:.2f}",
        "spinner: periods": str(spinner.wake_ups),
        "spinner: missed": str(spinner.late),
        "spinner: greatest": f"{1e3 * spinner.greatest_s:.2f}",
    }
