"""Progress of what takes long: bars where standard error is a terminal, lines elsewhere; compilation is one of them."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, final

import typer
from rich.progress import BarColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeElapsedColumn

from hystmpc.models.kernels.compiling import Compilation, about, sentence
from hystmpc.trials.types import Progress as Told

from .console import INTERRUPTED, errors
from .time_left import EVEN, Pace, Steady, TimeLeft, clock_words

if TYPE_CHECKING:
    from rich.console import Console

FIRST_S, EVERY_S = 2.0, 10.0
"""A line is said of what takes longer than the first, then one in each of the second [s]."""

_TICK_S = 0.25
_DRAWN_S = 1.0  # after which a bar is drawn that has told nothing yet
_RESTED_S = 3.0  # without compilation, after which it is taken to be over
_COMPILING = "compiling, first use only"


@dataclass
class Work:
    """One computation, as it has been told.

    Attributes:
        share: that is done, None where it is not known.
        left: estimate of the time left.
        began: when it began, and `said` when a line was said of it last [s]; None before.
        stage: first word of the note of that line.
    """

    title: str
    began: float
    total: float | None = None
    share: float | None = None
    note: str = ""
    told: bool = False
    left: TimeLeft = field(default_factory=TimeLeft)
    said: float | None = None
    stage: str = ""

    def line(self, now: float) -> str | None:
        """The line that is due at a time, if one is: of a new stage, else after `EVERY_S`."""
        if now - self.began < FIRST_S:
            return None
        stage = _stage(self.note)
        if self.said is not None and stage == self.stage and now - self.said < EVERY_S:
            return None
        self.said, self.stage = now, stage
        seconds = self.left.seconds(now)
        share = "" if self.share is None else f"{100 * self.share:.0f} %"
        left = f"about {about(seconds)} left" if seconds else ""
        return f"{self.title}: {', '.join(filter(None, (share, self.note, left))) or 'going on'}"


def _stage(note: str) -> str:
    """First word of a note; what counts, `3 of 9`, and what names a part, `lag/command`, begins no stage."""
    word = note.partition(" ")[0].strip(":,")
    return "" if word[:1].isdigit() or "/" in word else word


@final
class Compiling:
    """Compilation as a computation of its own."""

    def __init__(self) -> None:
        self.found = Compilation(0.0, 0.0, False)
        self.at, self._shown = 0.0, False
        self._said: float | None = None  # when a line was said last
        self._steady = Steady()

    def told(self, found: Compilation, now: float) -> None:
        """It has begun, gone on or paused."""
        self.found, self.at = found, now

    def worth(self, now: float) -> bool:
        """Whether it goes on, and takes long enough to be shown."""
        if self.found.busy or now - self.at < _RESTED_S:
            self._shown |= self.found.worth_telling(now - self.at)
        else:
            self._shown = False
        return self._shown

    def state(self, now: float) -> tuple[float, float]:
        """Share that is done, and the time left [s]."""
        done = self.found.done_s + (now - self.at if self.found.busy else 0.0)
        left = self._steady.show(max(self.found.total_s - done, 0.0), now, not self.found.busy) or 0.0
        return (done / (done + left) if done + left > 0 else 0.0), left

    def line(self, now: float) -> str | None:
        """The line that is due at a time, if one is."""
        if not self.worth(now):
            return None
        if self._said is not None and (now - self._said < EVERY_S or not self.found.busy):
            return None
        first, self._said = self._said is None, now
        share, left = self.state(now)
        return sentence(left) if first else f"{_COMPILING}: {100 * share:.0f} %, about {about(left)} left"


@final
class Screen:
    """All that is shown of the computations of this program.

    Args:
        console: standard error.
        clock: time [s].
        ticks: whether a thread looks after it; else `tick` is called from outside.
    """

    def __init__(self, console: Console, clock: Callable[[], float] = time.monotonic, ticks: bool = True) -> None:
        self._console, self._clock, self._ticks = console, clock, ticks
        self._lock = threading.RLock()
        self._works: dict[int, Work] = {}
        self._compiling = Compiling()
        self._drawn: Progress | None = None
        self._tasks: dict[int, TaskID] = {}
        self._thread: threading.Thread | None = None
        self._over = threading.Event()
        self._number = 0

    def open(self, title: str, total: float | None, pace: Pace) -> int:
        """Begin to show a computation; its number."""
        with self._lock:
            self._number += 1
            now = self._clock()
            work = Work(title, now, total, left=TimeLeft(pace))
            if self._compiling.found.busy:
                work.left.pause(now)
            self._works[self._number] = work
            self._watch()
            return self._number

    def tell(self, number: int, done: float, note: str, total: float | None) -> None:
        """So much of a computation is done."""
        with self._lock:
            work, now = self._works[number], self._clock()
            first, work.told = not work.told, True
            work.note, work.total = note, work.total if total is None else total
            if work.total:
                work.share = min(max(done / work.total, 0.0), 1.0)
                work.left.told(work.share, now)
            if first:
                self.tick()

    def close(self, number: int) -> None:
        """A computation is over; what was never drawn leaves nothing."""
        with self._lock:
            self.tick()
            work = self._works.pop(number)
            if work.said is not None and not self._console.is_terminal:
                self._say(f"{work.title}: ended after {about(self._clock() - work.began)}")
            self._tasks.pop(number, None)
            if not self._works:
                self._end()

    def compiles(self, found: Compilation) -> None:
        """Kernels are compiled, or not any more."""
        with self._lock:
            now = self._clock()
            self._compiling.told(found, now)
            for work in self._works.values():
                work.left.pause(now) if found.busy else work.left.go_on(now)
            self._watch()
            self.tick()

    def stop(self) -> None:
        """Show nothing more: a thread that draws while the interpreter ends would end it with an error."""
        with self._lock:
            thread, self._thread = self._thread, None
            self._over.set()
        if thread is not None:
            thread.join()
        self._end()

    def tick(self) -> None:
        """Show what is to be shown now; a screen that is gone is no reason to end the work."""
        with self._lock, suppress(OSError):
            now = self._clock()
            if self._console.is_terminal:
                self._draw(now)
            else:
                self._lines(now)

    def _lines(self, now: float) -> None:
        compiling = self._compiling
        if line := compiling.line(now):
            self._say(line)
        if compiling.worth(now) and compiling.found.busy:
            return
        for work in self._works.values():
            if line := work.line(now):
                self._say(line)

    def _say(self, line: str) -> None:
        self._console.print(line, soft_wrap=True, highlight=False)

    def _draw(self, now: float) -> None:
        for number, work in self._works.items():
            if number not in self._tasks and (work.told or now - work.began >= _DRAWN_S):
                self._tasks[number] = self._progress().add_task(work.title, total=work.total, note="", left="")
            if number in self._tasks:
                left = clock_words(work.left.seconds(now))
                done = None if work.share is None or not work.total else work.share * work.total
                self._progress().update(
                    self._tasks[number], total=work.total, completed=done, note=work.note, left=left
                )
        if self._compiling.worth(now):
            share, left_s = self._compiling.state(now)
            if 0 not in self._tasks:
                self._tasks[0] = self._progress().add_task(_COMPILING, total=1.0, note="", left="")
            self._progress().update(self._tasks[0], completed=share, left=clock_words(left_s))
        elif 0 in self._tasks:
            self._progress().update(self._tasks.pop(0), completed=1.0, left="")
            if not self._works:
                self._end()
        if self._drawn is not None:
            self._drawn.refresh()

    def _progress(self) -> Progress:
        """The bars, drawn from now on."""
        if self._drawn is None:
            columns = (
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TaskProgressColumn(),
                TimeElapsedColumn(),
                TextColumn("left {task.fields[left]}", markup=False),
                TextColumn("{task.fields[note]}", markup=False),
            )
            # What goes to a file is not drawn over, and has to get there.
            both = sys.stdout.isatty()
            self._drawn = Progress(*columns, console=self._console, auto_refresh=False, redirect_stdout=both)
            self._drawn.start()
        return self._drawn

    def _end(self) -> None:
        """Leave what is drawn as it stands."""
        if self._drawn is not None:
            self._drawn.stop()
            self._drawn = None
            self._tasks.clear()

    def _watch(self) -> None:
        """Have a thread tick as long as there is something to show."""
        if self._ticks and self._thread is None:
            self._over.clear()
            self._thread = threading.Thread(target=self._go, name="progress", daemon=True)
            self._thread.start()

    def _go(self) -> None:
        while not self._over.wait(_TICK_S):
            with self._lock:
                self.tick()
                if not self._works and not self._compiling.worth(self._clock()):
                    self._end()
                    self._thread = None
                    return


SCREEN = Screen(errors)
"""Of this program."""


@final
class Bar:
    """Tells the screen how far one computation is."""

    def __init__(self, screen: Screen, title: str, total: float | None, pace: Pace) -> None:
        self._screen = screen
        self._number = screen.open(title, total, pace)

    def __call__(self, done: float, note: str = "", total: float | None = None) -> None:
        """Move to `done`, with a note; a total may become known or change on the way."""
        self._screen.tell(self._number, done, note, total)

    def close(self) -> None:
        """End it as it stands."""
        self._screen.close(self._number)


@contextmanager
def bar(title: str, total: float | None = None, pace: Pace = EVEN) -> Iterator[Bar]:
    """Show progress and time left while the block runs.

    Args:
        title: what is done.
        total: steps in all, if they are known.
        pace: share of the time by share of the steps.
    """
    shown = Bar(SCREEN, title, total, pace)
    try:
        yield shown
    finally:
        shown.close()


@contextmanager
def progress_of(title: str, pace: Pace = EVEN, kept: str = "") -> Iterator[Told]:
    """What a task is given as `progress`, shown while the block runs.

    Args:
        title: what is done.
        pace: share of the time by share of the steps.
        kept: line on what Ctrl-C leaves behind; where empty Ctrl-C ends the block as any other exception.

    Raises:
        typer.Exit: with 130 if the user ended it and something is kept.
    """
    try:
        with bar(title, pace=pace) as show:
            yield lambda done, total, note="", /: show(done, note, total if math.isfinite(total) else None)
    except KeyboardInterrupt:
        if not kept:
            raise
        errors.print(kept, style="yellow", soft_wrap=True)
        raise typer.Exit(INTERRUPTED) from None
