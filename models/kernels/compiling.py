"""What compilation of kernels costs who waits: how long it has taken, how long it takes in all, and that it is over.

Nothing heavy is imported here, so that a program can watch before it knows whether anything will be compiled.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import final

_logger = logging.getLogger(__name__)

FUNCTION_S, BYTE_S = 0.3, 2.0e-4
"""Processor time of a function, and of a byte of its byte code [s]; measured on `fit auto`, of .2 to 95 kB a function.

numba compiles some of its own functions with ours, and not every function of a module is used. On `evaluate`,
`simulate`, `tune` and `from_config` the two make up for one another, by factors of .54 to 1.5.
"""
WORTH_TELLING_S = 2.0
"""Compilation that is over sooner is not told."""

_CERTAIN_S = 1.0  # that have passed, or are in hand, before anything is told
_LATER = 1.2  # cost of all kernels over that of those that are defined when the first is compiled
_TRUSTED_S = 3.0  # of compilation by which the speed of this machine is known half


def cost(byte_code: int) -> float:
    """Expected processor time to compile a function with so many bytes of byte code [s]."""
    return FUNCTION_S + BYTE_S * byte_code


@dataclass(frozen=True)
class Compilation:
    """How far the compilation of a process is.

    Attributes:
        done_s: time that it has taken so far [s].
        total_s: expected in all [s].
        busy: whether something is being compiled now.
        hand_s: expected for what is being compiled now [s].
    """

    done_s: float
    total_s: float
    busy: bool
    hand_s: float = 0.0

    @property
    def left_s(self) -> float:
        """Expected from now on [s]."""
        return self.total_s - self.done_s

    def worth_telling(self, more_s: float = 0.0) -> bool:
        """Whether it goes on long enough to be told, so many seconds later.

        One small function of a module may be all that is needed of it: nothing is told of what is over in a second.
        """
        return self.busy and self.left_s >= WORTH_TELLING_S and self.done_s + self.hand_s + more_s >= _CERTAIN_S


@dataclass
class _Open:
    """A function that is being compiled: its cost, when that began, and how long others took within it [s]."""

    cost: float
    began: float
    inner: float = 0.0


Observer = Callable[[Compilation], None]


@final
@dataclass
class Meter:
    """Counts what is compiled of what is expected; a process has one, `PROCESS`.

    The expected total is what is declared (`expecting`) less what was compiled or found on disk, or the kernels that
    are defined and not on disk, whichever is more. Costs are scaled by the time that those so far have taken.
    """

    clock: Callable[[], float] = time.perf_counter
    observers: list[Observer] = field(default_factory=list)
    declared_s: float = 0.0
    _waiting: dict[int, tuple[str, float]] = field(default_factory=dict)  # module and cost of functions not compiled
    _stored: set[str] = field(default_factory=set)  # modules of which some function is on disk
    _known: float = 0.0  # cost of what was compiled or loaded
    _compiled: float = 0.0  # cost of what was compiled
    _seconds: float = 0.0  # that it took
    _open: list[_Open] = field(default_factory=list)  # what is being compiled, outermost first
    _said: bool = False

    def defined(self, function: int, module: str, byte_code: int, stored: bool) -> None:
        """A function that may have to be compiled, and whether its compiled code is on disk."""
        if stored:
            self._stored.add(module)
        else:
            self._waiting[function] = (module, cost(byte_code))

    def loaded(self, function: int, module: str, byte_code: int) -> None:
        """Compiled code of a function was found on disk."""
        self._waiting.pop(function, None)
        self._stored.add(module)
        self._known += cost(byte_code)

    def begins(self, function: int, module: str, byte_code: int) -> None:
        """A function is going to be compiled."""
        del module
        self._waiting.pop(function, None)
        self._open.append(_Open(cost(byte_code), self.clock()))
        self._tell()

    def ends(self) -> None:
        """The function that began last is compiled, or could not be."""
        ended = self._open.pop()
        took = self.clock() - ended.began
        self._known += ended.cost
        self._compiled += ended.cost
        self._seconds += took - ended.inner
        if self._open:
            self._open[-1].inner += took
        else:
            self._tell()

    @property
    def now(self) -> Compilation:
        """How far it is."""
        open_, now = tuple(self._open), self.clock()
        ends = (*(one.began for one in open_[1:]), now)  # or where the next one within began
        running = [end - one.began - one.inner for one, end in zip(open_, ends, strict=False)]
        slow = (_TRUSTED_S + self._seconds) / (_TRUSTED_S + self._compiled)
        hand = sum(max(slow * one.cost - took, 0.0) for one, took in zip(open_, running, strict=True))
        waiting = tuple(self._waiting.values())
        later = _LATER * sum(seconds for module, seconds in waiting if module not in self._stored)
        later = max(later, self.declared_s - self._known - sum(one.cost for one in open_), 0.0)
        done = self._seconds + sum(running)
        return Compilation(done, done + hand + slow * later, bool(open_), hand)

    def tell(self, found: Compilation) -> None:
        """Tell the observers; without any, say once in the log what Python's users wait for."""
        for observer in tuple(self.observers):
            observer(found)
        if not self.observers and not self._said and found.worth_telling():
            self._said = True
            _logger.warning("%s", sentence(found.left_s))

    def _tell(self) -> None:
        self.tell(self.now)


def joint(processes: Collection[Compilation]) -> Compilation:
    """Compilation of processes that work side by side: what is waited for is the one that takes longest."""
    longest = max(processes, key=lambda found: (found.busy, found.left_s))
    return replace(longest, busy=any(found.busy for found in processes))


def sentence(seconds: float) -> str:
    """What is said to who waits."""
    return f"compiling, first use only, about {about(seconds)}"


def about(seconds: float) -> str:
    """A duration in words, no finer than an estimate is worth: 4 s, 25 s, 2.5 min."""
    if seconds < 9.5:
        return f"{max(1, round(seconds))} s"
    if seconds < 87.5:
        return f"{5 * round(seconds / 5)} s"
    return f"{round(2 * seconds / 60) / 2:g} min"


PROCESS = Meter()
"""Of this process."""


@contextmanager
def watching(observer: Observer) -> Iterator[None]:
    """Tell an observer, in place of the log, what is compiled while the block runs.

    Observers are called from the thread that compiles.
    """
    PROCESS.observers.append(observer)
    try:
        yield
    finally:
        PROCESS.observers.remove(observer)


@contextmanager
def expecting(seconds: float) -> Iterator[None]:
    """Declare what a search compiles in all where nothing is on disk [s]; also as a decorator.

    A search makes its kernels as it goes, so that those that are defined by then say too little.
    """
    before = PROCESS.declared_s
    PROCESS.declared_s = max(before, seconds)
    try:
        yield
    finally:
        PROCESS.declared_s = before
