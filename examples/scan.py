"""A planner scans back and forth and hands the controller its own function of time.

python examples/scan.py [--cycles 3] [--frequency 0.25]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

import hystmpc
from hystmpc.sim import Effects, SimulatedPlant

CENTRE_DEG, AMPLITUDE_DEG = 58.0, 15.0


def run(cycles: float, frequency_hz: float) -> tuple[float, float]:
    """Scan once; RMSE and greatest error [deg] of the tip angle without sensor noise."""
    simulator = hystmpc.load_simulator("builtin:tendon-catheter")
    device = SimulatedPlant(simulator, Effects(lag_s=0.08, noise_deg=0.15), seed=1)
    tip = hystmpc.TipController.from_config(Path(__file__).with_name("tip.yaml"))
    y, errors = device.reset(), []
    with threadpool_limits(limits=1):
        tip.set_target(CENTRE_DEG)
        while not tip.state().settled:
            y = device.apply(tip.step(y).u)
        tip.set_reference(lambda t: CENTRE_DEG + AMPLITUDE_DEG * np.sin(2.0 * np.pi * frequency_hz * t))
        for _ in range(round(cycles / frequency_hz / tip.dt)):
            y = device.apply(tip.step(y).u)
            errors.append(device.true_angle - tip.state().reference_deg)
        tip.stop()
    return float(np.sqrt(np.mean(np.square(errors)))), float(np.max(np.abs(errors)))


def main() -> None:
    """Print the errors."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cycles", type=float, default=3.0, help="periods")
    parser.add_argument("--frequency", type=float, default=0.25, help="periods a second [Hz]")
    arguments = parser.parse_args()
    rmse, worst = run(arguments.cycles, arguments.frequency)
    print(f"scan at {arguments.frequency:g} Hz: RMSE {rmse:.2f} deg, greatest error {worst:.2f} deg")


if __name__ == "__main__":
    main()
