"""Fault injection and endurance, in their smallest honest versions."""

from __future__ import annotations

import math

import pytest

from hystmpc.ctrl import CommandLimits, Source

from ..scripts import script


@pytest.mark.slow
def test_faults_neither_raise_nor_leave_the_limits() -> None:
    faults = script("faults")
    tallies = faults.run(300 * len(faults.CONTROLLERS), seed=3)
    for name, tally in tallies.items():
        assert (name, tally.exceptions, tally.violations) == (name, 0, 0), tally.first_exception
        assert tally.steps == 300
    assert {source for tally in tallies.values() for source in tally.sources} == set(map(str, Source))


@pytest.mark.slow
def test_endurance_counts_what_it_says() -> None:
    endure = script("endurance").endure
    settings = {"model": "builtin:backlash", "controller": {"kind": "linearised_mpc"}}
    run = endure(settings, 1e-3, 60, False)
    assert (run.misses, run.steps, sum(run.sources.values())) == (0, 60, 60)
    assert run.greatest_s >= run.p99_s >= run.median_s > 0
    assert endure(settings, 1e7, 20, False).misses == 20
    assert endure(settings, 1e7, 20, True).misses == 20


@pytest.mark.parametrize("u", [math.nan, math.inf, -0.1, 6.1, 3.9, 2.1])
def test_commands_beyond_the_limits_are_counted(u: float) -> None:
    violates = script("faults").violates
    limits = CommandLimits(0.0, 6.0, 20.0)
    assert violates(limits, u, 3.0, 0.04)
    assert not violates(limits, 3.0 + 20.0 * 0.04, 3.0, 0.04)
