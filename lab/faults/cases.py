"""Cases of the fault campaign: the fault, the required outcome, and the configurations at the start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from hystmpc.models.load import model_path
from hystmpc.trials.config import dump_yaml

# The run goes on to its end; is stopped safely by the controller; is left by a controller that is gone, so that the
# device's own watchdog acts; ends before anything moves.
Ending = Literal["goes on", "stops", "left alone", "refuses"]
_AT_S = 3.0
_DEAD_S = 1.0  # `dead_after_s` 0.5, and 0.5 s for data in transit and for a busy machine
_STRAY_S = 2.0  # a device that does not follow: twice `dead_after_s`, and the same
_IMPLAUSIBLE_S = 4.0  # travel time before a constant angle is implausible
_FAILS = {"drill": {"solver_fails_from_s": 2.0, "solver_fails_for_s": 0.4}}
_FAILS_ON = {"drill": {"solver_fails_from_s": 2.0, "solver_fails_for_s": 1000.0}}
_LONG = {"reference": {"cycles": 16}}  # long enough for a second run to be refused meanwhile
_FAST = {"reference": {"frequency_hz": 0.8, "cycles": 8}}
_SLOW_RETURN = {"watchdog_rate_per_s": 0.1}  # a second run starts during the return of the device
_SOFT = {"ramps": {"brake_per_s2": 20.0}}  # v^2 / 2a is twenty times the overshoot
# Sensors other than the continuous one: block `sensor` of the device, and the one of the run.
_FRAMES = (
    {"kind": "intermittent", "rate_hz": 5.0, "latency_s": 0.2, "noise_deg": 0.3},
    {"kind": "intermittent", "latency_s": 0.2},
)
_NO_SENSOR = ({"kind": "none"}, {"kind": "none", "rest_deg": 30.0})
_GAP_S = 2.5  # `longest_gap_s` 2, and half a second as above
_HIGHER = {"limits": {"lower": 1.0}, "safe_command": 1.0}  # the device holds 0
RATE_HZ = 25.0
LOWER, UPPER, RATE_PER_S, SAFE = 0.0, 6.0, 10.0, 0.0
OVERSHOOT = min(0.2, 0.02 * (UPPER - LOWER))
"""How far a device may move away from the safe command after a fault [mm]."""
IN_FLIGHT_S = 1.5 / RATE_HZ
"""How long after a fault a command that had left before may still come to the device and move it [s]."""
Kind = Literal["udp", "dds"]
KINDS: tuple[Kind, ...] = ("udp", "dds")
DEVICE: Mapping[str, Any] = {
    "rate_hz": RATE_HZ,
    "command_unit": "mm",
    "plant": {"simulator": "builtin:tendon-catheter", "noise_deg": 0.15},
    "limits": {"lower": LOWER, "upper": UPPER, "rate_per_s": RATE_PER_S},
    "link": {"kind": "udp", "bind_port": 0},
    "watchdog_s": 0.5,
    "watchdog_rate_per_s": 2.0,
    "log": "device.csv",
    "seed": 1,
}


@dataclass(frozen=True)
class SecondRun:
    """Second run on the same device, which has to be refused.

    Attributes:
        arguments: of `hystmpc run`, beside configuration and folder.
        after_fault: start it after the fault; else the fault waits until it has been refused.
    """

    arguments: tuple[str, ...]
    after_fault: bool = False


@dataclass(frozen=True)
class FaultCase:
    """One fault of the campaign.

    Attributes:
        device: faults of the wire, as in a device's configuration.
        drive: other changes of the device's configuration, nested.
        settings: changes of the run's configuration, nested.
        kill: process that gets `signal` at `at_s`, or as soon as `height` and `rising_per_s` are reached.
        at_s: when the fault begins, seconds after the first command.
        height: the signal waits until the device holds at least this command [mm]; None waits for `at_s`.
        rising_per_s: and until that command rises at least that fast [mm/s].
        pause_s: how long a SIGSTOP lasts [s].
        notice_s: the longest time from the fault until the controller must stop moving away from the safe command [s]:
            what its sensor's and plausibility's settings allow.
        terminal: the controller runs in a terminal of its own: SIGINT is a typed Ctrl-C, SIGHUP closes the terminal.
        file_limit_bytes: greatest size of any file that the controller may write, None for no limit: a full disk.
        corrupt_model: give the controller half of a model file.
    """

    name: str
    expected: Ending
    device: tuple[Mapping[str, Any], ...] = ()
    drive: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    kill: Literal["device", "controller"] | None = None
    signal: str = "SIGKILL"
    at_s: float = 3.0
    height: float | None = None
    rising_per_s: float = 0.0
    pause_s: float = 2.0
    notice_s: float = 0.0
    terminal: bool = False
    restart: bool = False
    second: SecondRun | None = None
    file_limit_bytes: int | None = None
    corrupt_model: bool = False

    def stepped_by(self, backend: str) -> FaultCase:
        """Same case with another `realtime.backend`."""
        return replace(self, settings={**self.settings, "realtime": {"backend": backend}})

    @property
    def has_c(self) -> bool:
        """Whether the loop in C can take its samples; those with frames it leaves to Python."""
        return self.settings.get("sensor", {}).get("kind") != "intermittent"

    @property
    def of_datagrams(self) -> bool:
        """Whether it needs access to datagrams, so that it can be played over UDP only."""
        return any(fault.get("of") == "commands" or fault["fault"] == "corrupt" for fault in self.device)

    @property
    def device_gone(self) -> bool:
        """Whether the device is killed for good, so that nobody can bring it to the safe command."""
        return self.kill == "device" and self.signal == "SIGKILL" and not self.restart


def _wire(name: str, expected: Ending, fault: str, notice_s: float = _DEAD_S, **more: float) -> FaultCase:
    return FaultCase(name, expected, ({"fault": fault, "start_s": _AT_S, **more},), notice_s=notice_s)


def _commands(name: str, expected: Ending, fault: str, **more: float) -> FaultCase:
    faults = ({"fault": fault, "of": "commands", "start_s": _AT_S, **more},)
    return FaultCase(name, expected, faults, notice_s=_STRAY_S + more.get("delay_s", 0.0))


def _sensed(case: FaultCase, sensor: tuple[Mapping[str, Any], Mapping[str, Any]]) -> FaultCase:
    device, run = sensor
    return replace(case, drive={**case.drive, "sensor": device}, settings={**case.settings, "sensor": run})


def _strike(name: str, expected: Ending, signal: str, **more: Any) -> FaultCase:
    return FaultCase(name, expected, kill="controller", signal=signal, **more)


_OTHER_NAME = SecondRun(("--set", "name=other", "--set", "latch_file=other.json"))
_RESET = SecondRun(("--reset", "--set", "start_command=0"), after_fault=True)

CASES: tuple[FaultCase, ...] = (
    FaultCase("no fault", "goes on"),
    _wire("sensor frozen", "stops", "freeze"),
    _wire("sensor NaN", "stops", "nan"),
    _wire("sensor out of range", "stops", "out_of_range"),
    _wire("tip blocked", "stops", "blocked", _IMPLAUSIBLE_S),
    _wire("sensor dislodged", "stops", "dislodged", _IMPLAUSIBLE_S, size_deg=10.0),
    _wire("outliers, 10 % of readings", "goes on", "outlier", share=0.1, duration_s=4.0),
    _wire("outliers, all readings", "stops", "outlier", size_deg=80.0),
    _wire("dropout, 1 sample", "goes on", "dropout", duration_s=0.04),
    _wire("dropout, 0.3 s", "goes on", "dropout", duration_s=0.3),
    _wire("dropout, 1 s", "stops", "dropout", duration_s=1.0),
    _wire("dropout, 5 s", "stops", "dropout", duration_s=5.0),
    _wire("packets 0.3 s late", "stops", "delay", delay_s=0.3),
    _wire("packets up to 60 ms late", "goes on", "jitter", delay_s=0.06),
    _wire("packets reordered", "goes on", "reorder"),
    _wire("packets duplicated", "goes on", "duplicate"),
    _wire("old packets replayed", "goes on", "replay"),
    _wire("packets corrupted, 30 %", "goes on", "corrupt", share=0.3),
    _commands("command lost, 1 sample", "goes on", "dropout", duration_s=0.04),
    _commands("commands lost, 30 %", "goes on", "dropout", share=0.3),
    _commands("commands lost, 0.3 s", "goes on", "dropout", duration_s=0.3),
    _commands("commands lost, 5 s", "stops", "dropout", duration_s=5.0),
    _commands("commands up to 60 ms late", "goes on", "jitter", delay_s=0.06),
    _commands("commands 1 s late", "stops", "delay", delay_s=1.0),
    _commands("commands reordered", "goes on", "reorder"),
    _commands("commands duplicated", "goes on", "duplicate"),
    _commands("old commands replayed", "goes on", "replay"),
    _commands("commands corrupted, 30 %", "goes on", "corrupt", share=0.3),
    _commands("all commands corrupted", "stops", "corrupt"),
    _wire("device clock back by 1 h", "stops", "stamp_jump", delay_s=-3600.0),
    _wire("device clock ahead by 1 h", "goes on", "stamp_jump", delay_s=3600.0),
    FaultCase("device beyond the limits", "refuses", settings=_HIGHER),
    FaultCase("a brake that is too weak", "refuses", settings=_SOFT),
    FaultCase("device killed", "stops", kill="device"),
    FaultCase("device killed, restarted", "stops", kill="device", restart=True),
    FaultCase("device paused 0.3 s", "goes on", kill="device", signal="SIGSTOP", pause_s=0.3),
    FaultCase("device paused 2 s", "stops", kill="device", signal="SIGSTOP", notice_s=_DEAD_S),
    _strike("controller killed", "left alone", "SIGKILL"),
    _strike("killed, then a refused run", "left alone", "SIGKILL", height=4.0, drive=_SLOW_RETURN, second=_RESET),
    FaultCase("second run of another name", "goes on", settings=_LONG, second=_OTHER_NAME),
    _strike("the same, then the first one killed", "left alone", "SIGKILL", settings=_LONG, second=_OTHER_NAME),
    _strike("controller SIGTERM", "stops", "SIGTERM"),
    _strike("controller Ctrl-C", "stops", "SIGINT", terminal=True),
    _strike("Ctrl-C while rising fast", "stops", "SIGINT", height=1.0, rising_per_s=5.0, settings=_FAST, terminal=True),
    _strike("terminal closed", "stops", "SIGHUP", terminal=True),
    _strike("controller paused 3 s at 4 mm", "stops", "SIGSTOP", height=4.0, pause_s=3.0),
    FaultCase("disk full", "goes on", file_limit_bytes=20_000),
    FaultCase("model file corrupt", "refuses", corrupt_model=True),
    FaultCase("solver fails for 0.4 s", "goes on", settings=_FAILS),
    FaultCase("solver fails for good", "stops", settings=_FAILS_ON, notice_s=2.0),
    _sensed(FaultCase("frames", "goes on"), _FRAMES),
    _sensed(_wire("frames, none for 1 s", "goes on", "nan", duration_s=1.0), _FRAMES),
    _sensed(_wire("frames, none any more", "stops", "nan", _GAP_S), _FRAMES),
    _sensed(_wire("frames out of range", "stops", "out_of_range", _GAP_S), _FRAMES),
    _sensed(_wire("frames, each twice", "goes on", "duplicate"), _FRAMES),
    _sensed(_wire("frames replayed", "goes on", "replay"), _FRAMES),
    _sensed(_wire("frames, all readings lost", "stops", "dropout", _GAP_S), _FRAMES),
    _sensed(_commands("frames, commands lost, 5 s", "stops", "dropout", duration_s=5.0), _FRAMES),
    _sensed(_strike("frames, controller killed", "left alone", "SIGKILL"), _FRAMES),
    _sensed(FaultCase("frames, solver fails for good", "stops", settings=_FAILS_ON, notice_s=2.0), _FRAMES),
    _sensed(FaultCase("no sensor", "goes on"), _NO_SENSOR),
    _sensed(_wire("no sensor, all readings lost", "stops", "dropout"), _NO_SENSOR),
    _sensed(_wire("no sensor, readings lost, 0.3 s", "goes on", "dropout", duration_s=0.3), _NO_SENSOR),
    _sensed(_commands("no sensor, commands lost, 5 s", "stops", "dropout", duration_s=5.0), _NO_SENSOR),
    _sensed(FaultCase("no sensor, device killed", "stops", kill="device"), _NO_SENSOR),
    _sensed(_strike("no sensor, controller SIGTERM", "stops", "SIGTERM"), _NO_SENSOR),
    _sensed(FaultCase("no sensor, solver fails for good", "stops", settings=_FAILS_ON, notice_s=2.0), _NO_SENSOR),
)

RUN: Mapping[str, Any] = {
    "name": "campaign",
    "rate_hz": RATE_HZ,
    "command_unit": "mm",
    "limits": {"lower": LOWER, "upper": UPPER, "rate_per_s": RATE_PER_S},
    "ramps": {"velocity_per_s": 3.5, "acceleration_per_s2": 70.0, "jerk_per_s3": 10_000.0},
    "safe_command": SAFE,
    "latch_file": "latched.json",
    "sensor": {
        "lower_deg": 0.0,
        "upper_deg": 120.0,
        "rate_limit_deg_s": 400.0,
        "age_limit_s": 0.1,
        "dead_after_s": 0.5,
    },
    "controller": {"model": "builtin:pi"},
    "reference": {
        "kind": "scan_sinusoid",
        "start_deg": 40.0,
        "centre_deg": 55.0,
        "amplitude_deg": 15.0,
        "frequency_hz": 0.4,
        "cycles": 3,
    },
}


@dataclass(frozen=True)
class Link:
    """Connection between device and controller of a case.

    Attributes:
        port: of the device over UDP; 0 lets it choose.
        domain: of DDS; cases that are played at the same time need one each.
    """

    kind: Kind = "udp"
    port: int = 0
    domain: int = 0

    @property
    def of_device(self) -> dict[str, Any]:
        """Block `link` of a device."""
        return {"kind": "udp", "bind_port": self.port} if self.kind == "udp" else self._dds

    @property
    def of_run(self) -> dict[str, Any]:
        """Block `transport` of a run."""
        return {"kind": "udp", "port": self.port} if self.kind == "udp" else self._dds

    @property
    def _dds(self) -> dict[str, Any]:
        return {"kind": "dds", "message": "float64_stamped", "domain": self.domain}


def write_device(case: FaultCase, folder: Path, link: Link = Link()) -> Path:
    """Write `device.yaml`."""
    settings = {**_merged(DEVICE, case.drive), "link": link.of_device, "faults": [dict(f) for f in case.device]}
    path = folder / "device.yaml"
    path.write_text(dump_yaml(settings), encoding="utf-8")
    return path


def write_run(case: FaultCase, folder: Path, link: Link) -> Path:
    """Write `run.yaml` for a device at a link."""
    settings = {**_merged(RUN, case.settings), "transport": link.of_run}
    if case.corrupt_model:
        model = model_path("builtin:pi").read_text(encoding="utf-8")
        (folder / "half.yaml").write_text(model[: len(model) // 6], encoding="utf-8")
        settings["controller"] = {"model": "half.yaml"}
    path = folder / "run.yaml"
    path.write_text(dump_yaml(settings), encoding="utf-8")
    return path


def watchdog_s(case: FaultCase) -> float:
    """Longest time in which the watchdog of the device brings it to the safe command [s]."""
    drive = _merged(DEVICE, case.drive)
    return float(drive["watchdog_s"] + (UPPER - LOWER) / drive["watchdog_rate_per_s"])


def _merged(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    return {
        **settings,
        **{
            key: _merged(settings[key], value)
            if isinstance(value, Mapping) and isinstance(settings.get(key), Mapping)
            else value
            for key, value in changes.items()
        },
    }
