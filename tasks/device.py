"""Tasks on a device that moves: its commissioning, and the investigation of a simulator's gap."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hystmpc.trials.config import read_yaml
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Progress

from .inputs import Say, Settings, allow_classes, settings_of

if TYPE_CHECKING:
    from hystmpc.bench.commission import Commissioned
    from hystmpc.bench.config import CommissionSettings, InvestigateSettings
    from hystmpc.bench.device import Open
    from hystmpc.bench.rounds import Investigated


@dataclass(frozen=True)
class DevicePlan:
    """Plan of the motions of a device.

    Attributes:
        rows: stage, its motions, and minutes of device time.
        limits: limits of the motion, in a sentence.
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
    """Commission a device: safe range, recordings, model, controller, verification, report.

    The device moves for five minutes at most, one of two axes for ten, in real time; one of `kind: simulated` is
    computed faster. The same call goes on after the last complete stage.

    Args:
        config: a bench with the block `commission`: a YAML file or a mapping; may be None with logs.
        out: a new or empty folder, or one in which the same commissioning was begun.
        logs: recordings, or folders of them, in place of the device; nothing is verified then.
        overrides: change a setting of the file: KEY.KEY=VALUE.
        reset: release a latched stop first: somebody has looked at the device.
        live: show angle, command, timing and faults in the terminal.
        page: show them on a local page.
        allow_python: import classes that the file names as python: MODULE:CLASS; you trust it.
        progress: called with seconds done, seconds expected and a note.
        say: called with each message of the process at the device.

    Returns:
        Files of controller, model and report, and the verdict.

    Raises:
        HystmpcError: if a setting is wrong, the folder holds something else, the device does not answer, or a motion
            was stopped safely; complete trials are kept.
        ConfigError: if there is neither a bench nor logs.
    """
    from hystmpc.bench.commission import commission_device, commission_logs

    allow_classes(allow_python)
    files, changes = list(logs), list(overrides)
    if config is None and not files:
        raise ConfigError("commission: lacks CONFIG, expected a bench file, or --logs with recordings")
    if config is None and changes:
        raise ConfigError("commission: --set does nothing without CONFIG, expected a bench file")
    if out is None:
        raise ConfigError("commission: lacks --out, expected a folder")
    settings = None if config is None else _commissioning(config, changes)
    if files or settings is None or config is None:
        return commission_logs(files, out, settings, progress)
    return commission_device(settings, _opened(settings, config, reset, live, page, say), out, progress)


def commission_plan(config: Settings, overrides: Iterable[str] = (), *, allow_python: bool = False) -> DevicePlan:
    """Plan of a commissioning: stages, motions, minutes and limits; the device does not move.

    Raises:
        ConfigError: if a setting is wrong.
    """
    from hystmpc.bench.commission import plan_rows
    from hystmpc.bench.motions import budget

    allow_classes(allow_python)
    settings = _commissioning(config, overrides)
    return _planned(settings, plan_rows(settings, budget(settings)))


def investigate(
    config: Settings,
    out: Path | str | None,
    *,
    model: Path | str | None = None,
    minutes: float | None = None,
    overrides: Iterable[str] = (),
    reset: bool = False,
    live: bool = False,
    page: bool = False,
    allow_python: bool = False,
    progress: Progress | None = None,
    say: Say | None = None,
) -> Investigated:
    """Find the causes of the gap between a simulator and its device by recording and diagnosing in turn.

    The device moves for the minutes given at most, in real time; one of `kind: simulated` is computed faster. The same
    call goes on after the last complete part. Of two axes, what joins them is judged, and then each axis.

    Args:
        config: a bench of one axis or of two with the block `investigate`: a YAML file or a mapping.
        out: a new or empty folder, or one in which the same investigation was begun.
        model: simulator to be judged (.yaml), in place of that of the file; without either one is identified first.
        minutes: device time, never exceeded.
        overrides: change a setting of the file: KEY.KEY=VALUE.
        reset: release a latched stop first: somebody has looked at the device.
        live: show angle, command, timing and faults in the terminal.
        page: show them on a local page.
        allow_python: import classes that the file names as python: MODULE:CLASS; you trust it.
        progress: called with device time used, device time allowed [s] and a note.
        say: called with each message of the process at the device.

    Returns:
        Verdict of each round, reason of the end, and files of report and corrected simulator.

    Raises:
        HystmpcError: if a setting is wrong, the folder holds something else, the device does not answer, or a motion
            was stopped safely; complete trials are kept.
        ConfigError: if there is no folder.
    """
    from hystmpc.bench.investigate import investigate_device

    allow_classes(allow_python)
    if out is None:
        raise ConfigError("investigate: lacks --out, expected a folder")
    settings = _investigation(config, overrides, model, minutes)
    return investigate_device(settings, _opened(settings, config, reset, live, page, say), out, progress)


def investigation_plan(
    config: Settings,
    overrides: Iterable[str] = (),
    *,
    model: Path | str | None = None,
    minutes: float | None = None,
    allow_python: bool = False,
) -> DevicePlan:
    """Plan of an investigation: parts, motions, minutes and limits; the device does not move.

    Raises:
        ConfigError: if a setting is wrong.
        ModelError: if a built-in simulator is unknown.
    """
    from hystmpc.bench.investigate import plan_rows

    allow_classes(allow_python)
    settings = _investigation(config, overrides, model, minutes)
    return _planned(settings, plan_rows(settings))


def _planned(settings: CommissionSettings, rows: Iterable[tuple[str, str, float]]) -> DevicePlan:
    from hystmpc.rig.axes import in_words, together

    where = "computed, faster than time" if settings.transport.in_process else settings.transport.place
    limits, unit, (low, high) = settings.axes_limits, settings.command_unit, settings.angle_limits
    lower, upper, rate = (
        in_words(together(getattr(one, name) for one in limits), "g") for name in ("lower", "upper", "rate")
    )
    text = (
        f"limits: command {lower} to {upper} {unit} at {rate} {unit}/s, angle {low:g} "
        f"to {high:g} deg; every motion starts and ends at {in_words(settings.safe_command, 'g')} {unit}"
    )
    if len(limits) > 1:
        text += "; not done for two axes: a watch on forces; drift over hours"
    return DevicePlan(f"{settings.name} ({where}): minutes of device time", tuple(rows), text)


def _opened(
    settings: CommissionSettings, config: Settings, reset: bool, live: bool, page: bool, say: Say | None
) -> Open:
    """Function that opens the device of a bench; `reset` releases a latched stop."""
    from hystmpc.bench.device import opened_device
    from hystmpc.rig.recording.recorder_process import Views
    from hystmpc.rig.run import reset_latch

    if reset:
        reset_latch(settings)
    return opened_device(settings, _folder_of(config), Views(live, page), say or (lambda text: None))


def _folder_of(config: Settings) -> Path:
    return Path(config).resolve().parent if isinstance(config, Path | str) else Path()


def _commissioning(config: Settings, overrides: Iterable[str]) -> CommissionSettings:
    from hystmpc.bench.config import kind_of_commission, located_commission

    folder = _folder_of(config)
    kind = kind_of_commission(_plain(config), folder)
    return located_commission(settings_of(kind, config, overrides), folder)


def _plain(config: Settings) -> object:
    """Plain data of a bench; what cannot be read is none, and is refused by whoever reads it next."""
    try:
        return read_yaml(config) if isinstance(config, Path | str) else config
    except ConfigError:
        return None


def _investigation(
    config: Settings, overrides: Iterable[str], model: Path | str | None, minutes: float | None
) -> InvestigateSettings:
    from hystmpc.bench.config import (
        InvestigateSettings,
        PlaneCommissionSettings,
        PlaneInvestigateSettings,
        kind_of_commission,
        located_investigation,
    )

    two = kind_of_commission(_plain(config), _folder_of(config)) is PlaneCommissionSettings
    settings = settings_of(PlaneInvestigateSettings if two else InvestigateSettings, config, overrides)
    return located_investigation(settings, _folder_of(config), model, minutes)
