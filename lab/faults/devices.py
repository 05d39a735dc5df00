"""Devices of the campaign, hostile and healthy, drawn from fixed seeds, and the plays with them."""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .description import Body, DeviceFault, DeviceSpec, FaultKind
from .hostile import HostileDevice
from .movers import LAW, How, use
from .truth import MOVERS, DeviceVerdict, Mover, judged

_SEED = 40
_FAST: Mapping[str, Any] = {"ramps": {"velocity_per_s": 8.0, "acceleration_per_s2": 60.0, "jerk_per_s3": 1000.0}}
_LOOP_HZ, _FAST_HZ = 25.0, 1000.0
_WHOLE_EVERY = 5  # healthy devices, of which one is commissioned to the end


_STEEPER: tuple[tuple[Mover, int], ...] = (("commission", 2), ("commission", 4), ("investigate", 1))
_OVER_UDP = (
    "lag 0.05 s, stuck",
    "0.05 s a second later, 1000 Hz",
    "out of range in turns at 2 Hz",
    "false held, burst of 5.5",
    "false held, constant of 2",
    "talks and does not listen",
    "watchdog acts after 3 s",
    "healthy: lag 0.2 s",
    "healthy: 1 kHz, noise 0.15 deg",
)
_UNTOLD: Mapping[str, Any] = {"start_command": 0.0}


@dataclass(frozen=True)
class DeviceCase:
    """Device with its use in the campaign.

    Attributes:
        bench: changes of the bench file, nested: those its user would have to write.
        law: kind of the controller; empty for each in turn.
    """

    device: DeviceSpec
    healthy: bool = False
    movers: tuple[Mover, ...] = MOVERS
    bench: Mapping[str, Any] = field(default_factory=dict)
    law: str = ""

    @property
    def name(self) -> str:
        """Name of the device."""
        return self.device.name


@dataclass(frozen=True)
class DevicePlay:
    """One device and one mover."""

    case: DeviceCase
    mover: Mover
    how: How

    @property
    def name(self) -> str:
        """Name in tables."""
        if self.mover not in ("run", "ros2"):
            return self.case.name
        more = [self.how.law] + ["c"] * (self.how.backend == "c") + ["udp"] * self.how.udp
        return f"{self.case.name} ({', '.join(more)})"


def _with(kind: FaultKind, at_s: float = 3.0, **more: float) -> tuple[DeviceFault, ...]:
    return (DeviceFault(kind, at_s, **more),)  # type: ignore[arg-type]


def _lagging(random: np.random.Generator) -> Iterator[DeviceCase]:
    kinds: tuple[FaultKind, ...] = ("stuck", "silent", "outside", "restarts", "stuck")
    for lag_s, kind in zip((0.05, 0.15, 0.25, 0.35, 0.5), kinds, strict=True):
        body, at_s = Body(lag_s=lag_s), float(random.uniform(4.0, 8.0))
        yield DeviceCase(DeviceSpec(f"lag {lag_s:g} s, {kind}", body, faults=_with(kind, at_s)))


def _aging() -> Iterator[DeviceCase]:
    """Devices with increasingly late readings, at 25 Hz and at 1 kHz."""
    for hz in (25.0, 1000.0):
        for size in (0.01, 0.05, 0.2):
            faults = _with("ages", 2.0, size=size)
            yield DeviceCase(DeviceSpec(f"{size:g} s a second later, {hz:g} Hz", stream_hz=hz, faults=faults))


def _bodies(random: np.random.Generator) -> Iterator[DeviceCase]:
    """Devices with other gains, an inverted tip or oscillations: no fault has to be detected, but limits hold."""
    for gain in (0.3, 0.5, 2.0, 3.0):
        yield DeviceCase(DeviceSpec(f"gain x {gain:g}", Body(gain=gain)))
    yield DeviceCase(DeviceSpec("gain x 3, lag 0.3 s", Body(gain=3.0, lag_s=0.3)))
    for mover, motion in _STEEPER:
        for lag_s, upper_deg in ((0.03, 120.0), (0.03, 113.0), (0.12, 113.0)):
            fault = DeviceFault("steepens", 0.0, motion, size=3.0)
            name = f"gain x 3 from motion {motion + 1} on, lag {lag_s:g} s, sensor to {upper_deg:g} deg"
            spec = DeviceSpec(name, Body(lag_s=lag_s), faults=(fault,))
            yield DeviceCase(spec, movers=(mover,), bench={"sensor": {"upper_deg": upper_deg}})
    for gain, rest_deg, law in ((1.0, 60.0, "pid"), (0.5, 42.0, "pid"), (0.5, 45.0, "linearised_mpc")):
        body = Body(gain=-gain, rest_deg=rest_deg)
        yield DeviceCase(DeviceSpec(f"inverted x {gain:g}, rest at {rest_deg:g} deg", body), law=law)
    for hz in (1.0, 2.5, 6.0):
        damping = float(random.uniform(0.02, 0.1))
        body = Body(own_hz=hz, damping=damping)
        yield DeviceCase(DeviceSpec(f"resonant at {hz:g} Hz, damping {damping:.2f}", body))
    body = Body(gain=2.0, own_hz=1.5, damping=0.05)
    yield DeviceCase(DeviceSpec("gain x 2, resonant at 1.5 Hz", body))


def _tips(random: np.random.Generator) -> Iterator[DeviceCase]:
    """Devices with a tip that sticks or trembles."""
    yield DeviceCase(DeviceSpec("stuck at once", faults=_with("stuck", 0.0)))
    for _ in range(2):
        at_s = float(random.uniform(4.0, 9.0))
        yield DeviceCase(DeviceSpec(f"stuck after {at_s:.1f} s", faults=_with("stuck", at_s)))
    yield DeviceCase(
        DeviceSpec("stuck, quantised by 0.5 deg", quantum_deg=0.5, noise_deg=0.0, faults=_with("stuck", 5.0))
    )
    for gain, motion in ((2.5, 2), (3.0, 1)):
        fault = DeviceFault("stuck", 0.2, motion)
        name = f"gain x {gain:g}, stuck in motion {motion + 1}"
        yield DeviceCase(DeviceSpec(name, Body(gain=gain), faults=(fault,)), movers=("commission",))
    for size, period_s in ((0.8, 0.5), (2.0, 0.2)):
        faults = _with("dithers", 4.0, size=size, period_s=period_s)
        yield DeviceCase(DeviceSpec(f"trembles by {size:g} deg at {1 / period_s:g} Hz", faults=faults))


def _sensors(random: np.random.Generator) -> Iterator[DeviceCase]:
    """Devices with a sensor out of range, shifted, with spikes, silent, or quantised."""
    for hz in (2.0, 0.5):
        faults = _with("outside", 4.0, period_s=0.5 / hz)
        yield DeviceCase(DeviceSpec(f"out of range in turns at {hz:g} Hz", faults=faults))
    yield DeviceCase(DeviceSpec("out of range for good", faults=_with("outside", 4.0)))
    yield DeviceCase(DeviceSpec("silent", faults=_with("silent", float(random.uniform(3.0, 8.0)))))
    yield DeviceCase(DeviceSpec("shifted by 30 deg", faults=_with("shifted", 5.0, size=30.0)))
    yield DeviceCase(DeviceSpec("spikes of 50 deg", faults=_with("spikes", 3.0, size=50.0)))
    yield DeviceCase(DeviceSpec("12 bit of 360 deg, no noise", noise_deg=0.0, quantum_deg=360.0 / 4096))
    yield DeviceCase(DeviceSpec("5 kHz stream", stream_hz=5000.0))
    yield DeviceCase(DeviceSpec("1 kHz stream, stuck", stream_hz=1000.0, faults=_with("stuck", 5.0)))


def _held() -> Iterator[DeviceCase]:
    for kind_of, size, lasts_s in (("burst", 5.5, 0.24), ("burst", 0.0, 0.24), ("constant", 2.0, math.inf)):
        fault = DeviceFault("held", 3.0, size=size, lasts_s=lasts_s)
        yield DeviceCase(DeviceSpec(f"false held, {kind_of} of {size:g}", faults=(fault,)))
    at_rest = DeviceFault("held", 0.3, size=5.5, lasts_s=0.24)
    yield DeviceCase(DeviceSpec("false held, burst of 5.5 near rest", faults=(at_rest,)))
    yield DeviceCase(DeviceSpec("held is nan in turns", faults=_with("held_nan", 3.0, period_s=0.1)))
    yield DeviceCase(DeviceSpec("held is 1e308", faults=_with("held", 3.0, size=1e308)))


def _wires() -> Iterator[DeviceCase]:
    for ms in (5, 20, 50, 90):
        yield DeviceCase(DeviceSpec(f"read takes {ms} ms", faults=_with("reads_slowly", 3.0, size=1e-3 * ms)))
    for ms in (20, 90):
        yield DeviceCase(DeviceSpec(f"write takes {ms} ms", faults=_with("writes_slowly", 3.0, size=1e-3 * ms)))
    for size in (0.7, 3.0):
        faults, name = _with("stalls", 5.0, size=size), f"program stands still for {size:g} s"
        yield DeviceCase(DeviceSpec(name, faults=faults))
        yield DeviceCase(DeviceSpec(f"{name}, no sessions", sessions=False, faults=faults))
        silent = DeviceSpec(f"{name}, tells nothing", sessions=False, tells=False, faults=faults)
        yield DeviceCase(silent, bench=_UNTOLD)


def _drives() -> Iterator[DeviceCase]:
    """Devices that restart, refuse commands, act by their watchdog, or move by themselves."""
    for at_s in (0.5, 6.0):
        yield DeviceCase(DeviceSpec(f"restarts after {at_s:g} s", faults=_with("restarts", at_s)))
    yield DeviceCase(DeviceSpec("talks and does not listen", faults=_with("deaf", 4.0)))
    for at_s in (3.0, 6.0):
        fault = DeviceFault("leaves", at_s, lasts_s=0.02)
        yield DeviceCase(DeviceSpec(f"watchdog acts after {at_s:g} s", faults=(fault,)))
    yield DeviceCase(DeviceSpec("moves by itself", faults=_with("wanders", 4.0, size=1.0)))


def _healthy(random: np.random.Generator) -> Iterator[DeviceCase]:
    for lag_s in (0.1, 0.2, 0.3, 0.4, 0.5):
        yield _well(f"lag {lag_s:g} s", Body(lag_s=lag_s))
    for lag_s in (0.2, 0.4):
        yield _well(f"lag {lag_s:g} s, fast ramps", Body(lag_s=lag_s), _FAST)
    for share in (0.1, 0.25, 0.4):
        yield _well(f"play of {100 * share:.0f} %", Body(backlash_mm=share * 6.0, weights=(10.0,)))
    yield _well("wide loop", Body(spacing_mm=0.5))
    for quantum in (0.1, 0.5, 1.0):
        yield _well(f"quantised by {quantum:g} deg", Body(), noise_deg=0.05 * quantum, quantum_deg=quantum)
    for noise in (0.3, 0.5):
        yield _well(f"noise of {noise:g} deg", Body(), noise_deg=noise)
    yield _well("1 kHz, noise 0.15 deg", Body(), stream_hz=1000.0, noise_deg=0.15)
    yield _well("tells nothing", Body(), _UNTOLD, tells=False, sessions=False)
    yield _well("no sessions", Body(), sessions=False)
    yield _well("26 Hz", Body(), stream_hz=26.0)
    yield _well("dead time 0.1 s", Body(dead_s=0.1, lag_s=0.05))
    rate = float(random.uniform(3.5, 6.0))
    yield _well(f"drive of {rate:.1f} mm/s", Body(), drive_rate=rate)
    yield _well("creep of 15 %", Body(creep=0.15))
    lag, noise = float(random.uniform(0.1, 0.3)), float(random.uniform(0.1, 0.3))
    mixed = Body(lag_s=lag, dead_s=0.04, spacing_mm=0.35, creep=0.05)
    yield _well(f"lag {lag:.2f} s, noise {noise:.2f} deg, creep", mixed, noise_deg=noise, stream_hz=200.0)


def _well(name: str, body: Body, bench: Mapping[str, Any] | None = None, **more: float) -> DeviceCase:
    return DeviceCase(DeviceSpec(f"healthy: {name}", body, **more), healthy=True, bench=bench or {})  # type: ignore[arg-type]


def device_cases() -> tuple[DeviceCase, ...]:
    """All device cases; equal at every call."""
    random = np.random.default_rng(_SEED)
    found = [*_lagging(random), *_aging(), *_bodies(random), *_tips(random), *_sensors(random)]
    found += [*_held(), *_wires(), *_drives(), *_healthy(random)]
    return tuple(replace(case, device=replace(case.device, seed=k)) for k, case in enumerate(found))


def device_plays(cases: tuple[DeviceCase, ...], movers: tuple[Mover, ...] = MOVERS) -> tuple[DevicePlay, ...]:
    """Every device with each of its movers; runs alternate the laws, some over UDP, in C."""
    found = []
    for case in cases:
        k = case.device.seed
        for mover in (m for m in movers if m in case.movers):
            law = case.law or LAW[k % len(LAW)]
            whole = case.healthy and k % _WHOLE_EVERY == 0
            found.append(DevicePlay(case, mover, How(law, bench=case.bench, whole=whole)))  # pyright: ignore[reportArgumentType]
    if "run" in movers:
        found += [_over_udp(case) for case in cases if case.name in _OVER_UDP]
    return tuple(found)


def _over_udp(case: DeviceCase) -> DevicePlay:
    """Device at the loop's rate or 1 kHz, since the loop in C leaves a sample with several readings to Python."""
    device = case.device if case.device.stream_hz >= _FAST_HZ else replace(case.device, stream_hz=_LOOP_HZ)
    how = How(LAW[0], "c", udp=True, bench=case.bench)
    return DevicePlay(replace(case, device=device), "run", how)


def played(play: DevicePlay, folder: Path) -> DeviceVerdict:
    """Play one case in a new folder and judge it by the device's log."""
    folder.mkdir(parents=True)
    device = HostileDevice(play.case.device)
    asked, ending = use(play.mover, device, folder, play.how)
    write_log(device, folder / "device.csv")
    return judged(play.name, device, asked, ending, play.case.healthy)


def played_all(plays: Sequence[DevicePlay], folder: Path, jobs: int = 1) -> Iterator[DeviceVerdict]:
    """Verdicts of all plays in order, each in a separate folder, by `jobs` processes."""
    places = [folder / f"{k:03d}_{play.mover}" for k, play in enumerate(plays)]
    if jobs == 1:
        yield from map(played, plays, places)
        return
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        try:
            yield from pool.map(played, plays, places)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def write_log(device: HostileDevice, file: Path) -> None:
    """Write the log of a device: one row in 10 ms, and one for each command."""
    lines = ["time_s,motion,received,before,held,told,x_mm,angle_deg,shown_deg,age_s\n"]
    for row in device.rows:
        cells = (row.received, row.before, row.held, row.told, row.x_mm, row.angle_deg, row.shown_deg, row.age_s)
        lines.append(f"{row.t_s:.4f},{row.motion}," + ",".join(f"{cell:.6g}" for cell in cells) + "\n")
    file.write_text("".join(lines), encoding="utf-8")
