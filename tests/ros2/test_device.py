"""The node `tip_planner` at a device in another process, over Cyclone DDS: only rclpy itself is a stand-in."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from hystmpc.rig.realtime import MonotonicClock

from .test_messages import needs_dds
from .test_planner import FLOAT, GIVEN, STAMPED, World, world

__all__ = ["world"]  # the fixture
pytestmark = [pytest.mark.slow, needs_dds]
DOMAIN = 77
DEVICE = {
    "rate_hz": 25,
    "command_unit": "mm",
    "plant": {"simulator": "builtin:tendon-catheter", "lag_s": 0.08, "noise_deg": 0.1},
    "limits": {"lower": 0, "upper": 6, "rate_per_s": 10},
    "link": {"kind": "dds", "domain": DOMAIN},
    "watchdog_s": 0.5,
    "seed": 1,
}


@pytest.fixture
def device(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """`hystmpc device` in a process of its own."""
    path = tmp_path / "device.yaml"
    path.write_text(yaml.safe_dump(DEVICE), encoding="utf-8")
    command = [sys.executable, "-c", "from hystmpc.cli.entry import main; main()", "device", str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        yield process
        process.terminate()


class Bridge:
    """In the place of rmw: what the node publishes goes into the domain, and what comes from there to the node."""

    def __init__(self, world: World) -> None:
        from hystmpc.rig.transports.dds import DdsSettings
        from hystmpc.rig.transports.dds_ import Float64Stamped, Header, Time, _Wire

        settings = DdsSettings.parse({"kind": "dds", "domain": DOMAIN})
        self._wire, self._graph = _Wire(settings, settings.command_topic, settings.angle_topic), world.graph
        self.angle = self.held = math.nan

        def out(message: Any) -> None:
            stamp, note = message.header.stamp, message.header.frame_id
            header = Header(stamp=Time(sec=stamp.sec, nanosec=stamp.nanosec), frame_id=note)
            numbers = {name: getattr(message, name) for name in ("session", "sequence", "data", "held")}
            self._wire._writer.write(Float64Stamped(header=header, **numbers))

        world.graph.readers["tip/command"] = [out]

    def turn(self) -> None:
        """What has come since the last turn."""
        while (come := self._wire.take()) is not None:
            numbers = {name: getattr(come, name) for name in ("session", "sequence", "data", "held")}
            message = STAMPED(**numbers)
            message.header.frame_id = come.header.frame_id
            message.header.stamp.sec, message.header.stamp.nanosec = come.header.stamp.sec, come.header.stamp.nanosec
            self._graph.publish("tip/angle_deg", message)
            self.angle, self.held = come.data, come.held

    def close(self) -> None:
        self._wire.close()


def test_it_drives_the_device_of_hystmpc(world: World, device: subprocess.Popen[str]) -> None:
    world.graph.parameters = {"config": GIVEN["config"]}
    world.module.MonotonicClock = MonotonicClock  # the device's own: it is another process
    bridge = Bridge(world)
    world.device.period = bridge.turn  # type: ignore[method-assign]

    def until(reached: Any, seconds: float) -> None:
        end = time.monotonic() + seconds
        while not reached() and time.monotonic() < end:
            world.turn()
            time.sleep(0.04)
        assert reached(), f"{world.states[-1].status}, {bridge.angle} deg, {device.poll()}"

    try:
        world.start()
        until(lambda: world.states and world.states[-1].source == "mpc", 60.0)
        world.graph.publish("~/target", FLOAT(data=55.0))
        until(lambda: world.states[-1].settled and abs(bridge.angle - 55.0) < 1.0, 20.0)
        assert not world.states[-1].stopped
        world.graph.call("~/stop")
        until(lambda: bridge.held == 0.0, 20.0)
        world.graph.call("~/reset")
        until(lambda: world.states[-1].source == "mpc", 20.0)
    finally:
        bridge.close()
