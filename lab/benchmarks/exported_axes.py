"""Time of a step of two axes over that of one, in the exported C and in Python.

    python lab/benchmarks/exported_axes.py [--steps 1000] [--repetitions 7] [--case NAME]

Controllers of two axes and of each of both axes alone follow the same motions (holds, ramps, sines) on devices that are
the model, with a noise of 0.1 deg. A C program takes the recorded steps again, see `exported_c.py`: of every step the
least of some times counts. Python's times are processor time of the thread. A ratio is the mean time of the two axes
over the mean of both single axes. The bar is 3.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from time import thread_time
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from exported_c import FLAGS, Recorder, replay
from kit import asked, show
from numpy.typing import NDArray

from hystmpc.codegen import export_controller
from hystmpc.ctrl.config import parse_controller
from hystmpc.ctrl.planner.settings import assemble, read_settings
from hystmpc.ctrl.two_axes.guarded import TwoAxisController
from hystmpc.models.simulator import save_simulator
from hystmpc.models.two_axes.model import TwoAxisModel
from hystmpc.sim.plants.simulated import SimulatedPlant
from hystmpc.sim.two_axes.config import TwoAxisPlantSettings
from hystmpc.sim.two_axes.plant import TwoAxisPlant
from tests.codegen.plane_loops import in_plane
from tests.codegen.test_two_axes import CASES, JOINED, NOISY, PLAIN, TENDONS, TURNED

Vec = NDArray[np.float64]
BAR, _SIZE_DEG, _NOISE_DEG = 3.0, 14.0, 0.1
LEARNS: Mapping[str, Any] = {"kind": "linearised_mpc"}
MODELS: Mapping[str, tuple[TwoAxisModel, Mapping[str, Any]]] = {
    "independent axes": (CASES["no-sensor"][0], PLAIN),
    "turned tendons and sensor": (TURNED, PLAIN),
    "turned, learning": (TURNED, LEARNS),
    "shared friction": (JOINED, PLAIN),
    "shared friction, learning": (JOINED, LEARNS),
    "shared friction, learning, noise of the file": (NOISY, LEARNS),
    "four tendons, learning": (TENDONS, LEARNS),
}


def followed(controller: Any, c: Recorder, plant: Any, wanted: Vec, seed: int) -> float:
    """Mean time of a step in Python [us]; the C takes the same readings, and its calls are recorded."""
    random, y, held = np.random.default_rng(seed), plant.true_angle, plant.rest_command
    state, began = controller.init(y, held), 0.0
    c.init(y, held)
    count = len(wanted) - controller.horizon
    for k in range(count):
        seen, ahead = y + _NOISE_DEG * random.standard_normal(np.shape(y)), wanted[k : k + controller.horizon].copy()
        before = thread_time()
        command, state = controller.step(state, seen, ahead)
        began += thread_time() - before
        c.step(seen, c.vector(ahead))
        y = plant.apply(command.u)
    return 1e6 * began / count


def timed(settings: dict[str, Any], controller: Any, plant: Any, wanted: Vec, repetitions: int) -> tuple[float, float]:
    """Mean time of a step [us]: in a C program, and in Python."""
    export = export_controller(settings)
    with tempfile.TemporaryDirectory() as folder:
        c = Recorder(export, Path(folder), False, ["-O0"])  # no option changes a number
        python_us = followed(controller, c, plant, wanted, 3)
        times = replay(export, c.calls(), Path(folder), FLAGS, repetitions)
    return float(times.min(axis=0).mean()), python_us


def one(model: TwoAxisModel, given: Mapping[str, Any], steps: int, repetitions: int, folder: Path) -> Vec:
    """Mean times [us] (2, 2): of two axes and of one, in C and in Python."""
    settings = parse_controller(dict(given), "controller")
    both, plant = TwoAxisController(model, settings), TwoAxisPlant(model, TwoAxisPlantSettings(simulator="model"))
    wanted = in_plane(steps + both.horizon, both.dt, _SIZE_DEG, np.random.default_rng(1)) + plant.true_angle
    file = {"model": str(model.save(folder / "both.yaml")), "controller": dict(given)}
    times = [timed(file, both, plant, wanted, repetitions)]
    for i, (axis, (low, high, rate)) in enumerate(zip(model.axes, model.travel_limits(), strict=True)):
        file = {
            "model": str(save_simulator(axis, folder / f"{i}.yaml")),
            "controller": dict(given),
            "limits": {"lower": low, "upper": high, "rate_per_s": rate},
        }
        alone = assemble(read_settings(file)[0], Path()).controller
        device = SimulatedPlant(axis)
        device.reset()
        times.append(timed(file, alone, device, wanted[:, i] - wanted[0, i] + device.true_angle, repetitions))
    return np.array([times[0], np.mean(times[1:], axis=0)])


def main() -> None:
    """Print a table, and end with 1 where a ratio is above the bar."""
    given = asked(
        __doc__, steps=1000, repetitions=(7, "of the steps in the C program"),
        case={"choices": [*MODELS], "action": "append"},
    )  # fmt: skip
    rows, worst = [], 0.0
    for name in given.case or [*MODELS]:
        with tempfile.TemporaryDirectory() as folder:
            both, alone = one(*MODELS[name], given.steps, given.repetitions, Path(folder))
        ratios = both / alone
        worst = max(worst, float(ratios.max()))
        rows.append([name, *(f"{both[i]:.0f} / {alone[i]:.0f}" for i in range(2)), *(f"{r:.2f}" for r in ratios)])
        print(*rows[-1], flush=True)
    show(["model and controller", "C, two / one [us]", "Python, two / one [us]", "ratio in C", "in Python"], rows)
    print(f"greatest ratio {worst:.2f} (bar {BAR:g})")
    sys.exit(int(worst > BAR))


if __name__ == "__main__":
    main()
