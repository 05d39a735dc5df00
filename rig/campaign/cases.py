"""What goes wrong in the fault campaign, and what has to come of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

# The run goes on to its end; is stopped safely by the controller; is left by a controller that is gone, so that the
# device's own watchdog acts; ends before anything moves.
Ending = Literal["goes on", "stops", "left alone", "refuses"]


@dataclass(frozen=True)
class Case:
    """One fault.

    Attributes:
        name: as the table shows it.
        expected: how the run has to end.
        device: faults of the wire, as in a device's configuration.
        settings: changes of the run's configuration, nested.
        kill: process that gets `signal` at `at_s`.
        signal: its name.
        at_s: when the fault begins, seconds after the first command.
        restart: start the device again after that.
        file_limit_bytes: greatest size of any file that the controller may write, None for no limit: a full disk.
        corrupt_model: give the controller half of a model file.
    """

    name: str
    expected: Ending
    device: tuple[Mapping[str, Any], ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)
    kill: Literal["device", "controller"] | None = None
    signal: str = "SIGKILL"
    at_s: float = 3.0
    restart: bool = False
    file_limit_bytes: int | None = None
    corrupt_model: bool = False


def _wire(name: str, expected: Ending, fault: str, **more: float) -> Case:
    return Case(name, expected, ({"fault": fault, "start_s": 3.0, **more},))


def _commands(name: str, expected: Ending, fault: str, **more: float) -> Case:
    return Case(name, expected, ({"fault": fault, "of": "commands", "start_s": 3.0, **more},))


_FAILS = {"drill": {"solver_fails_from_s": 2.0, "solver_fails_for_s": 0.4}}
_FAILS_ON = {"drill": {"solver_fails_from_s": 2.0, "solver_fails_for_s": 1000.0}}

CASES: tuple[Case, ...] = (
    Case("no fault", "goes on"),
    _wire("sensor frozen", "stops", "freeze"),
    _wire("sensor NaN", "stops", "nan"),
    _wire("sensor out of range", "stops", "out_of_range"),
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
    Case("device killed", "stops", kill="device"),
    Case("device killed, restarted", "stops", kill="device", restart=True),
    Case("device paused 2 s", "stops", kill="device", signal="SIGSTOP"),
    Case("controller killed", "left alone", kill="controller"),
    Case("controller SIGTERM", "stops", kill="controller", signal="SIGTERM"),
    Case("controller Ctrl-C", "stops", kill="controller", signal="SIGINT"),
    Case("controller paused 2 s", "stops", kill="controller", signal="SIGSTOP"),
    Case("disk full", "goes on", file_limit_bytes=20_000),
    Case("model file corrupt", "refuses", corrupt_model=True),
    Case("solver fails for 0.4 s", "goes on", settings=_FAILS),
    Case("solver fails for good", "stops", settings=_FAILS_ON),
)
