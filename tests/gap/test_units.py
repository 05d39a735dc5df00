"""Free of units: a device logged in other units gets the same verdict, names and shares, and sizes in its own units."""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hystmpc.gap.diagnose import conclude, detectable_in_logs, find_causes
from hystmpc.gap.diagnosis import Diagnosis
from hystmpc.gap.report.folder import save_diagnosis
from hystmpc.gap.report.report_data import ReportData
from hystmpc.gap.report.words import detectable_sentence
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.decades import Decades
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.models.simulator import Residual, Simulator
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial, Units

from ..models.zoo import BACKLASH
from .engine_examples import moves, simulator_of, sine, trials_of

HOLDS = (moves(1, 20.0, 3.0), sine(0.1), moves(2, 20.0, 1.0), moves(3, 20.0, 4.0))
CREEP = Creep((0.15,), (3.0,))
FORM = Residual(log="other.csv", motion="continuous", samples=500, rmse_deg=0.1, bias_deg=0.0, lag_one=0.5)
OTHER = (25.4, 1e-3), (1e3, 1e3), (0.04, 1e-6)
"""Units of command and output of the usual device in one unit of another log."""


def relogged(trial: Trial, command: float, angle: float) -> Trial:
    """The same trial in other units: the command in bar, the output in N."""
    units = Units("bar", "N", inverse=False)
    return Trial(trial.t, command * trial.command, angle * trial.angle, units=units, source=trial.source)


def rescaled(simulator: Simulator, command: float, angle: float) -> Simulator:
    """The same simulator for logs in other units."""

    def times(ends: Range, factor: float) -> Range:
        return Range(lower=factor * ends.lower, upper=factor * ends.upper)

    own = simulator.identification
    residuals = [r.model_copy(update={"rmse_deg": angle * r.rmse_deg}) for r in own.residuals]
    return replace(
        simulator,
        chain=Decades(command, angle).log_chain(simulator.chain),
        command_unit="bar",
        angle_unit="N",
        inverse=False,
        command_limits=times(simulator.command_limits, command),
        command_rate_per_s=command * simulator.command_rate_per_s,
        trained_command=times(simulator.trained_command, command),
        trained_angle_deg=times(simulator.trained_angle_deg, angle),
        trained_rate_per_s=command * simulator.trained_rate_per_s,
        identification=own.model_copy(update={"residuals": tuple(residuals)}),
    )


@functools.cache
def diagnosed(
    command: float, angle: float, only: tuple[str, ...] | None = None, before: tuple[Operator, ...] = (CREEP,)
) -> tuple[Diagnosis, ReportData]:
    """The diagnosis of a device with effects, logged in units of which its usual ones hold so many."""
    trials, simulator = trials_of(Chain(BACKLASH, before), list(HOLDS)), simulator_of(BACKLASH, (FORM,))
    if (command, angle) != (1.0, 1.0):
        trials, simulator = [relogged(t, command, angle) for t in trials], rescaled(simulator, command, angle)
    return conclude(find_causes(trials, simulator, seed=3, only=only))


def sizes(diagnosis: Diagnosis) -> list[float]:
    """Every number of a diagnosis that is in the unit of the output."""
    gap = diagnosis.gap
    found = [gap.nominal_rmse_deg, gap.retuned_rmse_deg, gap.with_effects_rmse_deg, gap.floor_rmse_deg]
    found += [v for effect in diagnosis.effects for v in (effect.rmse_before_deg, effect.rmse_after_deg)]
    assert diagnosis.detectable is not None
    return [*found, *diagnosis.retuned["offset"], diagnosis.detectable.needed_rmse_deg]


def assert_the_same(command: float, angle: float, only: tuple[str, ...] | None) -> None:
    usual, other = (diagnosed(*units, only)[0] for units in ((1.0, 1.0), (command, angle)))
    assert (other.verdict, other.ambiguity) == (usual.verdict, usual.ambiguity)
    assert [effect.name for effect in other.effects] == [effect.name for effect in usual.effects]
    assert [name for name, _ in other.ranking] == [name for name, _ in usual.ranking]
    assert other.gap.closed_share == pytest.approx(usual.gap.closed_share, abs=0.01)
    np.testing.assert_allclose(sizes(other), np.multiply(angle, sizes(usual)), rtol=0.02)
    widths, gains = (np.divide(other.retuned[name], usual.retuned[name]) for name in ("backlash_width", "gain"))
    np.testing.assert_allclose((*widths, *gains), (command, command, angle / command, angle / command), rtol=0.02)
    for effect, same in zip(other.effects, usual.effects, strict=True):
        assert effect.units == same.units  # creep has seconds and a share, which no unit changes
        np.testing.assert_allclose(list(effect.parameters.values()), list(same.parameters.values()), rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("command", "angle"), OTHER)
def test_a_diagnosis_is_free_of_units(command: float, angle: float) -> None:
    assert_the_same(command, angle, ("creep", "lag"))


@pytest.mark.slow
@pytest.mark.parametrize(("command", "angle"), OTHER)
def test_the_whole_library_is_free_of_units(command: float, angle: float) -> None:
    assert_the_same(command, angle, None)


@pytest.mark.slow
def test_files_and_page_carry_the_unit(tmp_path: Path) -> None:
    _, evidence = diagnosed(1.0, 1e-3, ("creep", "lag"))
    folder = save_diagnosis(evidence, tmp_path / "out", {})
    written = json.loads((folder / "diagnosis.json").read_text(encoding="utf-8"))
    assert written["unit"] == written["detectable"]["unit"] == "N"
    (read,) = read_trials([folder / "log.csv"])
    assert read.units == Units("bar", "N", inverse=False)
    page = (folder / "report.html").read_text(encoding="utf-8").partition("</style>")[2]
    assert " N" in page
    assert " deg" not in page
    assert "[deg" not in page


def test_what_logs_would_show_has_the_units_of_the_logs() -> None:
    def shown(simulator: Simulator, trials: Sequence[Trial]) -> dict[str, tuple[float, str]]:
        return {one.effect: (one.size, one.unit) for one in detectable_in_logs(trials, simulator).effects}

    simulator, trials = simulator_of(BACKLASH, (FORM,)), trials_of(Chain(BACKLASH), list(HOLDS))
    command, angle = 25.4, 1e-3
    usual = shown(simulator, trials)
    other = shown(rescaled(simulator, command, angle), [relogged(trial, command, angle) for trial in trials])
    units = {"slack": ("bar", command), "trial_shift": ("N", angle), "drift": ("N/min", angle), "lag": ("s", 1.0)}
    for effect, (unit, factor) in units.items():
        assert other[effect] == (pytest.approx(factor * usual[effect][0], rel=0.02), unit)


def test_the_least_sizes_are_said_in_the_unit_of_the_log() -> None:
    diagnosis, _ = diagnosed(1.0, 1e-3, ("creep", "lag"))
    assert diagnosis.detectable is not None
    assert f"{diagnosis.detectable.needed_rmse_deg:.3g} N RMS" in detectable_sentence(diagnosis.detectable)
