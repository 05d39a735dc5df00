"""Constraints of a tuning on the loop around its model."""

from __future__ import annotations

from typing import Any

import pytest

from hystmpc.ctrl.config import parse_controller
from hystmpc.sim.tuning.objective import loops_around, margin_penalty
from hystmpc.sim.tuning.settings import TuneSettings


def tuning(**more: Any) -> TuneSettings:
    """A tuning of a PID around a backlash with a lag."""
    base = {
        "plant": {"simulator": "builtin:backlash"},
        "model": "builtin:backlash",
        "actuator_lag_s": 0.08,
        "motions": {"scan": {"kind": "scan_sinusoid", "start_deg": 29, "centre_deg": 58, "amplitude_deg": 18,
                             "frequency_hz": 0.2, "cycles": 1}},
        "controllers": {"pid": {"kind": "pid"}},
    }  # fmt: skip
    return TuneSettings.parse({"base": base, "controller": "pid", **more})


def pid(ki: float) -> Any:
    return parse_controller({"kind": "pid", "gains": {"kp_per_deg": 0.01, "ki_per_deg_s": ki}}, "test")


def test_without_margins_nothing_is_added_and_older_searches_go_on() -> None:
    plain, wanted = tuning(), tuning(margins={"gain": 2.0})
    assert margin_penalty(plain, pid(30.0)) == 0.0
    assert plain.fingerprint != wanted.fingerprint
    assert tuning(margins=None).fingerprint == plain.fingerprint


@pytest.mark.parametrize(("ki", "missed"), [(0.2, 0), (30.0, 3)])
def test_each_constraint_that_is_not_kept_is_a_penalty(ki: float, missed: int) -> None:
    assert margin_penalty(tuning(margins={"penalty_deg": 7.0}), pid(ki)) == 7.0 * missed


def test_a_law_that_is_not_analysed_is_not_constrained() -> None:
    assert margin_penalty(tuning(margins={}), parse_controller({"kind": "inverse"}, "test")) == 0.0


def test_the_loops_of_a_tuning_are_around_its_model() -> None:
    analysis = loops_around(tuning(margins={"cycle_deg": 0.1}), {"given": pid(0.2), "tuned": pid(0.3)})
    assert [one.name for one in analysis.controllers] == ["given", "tuned"]
    assert [one.tolerance_deg for one in analysis.controllers] == [0.1, 0.1]
    assert analysis.device.lag_s == 0.08
