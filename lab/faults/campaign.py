"""The campaign of devices: each played with each mover on a virtual clock, by one process or several."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from .devices import DevicePlay
from .hostile import HostileDevice
from .movers import use
from .truth import DeviceVerdict, judged


def played(play: DevicePlay, folder: Path) -> DeviceVerdict:
    """Play one, in a new folder, and judge it by the device's log.

    Raises:
        ConfigError: if the mover is not there.
    """
    folder.mkdir(parents=True)
    device = HostileDevice(play.case.device)
    asked, ending = use(play.mover, device, folder, play.how)
    write_log(device, folder / "device.csv")
    return judged(play.name, device, asked, ending, play.case.healthy)


def played_all(plays: Sequence[DevicePlay], folder: Path, jobs: int = 1) -> Iterator[DeviceVerdict]:
    """All of them, in their order, each in a folder of its own.

    Args:
        jobs: processes.

    Raises:
        ConfigError: if a mover is not there.
    """
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
    """Write a device's own log: one row in 10 ms, and one a command."""
    lines = ["time_s,motion,received,before,held,told,x_mm,angle_deg,shown_deg,age_s\n"]
    for row in device.rows:
        cells = (row.received, row.before, row.held, row.told, row.x_mm, row.angle_deg, row.shown_deg, row.age_s)
        lines.append(f"{row.t_s:.4f},{row.motion}," + ",".join(f"{cell:.6g}" for cell in cells) + "\n")
    file.write_text("".join(lines), encoding="utf-8")
