"""Change monitor on drawn devices: false alarms per hour on unchanged devices, and the delay of the detection.

    hystmpc study commission --out DIR ...
    python lab/benchmarks/monitor.py DIR [--hours 100] [--minutes 4] [--seed 0] [--jobs 2]

Every device commissioned by the study moves unchanged for its share of the hours: scans, ramps with
rests, and sums of two sines, drawn at random within the limits. Then it moves for some minutes after each change:
friction and stiffness (factors 2 and 1.3), 0.1 s more of lag, 0.08 s more of delay, an offset of 6 % of the range. The
model runs open-loop on the same commands. A false alarm is a reported change that was not reported before. The
delay is counted in seconds of the run, rests included.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from kit import asked, show

from hystmpc.bench.identify import TIP_FILE, tip_settings
from hystmpc.ctrl.monitor import Change, ChangeMonitor
from hystmpc.models.load import load_model, model_path
from hystmpc.models.prediction.build import controller_model
from hystmpc.trials.config import load_settings
from hystmpc.trials.types import Vec
from hystmpc_lab.commission.settings import CommissionStudySettings
from hystmpc_lab.devices.drawn import DrawnDevice, DrawnPlant, draw_devices, worn

_PREPARATION_S = (4.0, 1.5)  # of the strokes of two flexures
_SLOWEST, _FASTEST = 0.05, 0.5  # share of the greatest rate of the command
_OFFSET = 0.06
EXPECTED = {"friction": "friction", "stiffness": "stiffness", "lag": "lag", "delay": "lag", "offset": "offset"}


@dataclass(frozen=True)
class Judged:
    """Result of one device: its hours as identified, and the answer after each change."""

    key: str
    hours: float
    alarms: int
    delays_s: dict[str, float]
    named: dict[str, str]


def changed(device: DrawnDevice, change: str) -> DrawnDevice:
    """Device after a change; an offset is that of the sensor."""
    made = {
        "friction": worn(device, 2.0, 1.0),
        "stiffness": worn(device, 1.0, 1.3),
        "lag": replace(device, lag_s=device.lag_s + 0.1),
        "delay": replace(device, delay_s=device.delay_s + 0.08),
        "offset": device,
    }
    return made[change]


def motion(random: np.random.Generator, device: DrawnDevice, seconds: float) -> Vec:
    """Commands (N,) of a working session."""
    dt, top, rate, out, last = 1.0 / device.rate_hz, device.limits.upper, device.limits.rate, [np.zeros(1)], 0.0
    wanted = round(seconds / dt)
    while sum(map(len, out)) < wanted:
        part = np.concatenate(list(_part(random, dt, top, rate, last)))
        out.append(part)
        last = float(part[-1])
    return np.clip(np.concatenate(out)[:wanted], 0.0, top)


def _part(random: np.random.Generator, dt: float, top: float, rate: float, last: float) -> Iterator[Vec]:
    """Commands of half a minute of one kind of motion, starting at `last`."""
    kind, t = random.integers(3), np.arange(round(random.uniform(20.0, 60.0) / dt)) * dt
    width = random.uniform(0.25, 1.0) * top
    centre = random.uniform(0.5 * width, top - 0.5 * width)
    if kind == 0:
        for _ in range(8):
            target = centre + width * random.uniform(-0.5, 0.5)
            yield _ramp(last, target, random.uniform(_SLOWEST, _FASTEST) * rate * dt)
            yield np.full(round(random.uniform(0.3, 3.0) / dt), target)
            last = target
        return
    fastest = min(0.6, _FASTEST * rate / (math.pi * width))
    slow, quick = np.sort(fastest * random.uniform(0.1, 1.0, 2))
    share = 1.0 if kind == 1 else random.uniform(0.2, 0.8)
    wave = share * np.sin(2 * np.pi * quick * t) + (1.0 - share) * np.sin(2 * np.pi * slow * t + 1.0)
    scan = centre + 0.5 * width * wave
    yield _ramp(last, float(scan[0]), 0.3 * rate * dt)
    yield scan


def _ramp(start: float, end: float, step: float) -> Vec:
    share = np.linspace(0.0, 1.0, max(math.ceil(2.0 * abs(end - start) / step), 1) + 1)[1:]
    return start + (end - start) * share**2 * (3.0 - 2.0 * share)


def judge(device: DrawnDevice, folder: Path, hours: float, minutes: float, seed: int) -> Judged:
    """Run the unchanged hours and the changes of one device."""
    tip = tip_settings(folder / "commissioned" / device.key / TIP_FILE)
    model = load_model(model_path(tip.model), start="conditioned")
    predictor = controller_model(model).feedforward[0]
    ends = model.metadata.trained_angle.lower, model.metadata.trained_angle.upper
    monitor = ChangeMonitor(predictor.noise, predictor.dt, ends)
    random = np.random.default_rng([seed, device.number])
    top, dt = device.limits.upper, predictor.dt
    strokes = [_ramp(a, b, 2.0 * top * dt / s) for s in _PREPARATION_S for a, b in ((0.0, top), (top, 0.0))]
    prepare = np.concatenate([*strokes, np.zeros(round(1.0 / dt))])

    def run(present: DrawnDevice, seconds: float, shift_deg: float) -> tuple[Vec, Vec]:
        commands = np.concatenate([prepare, motion(random, device, seconds)])
        plant = DrawnPlant(present, int(random.integers(1 << 30)))
        first = plant.reset()
        angles = np.array([plant.apply(u) for u in commands.tolist()])
        free = predictor.rollout(predictor.initial(first, 0.0), commands[None])[0]
        return free[prepare.size :], angles[prepare.size :] + shift_deg

    alarms = _alarms(monitor, *run(device, 3600.0 * hours, 0.0))
    delays, named = {}, {}
    for change in EXPECTED:
        shift = _OFFSET * (ends[1] - ends[0]) if change == "offset" else 0.0
        said, delays[change] = monitor.along(*run(changed(device, change), 60.0 * minutes, shift))
        named[change] = said.signs[0][0] if said.certain else "nothing"
    return Judged(device.key, hours, alarms, delays, named)


def _alarms(monitor: ChangeMonitor, free: Vec, angles: Vec) -> int:
    """Number of reported changes that were not reported one second before."""
    state, before, count, every = monitor.init(float(free[0]), float(angles[0])), False, 0, round(1.0 / monitor.dt)
    for k, (model, angle) in enumerate(zip(free.tolist(), angles.tolist(), strict=True)):
        state = monitor.advance(state, model, angle)
        if k % every == 0:
            change: Change = monitor.change(state)
            count += change.certain and not before
            before = change.certain
    return count


def main() -> None:
    """Print both tables."""
    given = asked(__doc__, folder={"place": True, "type": Path}, hours=100.0, minutes=4.0, seed=0, jobs=2)
    study = load_settings(CommissionStudySettings, given.folder / "config.yaml")
    devices = draw_devices(study.devices, study.seed, study.quick)
    there = [d for d in devices if (given.folder / "commissioned" / d.key / TIP_FILE).is_file()]
    do = partial(
        judge,
        folder=given.folder,
        hours=given.hours / len(there),
        minutes=given.minutes,
        seed=given.seed,
    )
    with ProcessPoolExecutor(given.jobs) as pool:
        found = list(pool.map(do, there))
    alarms, hours = sum(one.alarms for one in found), sum(one.hours for one in found)
    noisy = ", ".join(f"{one.key} {one.alarms}" for one in found if one.alarms) or "none"
    print(f"{len(found)} devices, {hours:.0f} h as identified: {alarms} false alarms ({noisy})")
    rows = []
    for change, sign in EXPECTED.items():
        delays = np.array([one.delays_s[change] for one in found])
        names = Counter(one.named[change] for one in found)
        said = np.isfinite(delays)
        median = f"{np.median(delays[said]):.0f}" if said.any() else ""
        named = ", ".join(f"{name} {count}" for name, count in names.most_common())
        quick = int((delays[said] <= 60.0).sum())
        rows.append((change, f"{said.sum()} of {said.size}", quick, median, names[sign], named))
    show(("change", "said", "within a minute", "median delay [s]", "named right", "named"), rows)


if __name__ == "__main__":
    main()
