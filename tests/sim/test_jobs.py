"""Jobs that cost nothing: in which order they are taken, what is counted, and what an error is."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from hystmpc.models.identify.chain_fit import no_result
from hystmpc.sim.jobs import InTurn, attempt, run_jobs
from hystmpc.trials.errors import ConfigError


def test_jobs_are_taken_as_they_are_needed_and_kept_ones_counted() -> None:
    taken: list[int] = []

    def endless() -> Iterator[int]:
        for k in range(10):
            taken.append(k)
            yield k

    told: list[tuple[float, float, str]] = []
    found = run_jobs(
        lambda k: k * k,
        endless(),
        InTurn(),
        is_done=lambda k: k < 3,
        total=10,
        progress=lambda done, total, note="": told.append((done, total, note)),
        note=str,
    )
    assert next(found) == 9
    assert taken == [0, 1, 2, 3]
    assert list(found) == [16, 25, 36, 49, 64, 81]
    assert told[0] == (4, 10, "9")
    assert told[-1] == (10, 10, "81")


def test_an_attempt_tells_errors_of_the_package_plainly_and_others_with_their_type() -> None:
    def raising(error: BaseException) -> Callable[[], int]:
        def call() -> int:
            raise error

        return call

    assert attempt(lambda: 3).value == 3
    assert attempt(lambda: 3).error == ""
    assert attempt(raising(ConfigError("two\nlines"))).error == "two lines"
    assert attempt(raising(KeyError("x"))).error == "KeyError: 'x'"
    with pytest.raises(KeyboardInterrupt):  # a fit that Ctrl-C has ended is no failed one: the study ends, too
        attempt(raising(no_result("the first core", interrupted=True)))
    assert attempt(raising(ConfigError(""))).value is None
    with pytest.raises(KeyboardInterrupt):
        attempt(raising(KeyboardInterrupt()))
