"""Comparison of LSTM presets with the play kernel, on simulated devices and by cross-validation on logs.

    python lab/benchmarks/lstm_presets.py [--devices tendon rod] [--models play_kernel lstm:best lstm:stacked]
                                      [--set network.plays=0 ...] [--seed 11]
    python lab/benchmarks/lstm_presets.py --logs LOG.csv ... [--models ...]

Ten trials of 60 s train a model, four further ones judge it: S2's sinusoids and ramps with holds (eq. (9)-(11)) at
25 Hz with 0.15 deg of noise. A linearised MPC then follows a point-to-point motion with holds and scans of 0.2 and
0.6 Hz. All of this is simulated. `--set` changes settings of the networks, for ablations. With `--logs` every log is
predicted by a model that was identified on the others, exported and loaded again.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from kit import asked

from hystmpc.models.contract.export import ExportBundle, export_onnx
from hystmpc.models.contract.load import load_onnx
from hystmpc.models.contract.metadata import DeviceLimits, Range
from hystmpc.models.evaluate import evaluate, free_run
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.kinds.networks import NetworkKind
from hystmpc.models.networks.settings import NetworkSettings
from hystmpc.models.train.networks import fit_network, network_bundle
from hystmpc.sim.config import PlantSettings, SimulationConfig
from hystmpc.sim.plants.device import make_plant
from hystmpc.sim.study import prepare, run_closed_loop
from hystmpc.trajectories.excitation import s2_point_to_point, s2_sinusoid
from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial, resample
from hystmpc.trials.types import Vec

DT_S, DURATION_S, NOISE_DEG = 0.04, 60.0, 0.15
RETURN_MM_PER_S = 3.0
LIMITS = DeviceLimits(Range(lower=0.0, upper=6.0), 12.0)
HELD_S = 60.0


Fit = Callable[[Sequence[Trial]], ExportBundle]


def overridden(settings: NetworkSettings, changes: Sequence[str]) -> NetworkSettings:
    """Settings with changes of the form `a.b=value`."""
    data = settings.model_dump()
    for change in changes:
        key, _, value = change.partition("=")
        *parents, leaf = key.split(".")
        node = data
        for parent in parents:
            node = node[parent]
        node[leaf] = yaml.safe_load(value)
    return NetworkSettings.parse(data, "--set")


def of_kind(name: str, training: str, changes: Sequence[str]) -> Fit:
    """Identification settings of a kind; trainings of networks may be changed."""
    kind = kind_named(name)
    if isinstance(kind, NetworkKind):
        settings = overridden(kind.settings[training], changes)
        return lambda trials: network_bundle(fit_network(trials, settings), trials)
    asked_for = FitRequest(training=training if training in kind.trainings else kind.trainings[0], plays=10)
    return lambda trials: kind.fit(trials, asked_for).bundle


def left_out(logs: Sequence[Trial], model: str, changes: Sequence[str], folder: Path) -> str:
    """Row of the table over logs: mean errors of whole trials and from the first reversal on, and the hold drift."""
    kind, _, preset = model.partition(":")
    fit, rows = of_kind(kind, preset or "best", changes if preset else ()), []
    for k, log in enumerate(logs):
        export_onnx(fit([other for i, other in enumerate(logs) if i != k]), folder / "model.onnx")
        opened = load_onnx(folder / "model.onnx")
        whole, later = (evaluate(opened, log, skip_first_flexure=skip).errors for skip in (False, True))
        pairs = [(e.rmse_deg, e.offset_free_rmse_deg) for e in (whole, later)]
        rows.append([*pairs[0], *pairs[1], later.hold_drift_deg])
    return " | ".join([model, " ".join(changes), *(f"{value:.3g}" for value in np.mean(rows, axis=0))])


def filled(motions: Sequence[Trajectory]) -> Vec:
    """Commands of consecutive motions, joined by ramps, 60 s in total."""
    parts = [np.zeros(1)]
    for motion in motions:
        commands = np.clip(motion(np.arange(0.0, motion.duration_s, DT_S)), 0.0, 6.0)
        gap = abs(commands[0] - parts[-1][-1])
        steps = 1 + int(gap / (RETURN_MM_PER_S * DT_S))
        parts += [np.linspace(parts[-1][-1], commands[0], steps + 1)[1:], commands]
    return np.concatenate(parts)[: round(DURATION_S / DT_S)]


def motions_of(seed: int) -> tuple[list[Vec], list[Vec]]:
    """Commands of ten training trials and of four held-out trials."""
    sines = [(0.1, "0BL"), (0.2, "0BL"), (0.4, "MidBL"), (0.5, "0BL"), (0.2, "EndBL")]
    training = [filled([s2_sinusoid(f, offset)] * 5) for f, offset in sines]  # type: ignore[arg-type]
    training += [filled([s2_point_to_point(seed + 2 * k + j) for j in (0, 1)]) for k in range(5)]
    left_out = [filled([s2_sinusoid(f, offset)] * 5) for f, offset in ((0.3, "0BL"), (0.15, "MidBL"))]  # type: ignore[arg-type]
    left_out += [filled([s2_point_to_point(seed + 100 + 2 * k + j, "test") for j in (0, 1)]) for k in range(2)]
    return training, left_out


def recorded(device: str, commands: Sequence[Vec], seed: int) -> list[Trial]:
    """Record one trial a motion, each from the rest after an initialisation flexure, with different noise."""
    trials = []
    for k, motion in enumerate(commands):
        plant = make_plant(PlantSettings(device=device, noise_deg=NOISE_DEG), DT_S, seed=seed + k)
        angle = [plant.reset(), *(plant.apply(float(u)) for u in motion[1:])]
        trials.append(Trial(DT_S * np.arange(motion.size), motion, np.array(angle), source=f"{device} {seed + k}"))
    return trials


def closed_loops(device: str, model: Path, trials: Sequence[Trial], seed: int) -> list[float]:
    """RMSE of the true angle along the motions [deg]."""
    low, high = np.percentile(np.concatenate([t.angle for t in trials]), [5, 95])
    middle, swing = 0.5 * (low + high), 0.3 * (high - low)
    rest = float(np.mean([t.angle[0] for t in trials]))
    targets = [middle + share * swing for share in (0.0, -1.0, 1.0, 0.6, -0.2, 0.2, -0.7)]
    speed = {"velocity_deg_s": 30, "acceleration_deg_s2": 200, "jerk_deg_s3": 3000}
    scan = {"kind": "scan_sinusoid", "start_deg": rest, "centre_deg": middle, "amplitude_deg": 0.8 * swing}
    moves: dict[str, Any] = {"kind": "point_to_point", "start_deg": rest, "targets_deg": targets}
    motions = {
        "moves": moves | {"holds_s": [3.0] * len(targets), "limits": speed},
        "scan": scan | {"frequency_hz": 0.2, "cycles": 4},
        "fast": scan | {"frequency_hz": 0.6, "cycles": 10},
    }
    estimator = {
        "drift_sigma_deg_per_sqrt_s": 0.3,
        "motion_sigma_deg_per_sqrt_unit": 1.5,
        "dead_band_gain_deg_per_unit": 0,
    }
    data: dict[str, Any] = {
        "plant": {"device": device, "noise_deg": NOISE_DEG},
        "model": str(model),
        "motions": motions,
        "controllers": {"mpc": {"kind": "linearised_mpc", "estimator": estimator, "weights": {"rate": 3}}},
        "seed": seed,
    }
    study = prepare(SimulationConfig.parse(data, "benchmark"))
    controller = study.controller(study.config.controllers["mpc"])
    return [
        float(np.sqrt(np.mean(run_closed_loop(controller, study.plant, study.motions[name]).error_deg ** 2)))
        for name in motions
    ]


def row(device: str, model: str, changes: Sequence[str], seed: int, folder: Path) -> str:
    """Row of the table."""
    training, left_out = motions_of(seed)
    trials, judges = recorded(device, training, seed), recorded(device, left_out, seed + 50)
    kind, _, preset = model.partition(":")
    start, own = time.perf_counter(), time.process_time()
    bundle = of_kind(kind, preset or "best", changes if preset else ())(trials)
    seconds, own = time.perf_counter() - start, time.process_time() - own
    facts = bundle.metadata.model_copy(update={"command_limits": LIMITS.command, "command_rate": LIMITS.rate_per_s})
    path = folder / "model.onnx"
    export_onnx(ExportBundle(bundle.graph, facts, bundle.reference, bundle.probe), path)
    opened = load_onnx(path)
    errors = [evaluate(opened, trial).errors for trial in judges]
    commands = np.concatenate([judges[2].command[:1000], np.full(round(HELD_S / DT_S) + 25, 3.3)])
    held = free_run(opened, commands, float(judges[2].angle[0]))[1025:]
    loops = closed_loops(device, path, trials, seed)
    figures = [seconds, own, *(np.mean([getattr(e, n) for e in errors]) for n in ("rmse_deg", "offset_free_rmse_deg"))]
    cells = [f"{value:.1f}" for value in figures[:2]] + [f"{value:.3f}" for value in figures[2:]]
    return " | ".join([device, model, " ".join(changes), *cells, f"{np.ptp(held):.1g}", *(f"{e:.3f}" for e in loops)])


def main() -> None:
    given = asked(
        __doc__,
        devices={"nargs": "+", "default": ["tendon", "rod"]},
        models={"nargs": "+", "default": ["play_kernel", "lstm:best", "lstm:stacked"]},
        logs={"nargs": "*", "default": [], "help": "recorded at 25 Hz"},
        set={"nargs": "*", "default": [], "metavar": "KEY=VALUE"},
        seed=11,
    )
    if given.logs:
        logs = [resample(trial, 1 / DT_S) for trial in read_trials(given.logs)]
        print("model | changes | rmse | offset-free | rmse* | offset-free* | hold drift*; * from the first reversal on")
        with tempfile.TemporaryDirectory() as folder:
            for model in given.models:
                print(left_out(logs, model, given.set, Path(folder)), flush=True)
        return
    print("device | model | changes | wall s | cpu s | rmse | offset-free | drift 60 s | moves | scan 0.2 | scan 0.6")
    with tempfile.TemporaryDirectory() as folder:
        for device in given.devices:
            for model in given.models:
                print(row(device, model, given.set, given.seed, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
