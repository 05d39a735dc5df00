"""Trained inverse maps as feedforward: their memory beside the model's, closed loops, and files that are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.models.chain import Chain
from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import load_onnx
from hystmpc.models.contract.metadata import Range
from hystmpc.models.evaluate import Errors, TrialEvaluation, evaluation_json
from hystmpc.models.inverse.inverses import MappedPredictor, TrainedInverse
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.models.play_kernel.fit import PlayKernelKind
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.simulator import ChainModel, Identification, Simulator, save_simulator, simulator_bundle
from hystmpc.sim.config import SimulationConfig
from hystmpc.sim.study import prepare, run_closed_loop
from hystmpc.trials.errors import ModelError
from hystmpc.trials.trial import Trial

from .lstm_examples import decaying_trial
from .zoo import BACKLASH, DT, simulator

pytestmark = pytest.mark.slow

SCAN = {
    "kind": "scan_sinusoid",
    "start_deg": 35.0,
    "centre_deg": 55.0,
    "amplitude_deg": 15.0,
    "frequency_hz": 0.1,
    "cycles": 2.0,
}


def recorded() -> list[Trial]:
    """Free runs of the backlash plant over scans of three amplitudes, as trials."""
    trials = []
    plant = ChainModel(simulator(Chain(BACKLASH)))
    for k, (amplitude, middle) in enumerate(((2.8, 3.0), (2.0, 2.7), (1.4, 3.2))):
        t = np.arange(0.0, 24.0, DT)
        rise = np.minimum(t / 2.0, 1.0)
        command = rise * (middle + amplitude * np.exp(-0.04 * t) * np.sin(2 * np.pi * 0.25 * t))
        trials.append(Trial(t, command, plant.run(command, 29.0), source=f"trial {k}"))
    return trials


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The plant, its play-kernel model, the trained inverse map, a line in its place, and a map of bar."""
    folder = tmp_path_factory.mktemp("inverse")
    save_simulator(simulator(Chain(BACKLASH)), folder / "plant.yaml")
    export_onnx(PlayKernelKind().fit(recorded(), FitRequest(training="rate_independent")).bundle, folder / "model.onnx")
    found = PlayKernelKind().fit([t.swapped() for t in recorded()], FitRequest(training="rate_independent"))
    export_onnx(found.bundle, folder / "map.onnx")
    bar = PlayKernelKind().fit(
        [Trial(t.t, t.angle, t.command, units=type(t.units)("deg", "bar"), source=t.source) for t in recorded()],
        FitRequest(training="rate_independent"),
    )
    export_onnx(bar.bundle, folder / "bar.onnx")
    save_simulator(memoryless(), folder / "line.yaml")
    save_simulator(inverse_backlash(), folder / "operator.yaml")
    return {path.stem: str(path) for path in folder.iterdir()}


def memoryless() -> Simulator:
    """The line between the plant's two lines: a backlash without a gap."""
    slope = 0.5 * (BACKLASH.m_lo + BACKLASH.m_up)
    offset = 0.5 * (BACKLASH.m_lo * BACKLASH.c_lo + BACKLASH.m_up * BACKLASH.c_up)
    return simulator(Chain(Backlash(slope, slope, offset / slope, offset / slope)))


def inverse_backlash() -> Simulator:
    """The analytic inverse of the plant as an inverse map."""
    forward = simulator(Chain(BACKLASH))
    return Simulator(
        chain=Chain(BACKLASH.inverse(0.01)),
        dt_s=DT,
        command_unit="deg",
        angle_unit="mm",
        command_limits=Range(lower=20.0, upper=95.0),
        command_rate_per_s=200.0,
        trained_command=Range(lower=20.0, upper=95.0),
        trained_angle_deg=forward.trained_command,
        trained_rate_per_s=200.0,
        identification=Identification(method="chosen by hand"),
    )


def study(files: dict[str, str], inverse: str | None, **changes: Any) -> SimulationConfig:
    data: dict[str, Any] = {
        "plant": {"simulator": files["plant"]},
        "model": files["model"],
        "inverse": None if inverse is None else files[inverse],
        "motions": {"scan": SCAN},
        "controllers": {"inverse": {"kind": "inverse"}},
    }
    return SimulationConfig.parse(data | changes)


def scan_error(config: SimulationConfig) -> float:
    """Root mean square tracking error over the second cycle [deg]."""
    ready = prepare(config)
    (settings,) = config.controllers.values()
    run = run_closed_loop(ready.controller(settings), ready.plant, ready.motions["scan"])
    return float(np.sqrt(np.mean(run.error_deg[run.error_deg.size // 2 :] ** 2)))


def test_a_trained_inverse_tracks_where_a_line_cannot(files: dict[str, str]) -> None:
    """On a plant with a dead band of 7 deg: half of that at least for the line, a small part for the map."""
    trained, line = scan_error(study(files, "map")), scan_error(study(files, "line"))
    assert line > 2.0
    assert trained < 0.35 * line


def test_an_operators_inverse_map_serves_as_well(files: dict[str, str]) -> None:
    assert scan_error(study(files, "operator")) < 0.5


def test_without_a_file_the_models_own_inverse_is_used(files: dict[str, str]) -> None:
    assert scan_error(study(files, None)) < 1.0


def test_predictive_controllers_take_their_first_guess_from_it(files: dict[str, str]) -> None:
    config = study(files, "map", controllers={"mpc": {"kind": "linearised_mpc", "horizon": 8}})
    assert scan_error(config) < 1.0


def test_the_memory_is_in_the_state(files: dict[str, str]) -> None:
    """Branched states do not touch each other; the map has seen the model's angles, one for each command."""
    predictor, inverse = controller_model(load_onnx(files["model"]), load_onnx(files["map"])).predictive
    assert isinstance(predictor, MappedPredictor)
    assert isinstance(inverse, TrainedInverse)
    start = predictor.initial(45.0, 2.0)
    kept = start.copy()
    _, up = predictor.advance(start, 3.0)
    theta, down = predictor.advance(start, 1.0)
    np.testing.assert_array_equal(start, kept)
    assert inverse.command(up, 45.0, 2.0) < inverse.command(down, 45.0, 2.0) - 0.3  # from above and from below
    own, beside = predictor.parts(down)
    assert own.size + beside.size == down.size
    _, expected = predictor.inverse_map.advance(predictor.parts(start)[1][None], np.array([[theta]]))
    np.testing.assert_array_equal(beside, expected[0])


def test_predictions_are_the_models(files: dict[str, str]) -> None:
    model = load_onnx(files["model"])
    both, _ = controller_model(model, load_onnx(files["map"])).predictive
    alone, _ = controller_model(model).predictive
    plans = 3.0 + np.random.default_rng(0).normal(0, 0.5, (4, 6))
    mapped, state = both.initial(45.0, 2.0), alone.initial(45.0, 2.0)
    np.testing.assert_array_equal(both.rollout(mapped, plans), alone.rollout(state, plans))
    for got, expected in zip(both.linearise(mapped, plans[0]), alone.linearise(state, plans[0]), strict=True):
        np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize(("wanted", "end"), [(500.0, 6.0), (-500.0, 0.0)])
def test_commands_end_at_the_devices_limits(files: dict[str, str], wanted: float, end: float) -> None:
    model = load_onnx(files["model"])
    predictor, inverse = controller_model(model, load_onnx(files["map"])).predictive
    limits = model.metadata.command_limits
    expected = limits.upper if end else limits.lower
    assert inverse.command(predictor.initial(45.0, 2.0), wanted, 2.0) == expected


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ("model", r"maps mm to deg, a forward model; expected an inverse map, deg to mm"),
        ("bar", r"maps deg to bar, expected deg to mm"),
    ],
)
def test_a_file_that_is_no_inverse_of_the_model_is_refused(files: dict[str, str], wrong: str, text: str) -> None:
    with pytest.raises(ModelError, match=text) as caught:
        prepare(study(files, wrong))
    assert "\n" not in str(caught.value)


def test_another_sample_time_is_refused(files: dict[str, str], tmp_path: Path) -> None:
    slow = [Trial(2 * t.t, t.command, t.angle, source=t.source).swapped() for t in recorded()[:2]]
    export_onnx(PlayKernelKind().fit(slow, FitRequest(training="rate_independent")).bundle, tmp_path / "slow.onnx")
    with pytest.raises(ModelError, match=r"every 0\.08 s, expected every 0\.04 s as the model"):
        prepare(study({**files, "slow": str(tmp_path / "slow.onnx")}, "slow"))


def test_an_exported_simulator_is_a_forward_model(files: dict[str, str], tmp_path: Path) -> None:
    export_onnx(simulator_bundle(memoryless()), tmp_path / "line.onnx")
    with pytest.raises(ModelError, match="a forward model"):
        prepare(study({**files, "line": str(tmp_path / "line.onnx")}, "line"))


def test_errors_of_an_inverse_map_are_not_called_degrees() -> None:
    trial = decaying_trial(0.2, True, "log.csv").swapped()
    errors = Errors(0.1, 0.0, 0.1, 0.2, 0.01, 0.0)
    data = evaluation_json([TrialEvaluation(trial, trial.angle, 0, errors)])
    assert (data["format"], data["unit"]) == ("hystmpc-inverse-evaluation/1", "mm")
    assert not [key for row in (data["mean"], *data["trials"]) for key in row if "deg" in key]
