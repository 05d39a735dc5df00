"""`hystmpc faults --devices`: hostile and healthy devices with everything that moves one, as a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING

import typer
from rich.console import Console

from hystmpc.cli.bars import bar
from hystmpc.cli.console import errors, out, table
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.run_folder import require_vacant

if TYPE_CHECKING:
    from ..faults.devices import DevicePlay
    from ..faults.truth import DeviceVerdict

FAILED = 1
"""Exit code of a campaign in which something is not as it has to be."""

_COLUMNS = ("device", "mover", "does", "commands", "beyond", "shows at s", "moves on s", "past deg")
_WIDTH = 132


def play_devices(folder: Path, only: Sequence[str], movers: Sequence[str], jobs: int) -> None:
    """Play them, show the table, and what failed.

    Args:
        only: parts of names; all devices where empty.
        movers: all where empty.
        jobs: processes.

    Raises:
        ConfigError: on an unknown device or mover, or a folder that is not empty.
        typer.Exit: with 1 if a device fails.
    """
    from ..faults.devices import played_all

    plays = _chosen(only, movers)
    require_vacant(folder)
    verdicts: list[DeviceVerdict] = []
    try:
        with bar("devices", len(plays)) as show:
            for verdict in played_all(plays, folder, jobs):
                verdicts.append(verdict)
                show(len(verdicts), f"{verdict.mover}: {verdict.name}")
    finally:  # an interrupted campaign shows what it has found
        _show(verdicts)
    failed = [v for v in verdicts if not v.passed]
    for v in failed:
        text = f"failed: {v.name}, {v.mover}: {'; '.join(v.failures)}"
        errors.print(text, style="red", soft_wrap=True, markup=False, highlight=False)
    healthy = sum(v.healthy for v in verdicts)
    out.print(f"{len(verdicts)} plays, {healthy} of them with healthy devices; {len(failed)} not as they have to be")
    if failed:
        raise typer.Exit(FAILED)


def _chosen(only: Sequence[str], movers: Sequence[str]) -> tuple[DevicePlay, ...]:
    from ..faults.devices import device_cases, device_plays
    from ..faults.truth import MOVERS

    if unknown := sorted(set(movers) - set(MOVERS)):
        raise ConfigError(f"--mover: got {', '.join(unknown)}, available: {', '.join(MOVERS)}")
    plays = device_plays(device_cases(), tuple(m for m in MOVERS if not movers or m in movers))
    chosen = tuple(play for play in plays if not only or any(text in play.name for text in only))
    if not chosen:
        names = "; ".join(dict.fromkeys(play.case.name for play in plays))
        raise ConfigError(f"--only: got {', '.join(only)}, available: {shorten(names, 200, placeholder=' ...')}")
    return chosen


def _show(verdicts: Sequence[DeviceVerdict]) -> None:
    rows = [
        [
            v.name,
            v.mover,
            v.how,
            str(v.commands),
            str(v.beyond),
            _number(v.shows_s),
            _number(v.moved_s if math.isfinite(v.shows_s) else math.nan),
            _number(v.past_deg),
        ]
        for v in verdicts
    ]
    grid = table("devices on a computed clock, judged by their own logs", _COLUMNS, rows)
    Console(width=max(out.width, _WIDTH)).print(grid)
    out.print("what the user sees:")
    for v in verdicts:
        if v.words:
            out.print(f"  {v.name}, {v.mover}: {v.words}", soft_wrap=True, markup=False, highlight=False)


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}"
