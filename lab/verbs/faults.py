"""Verb `hystmpc faults`: the fault campaigns, over real connections or on simulated devices, as a table."""

from __future__ import annotations

import math
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Annotated, Literal, Protocol, TypeVar

import typer
from rich.console import Console

from hystmpc.cli.bars import bar
from hystmpc.cli.console import errors, out, table
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.run_folder import require_vacant

from ..faults.cases import CASES, FaultCase

if TYPE_CHECKING:
    from ..faults.cases import Kind, Link
    from ..faults.devices import DevicePlay
    from ..faults.judge import FaultVerdict
    from ..faults.truth import DeviceVerdict

FAILED = 1
"""Exit code of a campaign in which something is not as it has to be."""

_COUNTS = ("commands", "beyond", "safe after s", "rise after fault mm")
_WIRE_COLUMNS = ("fault", "over", "has to", "does", *_COUNTS, "log", "says")
_DEVICE_COLUMNS = ("device", "mover", "does", "commands", "beyond", "shows at s", "moves on s", "past deg")
_WIDTH = 132
_DOMAINS = range(10, 100)  # of DDS; beyond 100 their ports lie among those that the system gives away


class Verdict(Protocol):
    """Verdict on one case of either campaign."""

    @property
    def name(self) -> str:
        """Name of the case."""
        ...

    @property
    def failures(self) -> tuple[str, ...]:
        """Violated requirements, in words."""
        ...


V = TypeVar("V", bound=Verdict)


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
        Literal["python", "c"] | None, typer.Option("--backend", help="What takes the samples; c leaves out frames.")
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
        _play_devices(folder, only or [], mover or [], jobs)
        return
    plays = _over_wires(folder, only or [], transport or "both", backend or "python")
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # no device may be left behind
    title = "fault campaign, device and controller in two processes"
    verdicts, failed = _told(title, len(plays), _judged(plays, jobs), _WIRE_COLUMNS, _wire_row)
    if failed:
        raise typer.Exit(FAILED)
    out.print(f"{len(verdicts)} cases, all as they have to be; no command beyond the limits")


def _play_devices(folder: Path, only: Sequence[str], movers: Sequence[str], jobs: int) -> None:
    from ..faults.devices import played_all

    plays = _of_devices(only, movers)
    require_vacant(folder)
    title = "devices on a computed clock, judged by their own logs"
    verdicts, failed = _told(title, len(plays), played_all(plays, folder, jobs), _DEVICE_COLUMNS, _device_row)
    healthy = sum(v.healthy for v in verdicts)
    out.print(f"{len(verdicts)} plays, {healthy} of them with healthy devices; {failed} not as they have to be")
    if failed:
        raise typer.Exit(FAILED)


def _told(
    title: str,
    count: int,
    played: Iterable[V],
    columns: Sequence[str],
    row: Callable[[V], tuple[str, list[str], str]],
) -> tuple[list[V], int]:
    """Print the verdicts with a progress bar, messages and failures; return them with the number of failures."""
    verdicts: list[V] = []
    try:
        with bar("faults", count) as show:
            for verdict in played:
                verdicts.append(verdict)
                show(len(verdicts), verdict.name)
    finally:  # an interrupted campaign shows what it has found
        rows = [(v.name, *row(v)) for v in verdicts]
        grid = table(title, columns, [[name, where, *cells] for name, where, cells, _ in rows])
        Console(width=max(out.width, _WIDTH)).print(grid)  # a narrow terminal breaks its lines; a file keeps them
        out.print("what the user sees:")
        for name, where, _, words in rows:
            if words:
                out.print(f"  {name}, {where}: {words}", soft_wrap=True, markup=False, highlight=False)
    failed = [v for v in verdicts if v.failures]
    for v in failed:
        text = f"failed: {v.name}, {row(v)[0]}: {'; '.join(v.failures)}"
        errors.print(text, style="red", soft_wrap=True, markup=False, highlight=False)
    return verdicts, len(failed)


def _wire_row(v: FaultVerdict) -> tuple[str, list[str], str]:
    counts = [str(v.commands), str(v.beyond), _number(v.safe_s), _number(v.rise_mm)]
    return v.wire, [v.expected, v.got, *counts, v.log, v.claim or "-"], v.seen


def _device_row(v: DeviceVerdict) -> tuple[str, list[str], str]:
    moved = v.moved_s if math.isfinite(v.shows_s) else math.nan
    counts = [str(v.commands), str(v.beyond), _number(v.shows_s), _number(moved), _number(v.past_deg)]
    return v.mover, [v.how, *counts], v.words


def _check(devices: bool, mover: list[str] | None, transport: str | None, backend: str | None) -> None:
    """Refuse a call with an option that has no effect."""
    if devices and (transport or backend):
        raise ConfigError("--devices: got --transport or --backend, expected neither: its wires are its own")
    if mover and not devices:
        raise ConfigError("--mover: got no --devices, expected it beside --mover")


def _over_wires(folder: Path, only: list[str], transport: str, backend: str) -> list[_Play]:
    """Cases to play, in a folder that is new or empty; `ConfigError` on an unknown case or an unavailable wire."""
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
    """Verdicts in the order of the cases; an interruption waits for the cases in progress."""
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


def _of_devices(only: Sequence[str], movers: Sequence[str]) -> tuple[DevicePlay, ...]:
    """Plays of devices; `ConfigError` on an unknown device or mover."""
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


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2f}"
