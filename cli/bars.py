"""Progress and time left of long computations: bars on a terminal, otherwise lines."""

from __future__ import annotations

import math
import sys
import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import typer
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeElapsedColumn

from hystmpc.trials.brief import about

from .console import INTERRUPTED, errors, say

if TYPE_CHECKING:
    from rich.console import Console

    from hystmpc.trials.types import Progress as Report

Pace = Sequence[tuple[float, float]]
"""Points (share of the steps, share of the time) of the progress, rising from (0, 0) to (1, 1)."""

EVEN: Pace = ((0.0, 0.0), (1.0, 1.0))

RISE_PER_S = 0.02
"""Greatest relative rise of a displayed time left [1/s]."""

FIRST_S, EVERY_S = 2.0, 10.0
"""Time to the first line of a computation, and interval of its later lines [s]."""

_FALL_S = 3.0  # time constant with which a displayed time left falls to a shorter estimate
_LEAST_S, _LEAST_SHARE = 1.0, 0.01  # least time and share for an estimate of the time left
_TICK_S = 0.25
_DRAWN_S = 1.0  # delay of a bar whose computation has not reported yet


@final
class Steady:
    """Filter of a displayed time left: it counts down, and follows its estimate without jumps."""

    def __init__(self) -> None:
        self._shown: float | None = None
        self._read = 0.0

    def show(self, wanted: float | None, now: float) -> float | None:
        """Time left to display for an estimate [s] at a time [s]."""
        gone, self._read = now - self._read, now
        if wanted is None or self._shown is None:
            self._shown = wanted
            return wanted
        before = max(self._shown - gone, 0.0)
        if wanted <= before:
            self._shown = wanted + (before - wanted) * math.exp(-gone / _FALL_S)
        else:
            self._shown = min(wanted, self._shown * (1 + RISE_PER_S * gone))
        return self._shown


@final
class TimeLeft:
    """Estimate of the time left from the mean speed since the start.

    With elapsed time E and the elapsed share p of the time, E (1 - p) / p is left. The error of the mean speed is at
    most the factor between the fastest and the slowest stage; the present speed would jump at each stage. Between two
    reports p grows at the mean speed, at most by the last step.

    Args:
        pace: share of the time by share of the steps, as measured; by default steps of equal duration.
    """

    def __init__(self, pace: Pace = EVEN) -> None:
        self._steps, self._times = zip(*pace, strict=True)
        self._began: float | None = None
        self._done, self._share, self._at = 0.0, 0.0, 0.0  # shares of steps and time at the last report; elapsed time
        self._farthest = 0.0  # share of the time where a step as wide as the last one ends
        self._steady = Steady()

    def reported(self, share: float, now: float) -> None:
        """Set the completed share of the steps, 0 to 1, at a time [s]; a decrease restarts the estimate."""
        step = share - self._done
        if self._began is None or step < 0.0:
            self._began, self._steady, step = now, Steady(), 0.0
        elif step == 0.0:
            return
        self._done, self._share, self._farthest = share, self._passed(share), self._passed(share + step)
        self._at = self._elapsed(now)

    def seconds(self, now: float) -> float | None:
        """Time left to display [s]; None if unknown."""
        return self._steady.show(self._estimate(now), now)

    def _passed(self, share: float) -> float:
        """Elapsed share of the time at a completed share of the steps."""
        k = min(max(bisect_right(self._steps, share), 1), len(self._steps) - 1)
        wide = self._steps[k] - self._steps[k - 1]
        part = min((share - self._steps[k - 1]) / wide, 1.0)
        return self._times[k - 1] + part * (self._times[k] - self._times[k - 1])

    def _estimate(self, now: float) -> float | None:
        elapsed = self._elapsed(now)
        if self._share >= 1.0:
            return 0.0
        if self._share < _LEAST_SHARE or elapsed < _LEAST_S or self._at <= 0.0:
            return None
        # At most by the width of the last step: during a longer step the mean speed falls.
        share = min(self._share * elapsed / self._at, self._farthest)
        return elapsed * (1.0 - share) / share

    def _elapsed(self, now: float) -> float:
        return 0.0 if self._began is None else now - self._began


def clock_words(seconds: float | None) -> str:
    """Text of a time left with the precision of an estimate: 0:07, 0:35, 2:40; empty if unknown."""
    if seconds is None:
        return ""
    step = 10.0 if seconds > 120.0 else 5.0 if seconds > 20.0 else 1.0
    whole = int(step * math.ceil(seconds / step))
    hours, minutes = divmod(whole // 60, 60)
    return f"{hours}:{minutes:02}:{whole % 60:02}" if hours else f"{minutes}:{whole % 60:02}"


@final
@dataclass
class Computation:
    """State of one computation."""

    title: str
    began: float  # start time [s]
    left: TimeLeft
    total: float | None = None
    share: float | None = None  # completed share of the steps, None if unknown
    note: str = ""
    reported: bool = False
    said: float | None = None  # time of its last printed line [s]; `stage` is the first word of that line's note
    stage: str = ""

    def line(self, now: float) -> str | None:
        """Line due at a time, if any: at once for a new stage, otherwise every `EVERY_S`."""
        # A count, `3 of 9`, or a name of a part, `lag/command`, begins no stage.
        stage = self.note.partition(" ")[0].strip(":,")
        stage = "" if stage[:1].isdigit() or "/" in stage else stage
        late = self.said is None or stage != self.stage or now - self.said >= EVERY_S
        if now - self.began < FIRST_S or not late:
            return None
        self.said, self.stage = now, stage
        seconds = self.left.seconds(now)
        share = "" if self.share is None else f"{100 * self.share:.0f} %"
        left = f"about {about(seconds)} left" if seconds else ""
        return f"{self.title}: {', '.join(filter(None, (share, self.note, left))) or 'going on'}"


@final
class Screen:
    """Display of the computations of this program.

    Args:
        clock: time [s].
        ticks: whether a thread updates it; otherwise the caller calls `tick`.
    """

    def __init__(self, console: Console, clock: Callable[[], float] = time.monotonic, ticks: bool = True) -> None:
        self._console, self._clock, self._ticks = console, clock, ticks
        self._lock = threading.RLock()
        self._works: dict[int, Computation] = {}
        self._bars: Progress | None = None
        self._drawn: dict[int, TaskID] = {}  # number of a computation, and its bar
        self._thread: threading.Thread | None = None
        self._over = threading.Event()
        self._number = 0

    def open(self, title: str, total: float | None, pace: Pace) -> int:
        """Add a computation to the display and return its number."""
        with self._lock:
            self._number += 1
            self._works[self._number] = Computation(title, self._clock(), TimeLeft(pace), total)
            self._watch()
            return self._number

    def tell(self, number: int, done: float, note: str, total: float | None) -> None:
        """Set the completed steps of a computation, and its total if known."""
        with self._lock:
            work, now = self._works[number], self._clock()
            first, work.reported = not work.reported, True
            work.note, work.total = note, work.total if total is None else total
            if work.total:
                work.share = min(max(done / work.total, 0.0), 1.0)
                work.left.reported(work.share, now)
            if first:
                self.tick()

    def close(self, number: int) -> None:
        """Remove a computation; one that was never drawn leaves no trace on the screen."""
        with self._lock:
            self.tick()
            work = self._works.pop(number)
            if work.said is not None and not self._console.is_terminal:
                self._print(f"{work.title}: ended after {about(self._clock() - work.began)}")
            self._drawn.pop(number, None)
            if not self._works:
                self._end()

    def stop(self) -> None:
        """Stop the display before the interpreter ends, since a drawing thread would then cause an error."""
        with self._lock:
            thread, self._thread = self._thread, None
            self._over.set()
        if thread is not None:
            thread.join()
        self._end()

    def tick(self) -> None:
        """Update the display; a closed terminal does not end the computation."""
        with self._lock, suppress(OSError):
            now = self._clock()
            if self._console.is_terminal:
                self._draw(now)
                return
            for work in self._works.values():
                if line := work.line(now):
                    self._print(line)

    def _print(self, line: str) -> None:
        self._console.print(line, soft_wrap=True, highlight=False)

    def _draw(self, now: float) -> None:
        for number, work in self._works.items():
            if number in self._drawn or work.reported or now - work.began >= _DRAWN_S:
                self._bar(number, work, clock_words(work.left.seconds(now)))
        if self._bars is not None:
            self._bars.refresh()

    def _bar(self, number: int, work: Computation, left: str) -> None:
        if self._bars is None:
            columns = (
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TaskProgressColumn(),
                TimeElapsedColumn(),
                TextColumn("left {task.fields[left]}", markup=False),
                TextColumn("{task.fields[note]}", markup=False),
            )
            # Standard output redirected to a file is not overdrawn, and must be complete.
            both = sys.stdout.isatty()
            self._bars = Progress(*columns, console=self._console, auto_refresh=False, redirect_stdout=both)
            self._bars.start()
        if number not in self._drawn:
            self._drawn[number] = self._bars.add_task(work.title, total=work.total, note="", left="")
        done = None if work.share is None or not work.total else work.share * work.total
        self._bars.update(self._drawn[number], total=work.total, completed=done, note=work.note, left=left)

    def _end(self) -> None:
        if self._bars is not None:
            self._bars.stop()
            self._bars = None
            self._drawn.clear()

    def _watch(self) -> None:
        if self._ticks and self._thread is None:
            self._over.clear()
            self._thread = threading.Thread(target=self._go, name="progress", daemon=True)
            self._thread.start()

    def _go(self) -> None:
        while not self._over.wait(_TICK_S):
            with self._lock:
                self.tick()
                if not self._works:
                    self._end()
                    self._thread = None
                    return


SCREEN = Screen(errors)
"""Display of this program."""


@contextmanager
def bar(title: str, total: float | None = None, pace: Pace = EVEN) -> Iterator[Callable[..., None]]:
    """Context that shows the progress and the time left of a computation.

    Yields:
        A function of the completed steps, a note, and a new total.
    """
    number = SCREEN.open(title, total, pace)

    def tell(done: float, note: str = "", total: float | None = None) -> None:
        SCREEN.tell(number, done, note, total)

    try:
        yield tell
    finally:
        SCREEN.close(number)


@contextmanager
def progress_of(title: str, pace: Pace = EVEN, kept: str = "", after: float = 0.0) -> Iterator[Report]:
    """Context that shows the progress of a task and yields its `progress` callback.

    Args:
        kept: line on the results kept after Ctrl-C; if empty, Ctrl-C ends the block as any other exception.
        after: steps that follow those which the task counts.

    Raises:
        typer.Exit: with 130 if the user ended it and results are kept.
    """
    try:
        with bar(title, pace=pace) as tell:
            yield lambda done, total, note="", /: tell(done, note, total + after if math.isfinite(total) else None)
    except KeyboardInterrupt:
        if not kept:
            raise
        say(kept)
        raise typer.Exit(INTERRUPTED) from None
