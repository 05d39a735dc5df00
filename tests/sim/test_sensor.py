"""Studies with another sensor than a continuous one: what controllers see, what they are told, what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.ctrl.config import CONTROLLERS
from hystmpc.ctrl.feedback import PidControllerSettings
from hystmpc.sim.compare import compare
from hystmpc.sim.config import SimulationConfig, load_simulation
from hystmpc.sim.results import load_results
from hystmpc.sim.study import ClosedLoopRun, prepare, run_closed_loop
from hystmpc.sim.tuning.gains import tuned_gains
from hystmpc.trials.errors import ConfigError

from .small import study

CAMERA = {"kind": "intermittent", "rate_hz": 5, "latency_s": 0.2, "jitter_s": 0.02, "dropout_share": 0.05}
ALL: dict[str, dict[str, Any]] = {kind: {"kind": kind} for kind in CONTROLLERS}
ALL["sampling_mpc"]["samples"] = 32
BLIND = {name: block for name, block in ALL.items() if "pid" not in name}


def runs(config: SimulationConfig) -> dict[str, ClosedLoopRun]:
    return {result.controller: result.run for result in compare(config).results}


def test_frames_as_dense_as_the_samples_and_never_late_are_a_continuous_sensor() -> None:
    """For controllers with the same weights; what follows from the kind of sensor by default is written out."""
    ideal = {"kind": "intermittent", "rate_hz": 25, "latency_s": 0}
    same = {"adaptation": None, "weights": {"rate": 3.0}, "hold": {"tolerance_deg": 0.03}}
    controllers = {"pid": ALL["pid"], "linearised_mpc": ALL["linearised_mpc"] | same}
    dense, plain = (runs(study(controllers=controllers, **block)) for block in ({"sensor": ideal}, {}))
    np.testing.assert_allclose(dense["pid"].log.command, plain["pid"].log.command, atol=1e-9)
    assert np.sqrt(np.mean((dense["linearised_mpc"].true_deg - plain["linearised_mpc"].true_deg) ** 2)) < 0.1


@pytest.mark.slow
def test_every_controller_follows_by_frames_and_again_as_before(tmp_path: Path) -> None:
    config = study(controllers=ALL, sensor={**CAMERA, "noise_deg": 0.2}, seed=3)
    found = compare(config, tmp_path / "run")
    for result in found.results:
        log = result.run.log
        shown = np.isfinite(log.measured_deg)
        assert 0 < shown.sum() < 0.3 * shown.size
        assert set(log.source) <= {"controller", "mpc"}, result.controller
        assert result.metrics.limit_violations == 0
    again = runs(load_simulation(tmp_path / "run" / "config.yaml"))
    for name, run in runs(config).items():
        np.testing.assert_array_equal(run.log.measured_deg, again[name].log.measured_deg)
        np.testing.assert_array_equal(run.log.command, again[name].log.command)
    read = load_results(tmp_path / "run")
    assert np.isnan(read.results[0].run.log.measured_deg).any()


def test_without_a_sensor_the_rest_of_the_plant_is_declared() -> None:
    noisy = {"simulator": "builtin:tendon-catheter", "noise_deg": 3.0}
    with_noise = runs(study(controllers=BLIND, sensor={"kind": "none"}, plant=noisy))
    quiet = runs(study(controllers=BLIND, sensor={"kind": "none"}))
    for name, run in with_noise.items():
        assert np.isnan(run.log.measured_deg).all()
        np.testing.assert_array_equal(run.log.command, quiet[name].log.command)


def test_controllers_are_told_of_the_sensor_where_they_do_not_say_something_else() -> None:
    sensor = {"kind": "intermittent", "rate_hz": 0.5, "latency_s": 1.5, "jitter_s": 0.1, "noise_deg": 0.4}
    own = {"kind": "linearised_mpc", "estimator": {"sensor_sigma_deg": 1.0, "longest_gap_s": 20.0}}
    blind = {"kind": "inverse", "estimator": {"sensor": "none"}}
    told = study(controllers={"plain": ALL["inverse"], "pid": ALL["pid"], "own": own, "blind": blind}, sensor=sensor)
    plain = told.controllers["plain"].estimator
    assert (plain.sensor, plain.oldest_frame_s, plain.longest_gap_s) == ("intermittent", 1.9, 11.9)
    assert told.controllers["pid"].estimator.sensor == "intermittent"
    assert told.controllers["own"].model_dump()["estimator"]["sensor_sigma_deg"] == 1.0
    assert told.controllers["own"].estimator.longest_gap_s == 20.0
    assert told.controllers["blind"].estimator.sensor == "none"
    ready = dict(study(controllers={"a": ALL["inverse"]}).controllers)
    assert study(controllers=ready, sensor=sensor).controllers["a"] == told.controllers["plain"]
    assert SimulationConfig.parse(told.model_dump(mode="json")) == told


@pytest.mark.parametrize(
    ("sensor", "block", "text"),
    [
        ({"kind": "none"}, {"kind": "pid"}, "got sensor none, expected continuous or intermittent"),
        (
            {"kind": "none"},
            {"kind": "inverse", "estimator": {"sensor": "continuous"}},
            "got continuous, expected none",
        ),
        (CAMERA, {"kind": "inverse", "estimator": {"sensor": "continuous"}}, "expected intermittent or none"),
        ({"kind": "none"}, {"kind": "linearised_mpc", "adaptation": {}}, "expected a sensor"),
        ({**CAMERA, "rate_hz": 500}, {"kind": "pid"}, "less than or equal to 100"),
        ({**CAMERA, "latency_s": 3}, {"kind": "pid"}, "less than or equal to 2"),
        ({**CAMERA, "latency": 3}, {"kind": "pid"}, "did you mean 'latency_s'"),
    ],
)
def test_contradictions_are_refused_in_one_line(sensor: dict[str, Any], block: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text) as error:
        study(controllers={"a": block}, sensor=sensor)
    assert "\n" not in str(error.value)


def test_gains_are_tuned_under_that_very_sensor() -> None:
    """The search begins with the error of the given gains under this sensor, on another realisation of the noise."""
    late = {"kind": "intermittent", "rate_hz": 5, "latency_s": 0.2, "noise_deg": 0.3}
    prepared = prepare(study(controllers={"pid": ALL["pid"]}, sensor=late, tune_pid={"evaluations": 12}, seed=5))
    settings, motion = prepared.config.controllers["pid"], prepared.motions["move"]
    assert isinstance(settings, PidControllerSettings)
    plant = prepared.plant.reseeded(6)
    law, approach_s = prepared.controller(settings), prepared.approach_s["move"]
    error = run_closed_loop(law, plant, motion, sensor=prepared.config.sensor, approach_s=approach_s).counted_deg
    assert tuned_gains(prepared, settings).start_rmse_deg == pytest.approx(float(np.sqrt(np.mean(error**2))))
