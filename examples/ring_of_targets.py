"""A planner visits a ring of targets with a pause at each, as an ablation around a pulmonary vein does (RA-L 2024).

    python examples/ring_of_targets.py [--targets 8] [--pause 1.0]

The catheter bends in one plane and is rolled about its axis. A ring of directions at angular radius rho around an axis
that lies theta_0 off the catheter's own needs, at the place psi along the ring, the bend and the roll

    cos theta = cos theta_0 cos rho - sin theta_0 sin rho cos psi
    tan roll  = sin rho sin psi / (sin theta_0 cos rho + cos theta_0 sin rho cos psi)

Rolling is left to the planner; the bend is the tip angle that the controller is given. The device is simulated: more
friction than the model knows, a lag, sensor noise.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import hystmpc
from hystmpc.sim import Effects, SimulatedPlant

AXIS_DEG, RADIUS_DEG = 58.0, 15.0
GIVE_UP_S = 5.0


@dataclass(frozen=True)
class Visit:
    """One target: roll and bend wanted [deg], time to settle [s], greatest error and command range in the pause."""

    roll_deg: float
    target_deg: float
    settled_s: float
    error_deg: float
    command_range: float


def ring(targets: int) -> list[tuple[float, float]]:
    """Roll and bend [deg] of equally spaced places along the ring."""
    axis, radius = math.radians(AXIS_DEG), math.radians(RADIUS_DEG)
    places = []
    for psi in 2.0 * math.pi * np.arange(targets) / targets:
        off = math.sin(radius) * math.cos(psi)
        bend = math.acos(math.cos(axis) * math.cos(radius) - math.sin(axis) * off)
        roll = math.atan2(math.sin(radius) * math.sin(psi), math.sin(axis) * math.cos(radius) + math.cos(axis) * off)
        places.append((math.degrees(roll), math.degrees(bend)))
    return places


def visit(
    tip: hystmpc.TipController, device: SimulatedPlant, y: float, roll_deg: float, bend_deg: float, pause_s: float
) -> tuple[Visit, float]:
    """Go to one target, wait until the tip has settled, pause there; the visit and the last measurement."""
    if not tip.set_target(bend_deg):
        raise SystemExit(f"target {bend_deg:.1f} deg: {tip.reachable(bend_deg).reason}")
    started = tip.state().time_s
    while not tip.state().settled and tip.state().time_s < started + GIVE_UP_S:
        y = device.apply(tip.step(y).u)
    settled = tip.state().time_s - started
    errors, commands = [], []
    for _ in range(round(pause_s / tip.dt)):
        command = tip.step(y)
        y = device.apply(command.u)
        errors.append(abs(device.true_angle - bend_deg))
        commands.append(command.u)
    return Visit(roll_deg, bend_deg, settled, max(errors), float(np.ptp(commands))), y


def run(targets: int, pause_s: float) -> list[Visit]:
    """Visit the whole ring on the simulated device."""
    device = SimulatedPlant(
        hystmpc.load_simulator("builtin:tendon-catheter"),
        Effects(lag_s=0.08, noise_deg=0.15, mismatch={"prandtl_ishlinskii.alpha": 1.2}),
        seed=1,
    )
    tip = hystmpc.TipController.from_config(Path(__file__).with_name("tip.yaml"))
    y, visits = device.reset(), []
    with threadpool_limits(limits=1):  # a second BLAS thread only adds latency
        for roll_deg, bend_deg in ring(targets):
            done, y = visit(tip, device, y, roll_deg, bend_deg, pause_s)
            visits.append(done)
        tip.stop()
        while device.rest_command < tip.state().command:
            y = device.apply(tip.step(y).u)
    return visits


def main() -> None:
    """Print one row a target."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--targets", type=int, default=8, help="places along the ring")
    parser.add_argument("--pause", type=float, default=1.0, help="rest at each [s]")
    arguments = parser.parse_args()
    table = Table("roll [deg]", "bend [deg]", "settled after [s]", "greatest error [deg]", "command range [mm]")
    for v in run(arguments.targets, arguments.pause):
        table.add_row(
            f"{v.roll_deg:.1f}",
            f"{v.target_deg:.1f}",
            f"{v.settled_s:.2f}",
            f"{v.error_deg:.2f}",
            f"{v.command_range:.3f}",
        )
    Console().print(table)


if __name__ == "__main__":
    main()
