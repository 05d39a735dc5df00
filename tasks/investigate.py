"""Investigation of a simulator's gap on the device: record, diagnose, record what decides most."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Progress

from .commission import DevicePlan, folder_of, planned, silent
from .inputs import Say, Settings, allow_classes, changed

if TYPE_CHECKING:
    from hystmpc.bench.config import InvestigateSettings
    from hystmpc.bench.rounds import Investigated


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
    """Find out why a simulator and its device differ: record, diagnose, record what decides most, until it has a name.

    The device moves for the minutes given at most, in real time; one of `kind: simulated` is computed faster. The same
    call goes on after the last complete part.

    Args:
        config: a bench with the block `investigate`: a YAML file or a mapping.
        out: a new or empty folder, or one in which the same investigation was begun.
        model: simulator to be judged, in place of that of the block; one is identified first where there is none.
        minutes: of device time, in place of those of the block.
        overrides: changes of the settings, such as `investigate.seed=2`.
        reset: release a latched stop first: somebody has looked at the device.
        live, page: show angle, command, timing and faults in the terminal, on a local page.
        allow_python: import classes that the file names as `python: MODULE:CLASS`; you trust it.
        progress: called with device time used, device time allowed [s] and a note.
        say: called with what the process at the device says.

    Returns:
        The verdict round by round, what ended it, and files of report and corrected simulator.

    Raises:
        HystmpcError: if a setting is wrong, the folder holds something else, the device does not answer, or a motion
            was stopped safely; complete trials are kept.
        ConfigError: if there is no folder.
    """
    from hystmpc.bench.device import opened_device
    from hystmpc.bench.investigate import investigate_device
    from hystmpc.rig.recording.recorder_process import Views
    from hystmpc.rig.run import reset_latch

    allow_classes(allow_python)
    if out is None:
        raise ConfigError("investigate: lacks --out, expected a folder")
    settings = _settings(config, overrides, model, minutes)
    if reset:
        reset_latch(settings)
    device = opened_device(settings, folder_of(config), Views(live, page), say or silent)
    return investigate_device(settings, device, out, progress)


def investigation_plan(
    config: Settings,
    overrides: Iterable[str] = (),
    *,
    model: Path | str | None = None,
    minutes: float | None = None,
    allow_python: bool = False,
) -> DevicePlan:
    """Parts, motions, minutes and limits of an investigation; nothing moves.

    Raises:
        ConfigError: if a setting is wrong.
        ModelError: if a built-in simulator is unknown.
    """
    from hystmpc.bench.investigate import plan_rows

    allow_classes(allow_python)
    settings = _settings(config, overrides, model, minutes)
    return planned(settings, plan_rows(settings))


def _settings(
    config: Settings, overrides: Iterable[str], model: Path | str | None, minutes: float | None
) -> InvestigateSettings:
    from hystmpc.bench.config import InvestigateSettings, load_investigation, located_investigation

    if isinstance(config, Path | str):
        settings = load_investigation(config, overrides)
    else:
        settings = InvestigateSettings.parse(changed(config, overrides))
    return located_investigation(settings, folder_of(config), model, minutes)
