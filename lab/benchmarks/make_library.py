"""Generator of the identified models in the package: `auto.yaml`, `backlash.yaml`, `pi.yaml`, `lstm.onnx`.

    python lab/benchmarks/make_library.py [--out FOLDER] [--updates 4000]

The trials are simulated: the excitations of RA-L 2024, PMC11633443 (S2), sent to the shipped tendon catheter with the
lag and the sensor noise of `hystmpc demo`. Everything is seeded; the same machine makes the same files.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from kit import asked
from rich.progress import Progress

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.metadata import DeviceLimits, Range
from hystmpc.models.identify.simulators import identify
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.kinds.networks import LSTM
from hystmpc.models.kinds.operator_kinds import AutoKind
from hystmpc.models.load import library_file
from hystmpc.models.networks.settings import NetworkSettings, StreamTraining
from hystmpc.models.simulator import load_simulator, save_simulator
from hystmpc.models.train.networks import fit_network, network_bundle
from hystmpc.sim.plants.simulated import Effects, SimulatedPlant
from hystmpc.trajectories import Trajectory, sample
from hystmpc.trajectories.excitation import s2_point_to_point, s2_sinusoid
from hystmpc.trials.trial import Trial, Units

LIBRARY = Path(__file__).resolve().parents[2] / "models" / "library"
FREQUENCIES_HZ = (0.1, 0.2, 0.4, 0.5)
OFFSETS = ("0BL", "MidBL", "EndBL")
POINT_TO_POINT = 6
EFFECTS = Effects(lag_s=0.08, noise_deg=0.15)


def excitations() -> dict[str, Trajectory]:
    """Commands of the trials: S2's training sinusoids and some of its point-to-point motions."""
    sinusoids = {f"sinusoid_{f:g}hz_{o}": s2_sinusoid(f, o) for f in FREQUENCIES_HZ for o in OFFSETS}
    return sinusoids | {f"point_to_point_{seed}": s2_point_to_point(seed) for seed in range(POINT_TO_POINT)}


def recorded(name: str, excitation: Trajectory, seed: int) -> Trial:
    """Record one simulated trial from the rest after the initialisation flexure."""
    device = load_simulator(library_file("tendon-catheter"))
    plant = SimulatedPlant(device, EFFECTS, seed=seed)
    t, command = sample(excitation, 1 / plant.dt)
    limits = device.command_limits
    sent = np.clip(command, limits.lower, limits.upper)
    angle = [plant.reset(), *(plant.apply(u) for u in sent[1:])]
    return Trial(t, sent, np.array(angle), units=Units(device.command_unit), source=name)


def settings(updates: int) -> NetworkSettings:
    """Settings of the training `stacked`, without a teacher, since these trials already hold and repeat."""
    stacked = LSTM.settings["stacked"]
    way = stacked.training
    if not isinstance(way, StreamTraining):
        raise TypeError(f"training stacked trains by {way.scheme}, expected streams")
    training = way.model_copy(update={"updates": updates, "teacher": None})
    return stacked.model_copy(update={"validation_trials": 3, "training": training})


def main() -> None:
    """Simulate the trials, identify, write."""
    arguments = asked(__doc__, out=LIBRARY, updates=4000)
    trials = [recorded(name, motion, seed) for seed, (name, motion) in enumerate(excitations().items())]
    device = load_simulator(library_file("tendon-catheter"))
    limits = DeviceLimits(Range(lower=0.0, upper=6.0), device.command_rate_per_s)
    for kind in ("backlash", "pi"):
        simulator, fit = identify(kind, trials, limits=limits)
        save_simulator(simulator, arguments.out / f"{kind}.yaml")
        print(f"{kind}: {fit.rmse_deg:.3f} deg on {len(trials)} trials")
    found = AutoKind().fit(trials, FitRequest(limits=limits))
    if found.simulator is not None:
        save_simulator(found.simulator, arguments.out / "auto.yaml")
    print(f"auto: {found.report}")
    chosen = settings(arguments.updates)
    with Progress() as bar:
        task = bar.add_task("lstm", total=chosen.steps)
        trained = fit_network(trials, chosen, lambda done, _: bar.update(task, completed=done))
    report = export_onnx(network_bundle(trained, trials, limits), arguments.out / "lstm.onnx")
    print(f"lstm: {trained.validation_rmse_deg:.3f} deg on held-out trials; {report}")


if __name__ == "__main__":
    main()
