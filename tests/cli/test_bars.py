"""What is shown of long computations: lines where standard error is no terminal, else bars."""

from __future__ import annotations

import io
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from hystmpc.cli.bars import EVEN, EVERY_S, FIRST_S, Screen


class Seen:
    """A screen without a thread, with a clock of its own, and the lines that it has said."""

    def __init__(self, terminal: bool = False) -> None:
        self.now, self.lines = 0.0, list[tuple[float, str]]()
        self.file = io.StringIO()
        console = Console(file=self.file, force_terminal=terminal, width=100, markup=False)
        self.screen = Screen(console, lambda: self.now, ticks=False)

    def wait(self, seconds: float) -> None:
        """Let time go on, with a look every quarter of a second."""
        for _ in range(round(4 * seconds)):
            self.now += 0.25
            self.screen.tick()
            self._read()

    def tell(self, number: int, done: float, note: str = "", total: float | None = None) -> None:
        self.screen.tell(number, done, note, total)
        self._read()

    def _read(self) -> None:
        text = self.file.getvalue()
        self.lines += [(self.now, line) for line in text.splitlines()]
        self.file.truncate(0)
        self.file.seek(0)


def test_what_is_quick_says_nothing() -> None:
    seen = Seen()
    work = seen.screen.open("fit", 10, EVEN)
    for k in range(6):
        seen.tell(work, k + 1, "best 1 deg")
        seen.wait(0.25)
    seen.screen.close(work)
    assert seen.file.getvalue() == ""
    assert seen.lines == []


@given(
    steps=st.lists(
        st.tuples(st.floats(0.3, 25.0), st.sampled_from(["range", "record 1", "3 of 9 jobs", ""])), min_size=1
    )
)
def test_a_long_work_is_never_silent_and_never_chatters(steps: list[tuple[float, str]]) -> None:
    """From the second second on at least a line in ten seconds, and one for each stage; no more."""
    seen = Seen()
    work = seen.screen.open("commission", len(steps), EVEN)
    for k, (seconds, note) in enumerate(steps):
        seen.tell(work, k, note)
        seen.wait(seconds)
    times = [0.0, *(time for time, _ in seen.lines), seen.now]
    assert max(after - before for before, after in pairwise(times)) <= EVERY_S + 0.25
    changes = 1 + sum(a.partition(" ")[0] != b.partition(" ")[0] for (_, a), (_, b) in pairwise(steps))
    assert len(seen.lines) <= seen.now / EVERY_S + changes
    assert all(time >= FIRST_S for time, _ in seen.lines)


def test_a_line_a_stage() -> None:
    seen = Seen()
    work = seen.screen.open("commission", 100, EVEN)
    for k, note in enumerate(("range", "record steps", "record holds", "identify best 0.1 deg", "report")):
        seen.tell(work, 20 * k, note)
        seen.wait(4.0)
    seen.screen.close(work)
    seen._read()
    assert [line for _, line in seen.lines] == [
        "commission: 0 %, range",
        "commission: 20 %, record steps, about 15 s left",
        "commission: 60 %, identify best 0.1 deg, about 8 s left",
        "commission: 80 %, report, about 4 s left",
        "commission: ended after 20 s",
    ]


def test_a_terminal_gets_bars_with_the_time_left() -> None:
    seen = Seen(terminal=True)
    work = seen.screen.open("fit auto", 10, EVEN)
    for k in range(6):
        seen.screen.tell(work, k, "best 0.2 deg", None)
        seen.now += 2.0
        seen.screen.tick()
    seen.screen.close(work)
    text = seen.file.getvalue()
    for words in ("fit auto", "50%", "left 0:09", "best 0.2 deg"):
        assert words in text
