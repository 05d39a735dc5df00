"""A device that has changed, seen in late frames alone: how far learning from frames reduces the error in a minute.

    python lab/benchmarks/changed_frames.py FOLDER --seed 9101 --devices 60 [--rate-hz 5] [--each 2] [--gains 20]

FOLDER is that of `hystmpc study identify` with the same seed, number of devices and families: the models identified
there control devices that have changed since then, and may rest at another angle. Frames come 0.2 s late, with noise of
0.5 deg. The default MPC with frames is compared with that without a sensor and with a PID whose gains are searched on
the same changed device. The motion is point to point; errors are those of the true angle, from 60 s of motion on [deg].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from kit import asked, show

from hystmpc.ctrl.feedback import PidControllerSettings
from hystmpc.ctrl.law import LawSettings
from hystmpc.ctrl.loop import ImagingSettings, NoSensorSettings
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.models.prediction.build import ControllerModel, controller_model
from hystmpc.sim.study import run_closed_loop
from hystmpc.sim.tuning.gains import searched_gains
from hystmpc.trajectories.drawn import CountedMotion, drawn_motions
from hystmpc.trials.errors import HystmpcError
from hystmpc_lab.devices.drawn import FAMILIES, OUTSIDE, DrawnDevice, DrawnPlant, draw_devices, worn
from hystmpc_lab.devices.motions import reference_speed
from hystmpc_lab.identify.job import controller_on

AFTER_S, MOVES = 60.0, 28
CHANGES: dict[str, Callable[[DrawnDevice], DrawnDevice]] = {
    "unchanged": lambda device: device,
    "friction x 2": lambda device: worn(device, 2.0, 1.0),
    "stiffness x 0.7": lambda device: worn(device, 1.0, 0.7),
    "lag + 0.15 s": lambda device: replace(device, lag_s=device.lag_s + 0.15),
    "creep of 0.1": lambda device: replace(device, creep=0.1, creep_s=8.0),
}
ALL = (*FAMILIES, *OUTSIDE)
_FASTEST_HZ = 100.0  # frames of faster loops take as long to simulate as those of ten slower ones


def motion_of(device: DrawnDevice, plant: DrawnPlant) -> CountedMotion:
    """Point to point for a minute and half, within what the device reached before and after its change."""
    before, after = DrawnPlant(device, device.seed).reachable_deg, plant.reachable_deg
    within = max(before[0], after[0]), min(before[1], after[1])
    random, speed = np.random.default_rng([device.seed, 7]), reference_speed(plant)
    return drawn_motions(random, plant.true_angle, within, speed, {}, moves=MOVES)[0]


def errors(
    device: DrawnDevice, change: str, model: ControllerModel, frames: ImagingSettings, gains: int
) -> tuple[float, float, float]:
    """RMSE with frames, without a sensor, and of the PID [deg]."""
    plant = DrawnPlant(CHANGES[change](device), device.seed + 1)
    motion, blind = motion_of(device, plant), NoSensorSettings()

    def rmse(law: LawSettings, sensor: ImagingSettings | NoSensorSettings, plant: DrawnPlant = plant) -> float:
        known = {**sensor.estimator_keys(), "rest_tolerance_deg": 360.0}
        keys = {key: value for key, value in known.items() if key in type(law.estimator).model_fields}
        law = type(law).parse({**law.model_dump(exclude_unset=True), "estimator": keys}, change)
        run = run_closed_loop(controller_on(law, model, device.limits), plant, motion.trajectory, sensor=sensor)
        return float(np.sqrt(np.mean(run.error_deg[motion.first(run.dt) + round(AFTER_S / run.dt) :] ** 2)))

    tuned_on = plant.reseeded(device.seed + 2)
    best = searched_gains(PidControllerSettings(), lambda tried: rmse(tried, frames, tuned_on) ** 2, gains, device.seed)
    predictive = LinearisedMpcSettings()
    return rmse(predictive, frames), rmse(predictive, blind), rmse(best.settings, frames)


def main() -> None:
    options = asked(
        __doc__,
        folder={"place": True, "type": Path},
        seed=0,
        devices=60,
        rate_hz=(5.0, "frames in a second"),
        each=(2, "devices of each family"),
        gains=(20, "evaluations of the search for the PID's gains"),
    )
    frames = ImagingSettings(rate_hz=options.rate_hz, latency_s=0.2, noise_deg=0.5)
    drawn = [d for d in draw_devices(options.devices, options.seed, False, ALL) if d.rate_hz < _FASTEST_HZ]
    chosen = [d for family in ALL for d in [d for d in drawn if f"-{family}-" in d.key][: options.each]]
    try:
        models = [controller_model(str(options.folder / "models" / f"{device.key}-auto.yaml")) for device in chosen]
    except HystmpcError as error:
        raise SystemExit(f"changed_frames: {error}; give the folder of `hystmpc study identify`") from None
    rows = []
    for device, model in zip(chosen, models, strict=True):
        for change in CHANGES:
            if change.startswith("creep") and device.creep > 0:
                continue  # it creeps already
            seen, blind, pid = errors(device, change, model, frames, options.gains)
            rows.append((change, seen / blind, seen / pid, device.key))
            print(f"{device.key}, {change}: {seen:.3f}, without a sensor {blind:.3f}, PID {pid:.3f} deg", flush=True)
    table = []
    for change in CHANGES:
        some = [row for row in rows if row[0] == change]
        worst = max(some, key=lambda row: row[1])
        over_pid = [row[2] for row in some]
        medians = (f"{np.median([row[1] for row in some]):.3f}", f"{worst[1]:.3f} {worst[3]}")
        table.append((f"{change} ({len(some)})", *medians, f"{np.median(over_pid):.3f}", f"{max(over_pid):.3f}"))
    show(("change (devices)", "over no sensor, median", "worst", "over PID, median", "worst"), table)


if __name__ == "__main__":
    main()
