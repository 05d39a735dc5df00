"""Compilation is told: from its beginning, with an honest total, and not at all where compiled code is on disk."""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.kernels.compiling import (
    PROCESS,
    WORTH_TELLING_S,
    Compilation,
    Meter,
    about,
    cost,
    expecting,
    joint,
    sentence,
    watching,
)

KERNEL = """
from hystmpc.models.kernels.numba_ import njit

@njit(cache=True)
def inner(x):
    return 2.0 * x

@njit(cache=True)
def outer(x):
    return inner(x) + 1.0
"""


@dataclass
class Clock:
    """Time that only goes on where a test says so."""

    now: float = 0.0

    def __call__(self) -> float:
        return self.now


def compiled(meter: Meter, clock: Clock, sizes: Sequence[int], slow: float, first: int = 0) -> None:
    """A function that calls the next one of some sizes, and so on, on a machine slower by a factor."""
    meter.begins(first, "module", sizes[0])
    clock.now += 0.5 * slow * cost(sizes[0])
    if len(sizes) > 1:
        compiled(meter, clock, sizes[1:], slow, first + 1)
    clock.now += 0.5 * slow * cost(sizes[0])
    meter.ends()


SIZES = st.lists(st.lists(st.integers(20, 40_000), min_size=1, max_size=4), min_size=1, max_size=8)


@given(sizes=SIZES, slow=st.floats(0.3, 3.0))
def test_the_total_is_honest_from_the_first_second_on(sizes: list[list[int]], slow: float) -> None:
    """Every kernel that is defined is compiled: told is at most the machine's factor apart, and 20 % for later ones."""
    clock, told = Clock(), list[tuple[float, Compilation]]()
    meter = Meter(clock, [lambda found: told.append((clock.now, found))])
    for k, group in enumerate(sizes):
        for j, size in enumerate(group):
            meter.defined(10 * k + j, f"module {k}", size, stored=False)
    for k, group in enumerate(sizes):
        compiled(meter, clock, group, slow, 10 * k)
    whole = clock.now
    apart = 1.2 * max(slow, 1 / slow) + 1e-9
    assert whole == pytest.approx(slow * sum(cost(size) for group in sizes for size in group))
    for now, found in told:
        assert found.done_s == pytest.approx(now)
        assert whole / apart <= found.total_s <= apart * whole
    assert not told[-1][1].busy
    assert told[-1][1].total_s == pytest.approx(whole)


@given(declared=st.floats(20.0, 200.0), share=st.floats(0.0, 1.0))
def test_a_declared_total_counts_less_what_is_on_disk(declared: float, share: float) -> None:
    """A search that makes its kernels as it goes: what was loaded is not waited for."""
    meter = Meter(Clock())
    meter.declared_s = declared
    size, stored = 1000, 0
    while stored * cost(size) < share * declared - cost(size):
        meter.loaded(stored, "module", size)
        stored += 1
    meter.begins(-1, "module", size)
    assert meter.now.total_s == pytest.approx(max(declared - stored * cost(size), cost(size)))


def test_functions_of_a_module_that_is_on_disk_are_not_waited_for() -> None:
    """An earlier run has compiled what it needed of a module; the rest of it is needed no more than then."""
    meter = Meter(Clock())
    for k in range(50):
        meter.defined(k, "warm", 1000, stored=k == 0)
    meter.begins(99, "new", 20)
    assert meter.now.total_s == pytest.approx(cost(20))


@pytest.fixture
def quiet() -> Meter:
    return Meter(Clock())


def test_without_an_observer_the_log_gets_one_line(quiet: Meter, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        compiled(quiet, quiet.clock, [100], 1.0)  # type: ignore[arg-type]
        assert caplog.records == []
        for k in range(2):
            compiled(quiet, quiet.clock, [95_000], 1.0, k)  # type: ignore[arg-type]
    assert [record.message for record in caplog.records] == ["compiling, first use only, about 20 s"]
    assert cost(95_000) > WORTH_TELLING_S > cost(100)


def test_with_an_observer_the_log_gets_none(quiet: Meter, caplog: pytest.LogCaptureFixture) -> None:
    quiet.observers.append(lambda found: None)
    with caplog.at_level(logging.WARNING):
        quiet.begins(0, "module", 95_000)
    assert caplog.records == []


def imported(folder: Path) -> ModuleType:
    """The kernels as a new process finds them."""
    file = folder / "tiny.py"
    if not file.exists():
        file.write_text(KERNEL)
    spec = importlib.util.spec_from_file_location("tiny", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_first_call_is_told_and_a_call_with_its_code_on_disk_is_not(tmp_path: Path) -> None:
    told: list[Compilation] = []
    with watching(told.append):
        assert imported(tmp_path).outer(2.0) == 5.0
    first = list(told)
    assert [found.busy for found in first] == [True] * (len(first) - 1) + [False]
    assert len(first) == 3, "outer, inner within it, and the end"
    assert first[-1].done_s > first[0].done_s
    told.clear()
    with watching(told.append):
        assert imported(tmp_path).outer(3.0) == 7.0
    assert told == []


def test_what_a_search_declares_ends_with_it() -> None:
    before = PROCESS.declared_s

    @expecting(before + 150.0)
    def search() -> float:
        return PROCESS.declared_s

    assert search() == before + 150.0
    with pytest.raises(ZeroDivisionError), expecting(before + 1.0):
        raise ZeroDivisionError
    assert PROCESS.declared_s == before


def test_of_several_processes_the_longest_is_waited_for() -> None:
    found = joint([Compilation(3.0, 9.0, True), Compilation(2.0, 30.0, True), Compilation(5.0, 90.0, False)])
    assert found == Compilation(2.0, 30.0, True)
    assert not joint([Compilation(1.0, 1.0, False)]).busy


@given(seconds=st.floats(0.0, 5000.0))
def test_about(seconds: float) -> None:
    number, unit = about(seconds).split()
    value = float(number) * {"s": 1.0, "min": 60.0}[unit]
    assert abs(value - seconds) <= max(0.25 * seconds, 1.0)
    assert sentence(seconds) == f"compiling, first use only, about {number} {unit}"
