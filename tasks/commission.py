"""Commissioning of a device, or of its logs: from a device to a verified controller."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Progress

from .inputs import Say, Settings, allow_classes, changed

if TYPE_CHECKING:
    from hystmpc.bench.commission import Commissioned
    from hystmpc.bench.config import CommissionSettings


@dataclass(frozen=True)
class DevicePlan:
    """What a device is going to do, said before anything moves.

    Attributes:
        title: name and place of the device.
        rows: stage, its motions, and minutes of device time.
        limits: within which it moves, in a sentence.
    """

    title: str
    rows: tuple[tuple[str, str, float], ...]
    limits: str


def commission(
    config: Settings | None,
    out: Path | str | None,
    *,
    logs: Iterable[Path | str] = (),
    overrides: Iterable[str] = (),
    reset: bool = False,
    live: bool = False,
    page: bool = False,
    allow_python: bool = False,
    progress: Progress | None = None,
    say: Say | None = None,
) -> Commissioned:
    """From a device to a verified controller: range, recordings, model, controller, verification, report.

    The device moves for five minutes at most, in real time; one of `kind: simulated` is computed faster. The same call
    goes on after the last complete stage.

    Args:
        config: a bench with the block `commission`: a YAML file or a mapping; may be None with logs.
        out: a new or empty folder, or one in which the same commissioning was begun.
        logs: recordings in place of a device: files or folders; it then ends before the verification.
        overrides: changes of the settings, such as `commission.minutes=4`.
        reset: release a latched stop first: somebody has looked at the device.
        live, page: show angle, command, timing and faults in the terminal, on a local page.
        allow_python: import classes that the file names as `python: MODULE:CLASS`; you trust it.
        progress: called with seconds done, seconds expected and a note.
        say: called with what the process at the device says.

    Returns:
        Files of controller, model and report, and the verdict.

    Raises:
        HystmpcError: if a setting is wrong, the folder holds something else, the device does not answer, or a motion
            was stopped safely; complete trials are kept.
        ConfigError: if there is neither a bench nor logs.
    """
    from hystmpc.bench.commission import commission_device, commission_logs
    from hystmpc.bench.device import opened_device
    from hystmpc.rig.recording.recorder_process import Views
    from hystmpc.rig.run import reset_latch

    allow_classes(allow_python)
    files, changes = list(logs), list(overrides)
    if config is None and not files:
        raise ConfigError("commission: lacks CONFIG, expected a bench file, or --logs with recordings")
    if config is None and changes:
        raise ConfigError("commission: --set does nothing without CONFIG, expected a bench file")
    if out is None:
        raise ConfigError("commission: lacks --out, expected a folder")
    settings = None if config is None else _settings(config, changes)
    if files or settings is None or config is None:
        return commission_logs(files, out, settings, progress)
    if reset:
        reset_latch(settings)
    device = opened_device(settings, folder_of(config), Views(live, page), say or silent)
    return commission_device(settings, device, out, progress)


def commission_plan(config: Settings, overrides: Iterable[str] = (), *, allow_python: bool = False) -> DevicePlan:
    """Stages, motions, minutes and limits of a commissioning; nothing moves.

    Raises:
        ConfigError: if a setting is wrong.
    """
    from hystmpc.bench.commission import plan_rows
    from hystmpc.bench.motions import budget

    allow_classes(allow_python)
    settings = _settings(config, overrides)
    return planned(settings, plan_rows(settings, budget(settings)))


def planned(settings: CommissionSettings, rows: Iterable[tuple[str, str, float]]) -> DevicePlan:
    """A plan with the place and limits of its device."""
    where = "computed, faster than time" if settings.transport.in_process else settings.transport.place
    limits, unit, (low, high) = settings.limits, settings.command_unit, settings.angle_limits
    text = (
        f"limits: command {limits.lower:g} to {limits.upper:g} {unit} at {limits.rate_per_s:g} {unit}/s, angle {low:g} "
        f"to {high:g} deg; every motion starts and ends at {settings.safe_command:g} {unit}"
    )
    return DevicePlan(f"{settings.name} ({where}): minutes of device time", tuple(rows), text)


def folder_of(config: Settings) -> Path:
    """Folder in which file names of a bench start."""
    return Path(config).resolve().parent if isinstance(config, Path | str) else Path()


def _settings(config: Settings, overrides: Iterable[str]) -> CommissionSettings:
    from hystmpc.bench.config import CommissionSettings, load_commission, located_commission

    if isinstance(config, Path | str):
        return load_commission(config, overrides)
    return located_commission(CommissionSettings.parse(changed(config, overrides)), Path())


def silent(text: str) -> None:
    """Say nothing."""
    del text
