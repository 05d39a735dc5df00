"""`hystmpc faults`: the fault campaigns, over real connections or on devices that are computed, as a table."""

from __future__ import annotations

import math
import os
import signal
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console

from hystmpc.cli.bars import bar
from hystmpc.cli.console import errors, out, table
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.run_folder import require_vacant

from ..faults.cases import CASES, FaultCase
from .fault_devices import FAILED, play_devices

if TYPE_CHECKING:
    from ..faults.cases import Kind, Link
    from ..faults.judge import FaultVerdict

_COUNTS = ("commands", "beyond", "safe after s", "rise after fault mm")
_COLUMNS = ("fault", "over", "has to", "does", *_COUNTS, "log", "says")
_WIDTH = 132
_DOMAINS = range(10, 100)  # of DDS; beyond 100 their ports lie among those that the system gives away


@dataclass(frozen=True)
class _Play:
    """One case over one wire, and its folder."""

    case: FaultCase
    link: Link
    folder: Path


def faults(
    folder: Annotated[Path, typer.Option("--out", help="Folder for the cases, new or empty.")],
    only: Annotated[list[str] | None, typer.Option("--only", help="A part of a case's name; may be repeated.")] = None,
    transport: Annotated[
        Literal["udp", "dds", "both"] | None, typer.Option("--transport", help="The wires; both where left out.")
    ] = None,
    backend: Annotated[
        Literal["python", "c"] | None, typer.Option("--backend", help="What steps the controller; c leaves out frames.")
    ] = None,
    jobs: Annotated[int, typer.Option("--jobs", min=1, help="Cases at a time; more than cores spoils timing.")] = 1,
    devices: Annotated[
        bool, typer.Option("--devices", help="Hostile and healthy devices in place of faults of the wire.")
    ] = False,
    mover: Annotated[
        list[str] | None, typer.Option("--mover", help="With --devices: run, record, commission, investigate, ros2.")
    ] = None,
) -> None:
    """Break sensor, wire, processes, disk, model and solver, case by case; exit code 1 if a case fails.

    With --devices every program that moves a device meets hostile and healthy ones, on a clock that is computed.
    """
    _check(devices, mover, transport, backend)
    if devices:
        play_devices(folder, only or [], mover or [], jobs)
        return
    plays = _chosen(folder, only or [], transport or "both", backend or "python")
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # no device may be left behind
    verdicts: list[FaultVerdict] = []
    try:
        with bar("faults", len(plays)) as show:
            for verdict in _judged(plays, jobs):
                verdicts.append(verdict)
                show(len(verdicts), verdict.name)
    finally:  # an interrupted campaign shows what it has found
        _show(verdicts)
    failed = [v for v in verdicts if not v.passed]
    if failed:
        for v in failed:
            text = f"failed: {v.name}, {v.wire}: {', '.join(v.failures)}"
            errors.print(text, style="red", soft_wrap=True, markup=False, highlight=False)
        raise typer.Exit(FAILED)
    out.print(f"{len(verdicts)} cases, all as they have to be; no command beyond the limits")


def _check(devices: bool, mover: list[str] | None, transport: str | None, backend: str | None) -> None:
    """Refuse a call that says something that would do nothing."""
    if devices and (transport or backend):
        raise ConfigError("--devices: got --transport or --backend, expected neither: its wires are its own")
    if mover and not devices:
        raise ConfigError("--mover: got no --devices, expected it beside --mover")


def _chosen(folder: Path, only: list[str], transport: str, backend: str) -> list[_Play]:
    """The cases to play, in a folder that is new or empty.

    Raises:
        ConfigError: on an unknown case, a wire whose package is missing, or a folder that is not empty.
    """
    from hystmpc.rig.transports.dds import require_dds

    from ..faults.cases import KINDS, Link

    kinds: list[Kind] = [kind for kind in KINDS if transport in (kind, "both")]
    if "dds" in kinds:
        require_dds()
    known = [case.stepped_by(backend) for case in CASES if backend == "python" or case.has_c]
    chosen = [case for case in known if not only or any(text in case.name for text in only)]
    wanted: list[tuple[FaultCase, Kind]] = [
        (case, kind) for kind in kinds for case in chosen if kind == "udp" or not case.of_datagrams
    ]
    if not wanted:
        names = "; ".join(case.name for case in known if "udp" in kinds or not case.of_datagrams)
        raise ConfigError(
            f"--only: got {', '.join(only)}, available over {transport}: {shorten(names, 180, placeholder=' ...')}"
        )
    require_vacant(folder)
    first = os.getpid()  # two campaigns at a time keep apart
    domains = (_DOMAINS[(first + k) % len(_DOMAINS)] for k in range(len(wanted)))
    return [
        _Play(case, Link(kind, domain=domain), folder / f"{k:02d}_{kind}")
        for k, ((case, kind), domain) in enumerate(zip(wanted, domains, strict=True))
    ]


def _judged(plays: list[_Play], jobs: int) -> Iterator[FaultVerdict]:
    """The verdicts, in the order of the cases; on an interruption the cases under way come to their end."""
    from ..faults.judge import judge
    from ..faults.play import play

    def one(this: _Play) -> FaultVerdict:
        return judge(this.case, play(this.case, this.folder, this.link))

    if jobs == 1:  # in this thread, so that an interruption ends its processes at once
        yield from map(one, plays)
        return
    pool = ThreadPoolExecutor(jobs)
    try:
        yield from pool.map(one, plays)
    finally:
        pool.shutdown(cancel_futures=True)


def _show(verdicts: list[FaultVerdict]) -> None:
    rows = [
        [
            v.name,
            v.wire,
            v.expected,
            v.got,
            str(v.commands),
            str(v.beyond),
            _number(v.safe_s),
            _number(v.rise_mm),
            v.log,
        ]
        + [v.claim or "-"]
        for v in verdicts
    ]
    grid = table("fault campaign, device and controller in two processes", _COLUMNS, rows)
    Console(width=max(out.width, _WIDTH)).print(grid)  # a narrow terminal breaks its lines; a file keeps them
    out.print("what the user sees:")
    for v in verdicts:
        out.print(f"  {v.name}, {v.wire}: {v.seen}", soft_wrap=True, markup=False, highlight=False)


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}"
