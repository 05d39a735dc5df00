"""Programs of the package that move a device, each applied to a hostile device on a virtual clock."""

from __future__ import annotations

import importlib.util
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, final

import numpy as np

from hystmpc.bench.commission import commission_device
from hystmpc.bench.config import CommissionSettings, InvestigateSettings, located_investigation
from hystmpc.bench.device import AnyTip, BenchDevice, DeviceStoppedError, MovableDevice, Tick, Track, plants_in
from hystmpc.bench.investigate import investigate_device
from hystmpc.bench.motions import AnyMotion
from hystmpc.ctrl import TipController
from hystmpc.rig.config import BenchSettings, RunSettings
from hystmpc.rig.experiment.experiment import Steering, run_experiment, tracking_phase
from hystmpc.rig.experiment.phases import CommandMotion, Phase
from hystmpc.rig.experiment.record import Recorded
from hystmpc.rig.realtime import SimulatedClock
from hystmpc.rig.recording.recorder_process import Views, open_recorder_process
from hystmpc.rig.recording.recording import RecordingMeta
from hystmpc.rig.recording.sample import SampleList, Sink
from hystmpc.rig.run import BenchResult, run_bench
from hystmpc.rig.safety.ramp import waypoint_commands
from hystmpc.rig.transports.transport import Conversion, RunContext
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ConfigError, HystmpcError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .description import SAFE
from .hostile import EndlessError, HostileDevice, HostileSettings, served
from .truth import Asked, Ending, Mover

LAW: tuple[str, ...] = ("linearised_mpc", "pid", "inverse")
"""Controllers of a run, by the kind of their block."""

ANGLE_LIMITS_DEG = (10.0, 110.0)
"""Where the tip may go in a commissioning and an investigation [deg]."""

_SETTLE_S = 6.0  # observation after the last connection: watchdog and return
_REFERENCE: Mapping[str, Any] = {
    "kind": "scan_sinusoid",
    "start_deg": 45.0,
    "centre_deg": 55.0,
    "amplitude_deg": 15.0,
    "frequency_hz": 0.4,
    "cycles": 9,
}
_SCAN: Mapping[str, Any] = {**_REFERENCE, "amplitude_deg": 10.0, "frequency_hz": 0.5, "cycles": 1.0}
BENCH: Mapping[str, Any] = {
    "name": "device",
    "rate_hz": 25,
    "command_unit": "mm",
    "limits": {"lower": 0.0, "upper": 6.0, "rate_per_s": 10.0},
    "ramps": {"velocity_per_s": 3.0, "acceleration_per_s2": 15.0, "jerk_per_s3": 150.0},
    "safe_command": SAFE,
    "sensor": {"lower_deg": 0.0, "upper_deg": 120.0, "rate_limit_deg_s": 400.0},
}
_COMMISSION: Mapping[str, Any] = {
    "minutes": 2.5,
    "diagnose": False,
    "tune_evaluations": 24,
    "range_steps": 5,
    "motions": {"scan": _SCAN},
    "angle_limits_deg": ANGLE_LIMITS_DEG,
}
_INVESTIGATE: Mapping[str, Any] = {"model": "builtin:tendon-catheter", "minutes": 1.5, "longest_motion_s": 8.0}
_UDP_CYCLES = 4
_GRACE = 2.0  # samples: jitter at either end
_ROS_S = 25.0
_ROS_TARGETS_DEG = (45.0, 60.0, 40.0, 65.0, 50.0, 70.0, 45.0, 55.0, 40.0)
_ROS_STAYS_S = 2.5  # at each of them
_LATCH = "latched.json"


@dataclass(frozen=True)
class How:
    """Conditions under which a device is used.

    Attributes:
        law: kind of the controller of `run` and `ros2`.
        backend: what takes the samples of `run`.
        udp: whether `run` goes over a real wire, in real time: whole samples are taken in C there.
        bench: changes of the bench file, nested.
        whole: whether a commissioning goes on to the end; else, and with an investigation, it ends after its first
            recordings, since nothing new moves the device afterwards but what `run` does.
    """

    law: str = "linearised_mpc"
    backend: Literal["python", "c"] = "python"
    udp: bool = False
    bench: Mapping[str, Any] | None = None
    whole: bool = False


Move = Callable[[], Ending]


class RecordedError(Exception):
    """Error that ends a commissioning or an investigation after all recordings; the rest needs no device."""


def use(mover: Mover, device: HostileDevice, folder: Path, how: How = How()) -> tuple[Asked, Ending]:
    """Apply one of the movers to a device, and observe it until it has to be at rest."""
    settings = _bench(device, folder, how)
    if how.udp:
        with served(device) as port:
            settings["transport"] = {"kind": "udp", "port": port}
            ending = _ended(_MOVERS[mover](settings, folder, how), folder)
        one_each = device.spec.stream_hz <= settings["rate_hz"]
        ending = replace(ending, in_c=_in_c(folder) if one_each else -1)
    else:
        ending = _ended(_MOVERS[mover](settings, folder, how), folder)
    if ending.how != "raised":
        device.settle(_SETTLE_S)
    limits, sensor = settings["limits"], settings["sensor"]
    angles = ANGLE_LIMITS_DEG if mover in ("commission", "investigate") else None
    bench = BenchSettings.parse(settings)
    asked = Asked(
        mover,
        limits["lower"],
        limits["upper"],
        limits["rate_per_s"],
        bench.dt_s,
        bench.overshoot,
        (sensor["lower_deg"], sensor["upper_deg"]),
        angles,
        _GRACE * bench.dt_s if how.udp else 0.0,
    )
    return asked, ending


def _in_c(folder: Path) -> int:
    """Number of samples of a run executed wholly in C."""
    files = sorted(folder.rglob("timing.json"))
    return int(json.loads(files[-1].read_text(encoding="utf-8"))["outcome"]["in_c"]) if files else 0


def _bench(device: HostileDevice, folder: Path, how: How) -> dict[str, Any]:
    own: Mapping[str, Any] = how.bench or {}
    changed = {key: {**BENCH.get(key, {}), **value} if isinstance(value, dict) else value for key, value in own.items()}
    more = {"transport": HostileSettings.of(device), "latch_file": folder / _LATCH}
    return {**BENCH, **more, "realtime": {"backend": how.backend}, **changed}


def _ended(move: Move, folder: Path) -> Ending:
    """Ending of a mover; an exception from outside the package's own errors is a fault of the program."""
    latch = folder / _LATCH
    try:
        return move()
    except RecordedError:
        return Ending("ended")
    except DeviceStoppedError as stop:
        return Ending("stopped", stop.result.outcome.cause, latch.exists())
    except ConfigError as error:
        return Ending("refused", str(error))
    except HystmpcError as error:
        return Ending("early", str(error))
    except EndlessError as error:
        return Ending("raised", f"{error}: it never left the device alone")
    except Exception as error:  # noqa: BLE001 - whatever it is, it is the finding
        return Ending("raised", f"{type(error).__name__}: {error}")


def _run(settings: dict[str, Any], folder: Path, how: How) -> Move:
    """Run an experiment as `run_experiment`; over a real wire with the recording in a separate process."""
    wanted = {**_REFERENCE, "cycles": _UDP_CYCLES} if how.udp else _REFERENCE
    tip = {"model": "builtin:pi", "controller": {"kind": how.law}}
    run = RunSettings.parse({**settings, "controller": tip, "reference": dict(wanted)})
    plants = plants_in(Path(), run.command_unit)
    if how.udp:
        return lambda: _outcome(
            run_experiment(run, lambda: _recorder(run, folder / "run"), plants, folder=folder), folder
        )
    tracking = tracking_phase(run, threaded=False)
    return lambda: _outcome(run_bench(run, lambda: [tracking], SampleList, plants, clock=SimulatedClock()), folder)


def _outcome(result: BenchResult, folder: Path) -> Ending:
    cause = result.outcome.cause
    return Ending("stopped", cause, (folder / _LATCH).exists()) if cause else Ending("ended")


def _recorder(run: RunSettings, folder: Path) -> Sink:
    meta = RecordingMeta(run.command_unit, stages=("total", "execution"))
    return open_recorder_process(folder, run, meta, run.rate_hz, Views(), lambda text: None, report=False)


def _record(settings: dict[str, Any], folder: Path, how: How) -> Move:
    del how
    bench = BenchSettings.parse({**settings, "realtime": {"backend": "python"}})
    commands = _excitation(bench)

    def approach(held: float) -> Vec:
        return waypoint_commands(held, [float(commands[0])], [1.0], bench.ramps, bench.dt_s)

    phases: list[Phase] = [CommandMotion("approach", approach), Recorded("excitation", commands, bench.dt_s)]
    plants = plants_in(Path(), bench.command_unit)
    return lambda: _outcome(run_bench(bench, lambda: phases, SampleList, plants, clock=SimulatedClock()), folder)


def _excitation(bench: BenchSettings) -> Vec:
    """Excitation of steps, holds and a sweep over most of the range, 20 s (N,)."""
    t = bench.dt_s * np.arange(round(10.0 / bench.dt_s))
    way = 0.7 * bench.limits.upper
    sweep = 0.5 * way * (1.0 - np.cos(2.0 * math.pi * (0.2 + 0.02 * t) * t))
    steps = waypoint_commands(float(sweep[-1]), [1.0, 5.0, 2.0, 4.0, 0.0], [1.0] * 5, bench.ramps, bench.dt_s)
    return np.concatenate([sweep, steps])


def _commission(settings: dict[str, Any], folder: Path, how: How) -> Move:
    block = {**_COMMISSION, **(how.bench or {}).get("commission", {})}
    made = CommissionSettings.parse({**settings, "realtime": {"backend": "python"}, "commission": block})

    def opened(root: Path, tick: Tick) -> MovableDevice:
        plants, limits = plants_in(Path(), made.command_unit), made.commission.angle_limits_deg
        own = BenchDevice(made, plants, root, limits, tick=tick)
        return own if how.whole else OnlyRecordings(own, 6)

    def move() -> Ending:
        commission_device(made, opened, folder / "commission")
        return Ending("ended")

    return move


def _investigate(settings: dict[str, Any], folder: Path, how: How) -> Move:
    del how
    data = {**settings, "realtime": {"backend": "python"}, "investigate": dict(_INVESTIGATE)}
    data["commission"] = {"angle_limits_deg": ANGLE_LIMITS_DEG}
    made = located_investigation(InvestigateSettings.parse(data), Path())

    def opened(root: Path, tick: Tick) -> MovableDevice:
        plants, limits = plants_in(Path(), made.command_unit), made.commission.angle_limits_deg
        return OnlyRecordings(BenchDevice(made, plants, root, limits, tick=tick), 3)

    def move() -> Ending:
        investigate_device(made, opened, folder / "investigate")
        return Ending("ended")

    return move


@final
class OnlyRecordings(MovableDevice):
    """Device that raises `RecordedError` after a given number of recordings."""

    def __init__(self, device: BenchDevice, most: int) -> None:
        self._device, self._left = device, most
        self.in_real_time = device.in_real_time

    @property
    def used_s(self) -> float:  # type: ignore[override]
        """Device time [s]."""
        return self._device.used_s

    def explore(self, name: str, phase: Phase, bench: BenchSettings) -> None:
        self._device.explore(name, phase, bench)

    def play(self, name: str, commands: Vec, bench: BenchSettings) -> Trial:
        """Play as the device, up to the last recording.

        Raises:
            RecordedError: after the last one.
        """
        trial = self._device.play(name, commands, bench)
        self._left -= 1
        if not self._left:
            raise RecordedError("recorded")
        return trial

    def track(self, name: str, tip: AnyTip, reference: AnyMotion, bench: BenchSettings) -> Track:
        return self._device.track(name, tip, reference, bench)


PLANNER = Path(__file__).resolve().parents[2] / "ros2" / "hystmpc_ros" / "hystmpc_ros" / "planner.py"
"""The part of the ROS 2 node that knows no ROS."""


def _planner() -> ModuleType:
    spec = importlib.util.spec_from_file_location("hystmpc_ros_planner", PLANNER)
    if spec is None or spec.loader is None or not PLANNER.exists():
        raise ConfigError(f"{PLANNER}: is not there, expected a checkout of the package; leave out --mover ros2")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _ros2(settings: dict[str, Any], folder: Path, how: How) -> Move:
    bench = BenchSettings.parse({**settings, "realtime": {"backend": "python"}})
    config = folder / "tip.yaml"
    ladder = {"safe_command": SAFE}
    config.write_text(dump_yaml({"model": "builtin:pi", "controller": {"kind": how.law, "ladder": ladder}}))
    clock, steering = SimulatedClock(), Steering(config)
    plants = plants_in(Path(), bench.command_unit)
    transport = bench.transport.open(RunContext(Conversion(1.0, 0.0, 1.0), bench.dt_s, clock.now_ns, plants))
    node = _planner().Planner(bench, steering, transport, clock)
    return lambda: _steered(node, steering.tip, clock, bench.dt_s)


def _steered(node: Any, tip: TipController, clock: SimulatedClock, dt_s: float) -> Ending:
    """Run the ROS 2 node while it is given targets, or until it has stopped."""
    targets, said = list(_ROS_TARGETS_DEG), ""
    for k in range(round(_ROS_S / dt_s)):
        _turn(node, clock, dt_s)
        if tip.state().stopped:
            said = str(node.status)
            break
        if not node.over and k * dt_s >= _ROS_STAYS_S * (len(_ROS_TARGETS_DEG) - len(targets)) and targets:
            tip.set_target(targets.pop(0))
    for _ in range(round(_ROS_STAYS_S / dt_s)):  # time for a stop in progress
        _turn(node, clock, dt_s)
    node.leave("the node is ended")
    for _ in range(round(_ROS_STAYS_S / dt_s)):
        _turn(node, clock, dt_s)
        if node.over:
            break
    node.close()
    return Ending("stopped", said, tip.state().stopped) if said else Ending("ended")


def _turn(node: Any, clock: SimulatedClock, dt_s: float) -> None:
    """Execute one sample of a timer that calls late after a long computation of the node."""
    period = round(1e9 * dt_s)
    clock.wait_until(clock.now_ns() // period * period + period)
    node.sample()


_MOVERS: Mapping[Mover, Callable[[dict[str, Any], Path, How], Move]] = {
    "run": _run,
    "record": _record,
    "commission": _commission,
    "investigate": _investigate,
    "ros2": _ros2,
}
