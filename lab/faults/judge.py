"""Verdict on a case: commands within limits, return to the safe state, log, messages to the user."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.layouts import CANONICAL
from hystmpc.trials.run_folder import RunFolder

from .cases import IN_FLIGHT_S, LOWER, OVERSHOOT, RATE_HZ, RATE_PER_S, SAFE, UPPER, Ending, FaultCase
from .play import Played, device_log

_CLOSE = 1e-6
_REFUSED, _STOPPED = 2, 3
_CLAIM = re.compile(r"safe command \S+ \S+ (held|sent)")
Rows = Sequence[tuple[float, ...]]


@dataclass(frozen=True)
class FaultVerdict:
    """One row of the campaign's table.

    Attributes:
        beyond: of those and of the log's, beyond the limits on value or rate. Anything but 0 is a failure.
        safe_s: from the fault to the safe command held for good [s]; infinite where the device never came there, NaN
            where the run went on, nothing moved, or the device was gone.
        rise_mm: how far the device moved away from the safe command after the fault and the commands that were under
            way then, from the nearest that it had come since [mm]; NaN where the run went on or the device was gone.
        log: `whole`, or what is wrong with it.
        second: what became of a second run: `refused`, something else, or nothing where there was none.
        claim: whether the user was told that the safe command is `held` or `sent`; `held, is not` is a failure.
    """

    name: str
    wire: str
    expected: Ending
    got: str
    commands: int
    beyond: int
    safe_s: float
    rise_mm: float
    log: str
    second: str
    claim: str
    seen: str

    @property
    def failures(self) -> tuple[str, ...]:
        """Violated requirements, in words."""
        found = {
            f"{self.got} instead of {self.expected}": self.got != self.expected,
            f"{self.beyond} commands beyond the limits": self.beyond != 0,
            "never came to the safe command": math.isinf(self.safe_s),
            f"rose by {self.rise_mm:.2f} mm": self.rise_mm > OVERSHOOT + _CLOSE,
            f"log: {self.log}": self.log != "whole",
            f"second run: {self.second}": self.second not in ("", "refused"),
            f"told: {self.claim}": self.claim not in ("", "held", "sent"),
        }
        return tuple(text for text, failed in found.items() if failed)

    @property
    def passed(self) -> bool:
        """Whether all requirements are met."""
        return not self.failures


def judge(case: FaultCase, played: Played) -> FaultVerdict:
    """Judge a case; return its row."""
    rows = device_log(played.folder)
    received = [(row[0], row[2]) for row in rows if math.isfinite(row[2])]
    log, beyond = _log(played.folder / "run", case)
    return FaultVerdict(
        name=case.name,
        wire=played.link.kind,
        expected=case.expected,
        got=_ending(case, played, len(received)),
        commands=len(received),
        beyond=beyond + _beyond(received),
        safe_s=_safe_s(case, played, rows, received),
        rise_mm=_rise_mm(case, played, rows, received),
        log=log,
        second=_second(case, played),
        claim=_claim(played, rows),
        seen=_seen(played.said),
    )


def _ending(case: FaultCase, played: Played, commands: int) -> str:
    code = played.code
    if code == 0:
        return "goes on"
    if code < 0:
        return "left alone"
    if code == _STOPPED:
        return "stops"
    if case.signal == "SIGHUP" and _latched(played.folder) == "SIGHUP":
        return "stops"  # a program in a closed terminal has no exit code
    return "refuses" if not commands else f"exit code {code}"


def _latched(folder: Path) -> str:
    """Cause of the latched stop, empty without one."""
    try:
        return str(json.loads((folder / "latched.json").read_text(encoding="utf-8"))["cause"])
    except (OSError, ValueError, KeyError):
        return ""


def _beyond(received: Sequence[tuple[float, float]]) -> int:
    """Commands (receipt time [ns], value) beyond the limits; the rate has one sample of grace for jitter."""
    count = 0
    for (t0, u0), (t1, u1) in pairwise(received):
        count += abs(u1 - u0) > RATE_PER_S * (1e-9 * (t1 - t0) + 2 / RATE_HZ) + _CLOSE
    return count + sum(not LOWER - _CLOSE <= u <= UPPER + _CLOSE for _, u in received)


def _fault_ns(case: FaultCase, played: Played, received: Sequence[tuple[float, float]]) -> float:
    return played.fault_ns or received[0][0] + 1e9 * case.at_s


def _safe_s(case: FaultCase, played: Played, rows: Rows, received: Sequence[tuple[float, float]]) -> float:
    """Time from the fault until the device holds the safe command permanently; NaN for a killed device."""
    if case.expected in ("goes on", "refuses") or case.device_gone or not received:
        return math.nan
    moving = [row[0] for row in rows if abs(row[3] - SAFE) > _CLOSE]
    if not moving or abs(rows[-1][3] - SAFE) > _CLOSE:
        return math.inf if moving else 0.0
    return max(0.0, 1e-9 * (moving[-1] - _fault_ns(case, played, received)) + 1 / RATE_HZ)


def _rise_mm(case: FaultCase, played: Played, rows: Rows, received: Sequence[tuple[float, float]]) -> float:
    """Greatest distance from the safe command after the latest time of detection by the controller."""
    if case.expected in ("goes on", "refuses") or case.device_gone or not received:
        return math.nan
    since = _fault_ns(case, played, received) + 1e9 * (case.notice_s + IN_FLIGHT_S)
    if case.restart:  # a restarted device is at rest, whatever it held before
        since = max((b[0] for a, b in pairwise(rows) if b[1] < a[1]), default=since)
    first = max((k for k, row in enumerate(rows) if row[0] <= since), default=0)
    return rise([abs(row[3] - SAFE) for row in rows[first:]])


def rise(distances: Sequence[float]) -> float:
    """Greatest increase of a distance above its minimum so far, in its unit."""
    least, greatest = math.inf, 0.0
    for distance in distances:
        least = min(least, distance)
        greatest = max(greatest, distance - least)
    return greatest


def _second(case: FaultCase, played: Played) -> str:
    if case.second is None:
        return ""
    if played.second_code == _REFUSED:
        return "refused"
    return "did not start" if played.second_code is None else f"exit code {played.second_code}"


def _claim(played: Played, rows: Rows) -> str:
    """Claim to the user about the safe command, compared with the command that the device held at the end."""
    found = _CLAIM.search(" ".join(played.said.split()))
    if found is None:
        return ""
    before = [row for row in rows if row[0] <= played.ended_ns]
    there = bool(before) and abs(before[-1][3] - SAFE) <= _CLOSE
    return found[1] if found[1] == "sent" or there else "held, is not"


def _log(folder: Path, case: FaultCase) -> tuple[str, int]:
    """Whether the log is whole, and its commands beyond the limits; a sample `wait` holds a reported command."""
    if case.expected == "refuses":
        return ("whole" if not (folder / "log.csv").exists() else "a log without a run"), 0
    try:
        log = RunFolder.open(folder).log()
    except HystmpcError as error:
        return str(error), 0
    u = np.asarray(log[CANONICAL.command_column(list(log))], dtype=np.float64)
    sequence = np.asarray(log["sequence"], dtype=np.float64)
    sources = [str(cell) for cell in log["source"]]
    sent = np.array([source != "wait" for source in sources])
    beyond = int(np.count_nonzero(sent & ~((u >= LOWER - _CLOSE) & (u <= UPPER + _CLOSE))))
    beyond += int(np.count_nonzero(sent[1:] & ~(np.abs(np.diff(u)) <= RATE_PER_S / RATE_HZ + _CLOSE)))
    return _wholeness(folder, case, sources, sequence), beyond


def _wholeness(folder: Path, case: FaultCase, sources: Sequence[str], sequence: np.ndarray) -> str:
    if not np.all(np.diff(sequence) > 0):
        return "rows out of order"
    if case.file_limit_bytes is not None or case.expected not in ("stops", "goes on"):
        return "whole"
    if case.expected == "stops" and sources[-1] not in ("stop", "wait"):
        return "the stop is missing"
    try:
        samples = json.loads((folder / "timing.json").read_text(encoding="utf-8"))["outcome"]["samples"]
    except (OSError, ValueError, KeyError):
        return "timing.json is missing"
    return "whole" if samples == sequence[-1] + 1 else f"{samples - 1 - sequence[-1]:.0f} samples are missing"


def _seen(said: str) -> str:
    """Most important line for the operator."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    for start in ("error:", "stopped:"):
        for line in lines:
            if line.startswith(start):
                return line
    for line in lines:
        if "recording has stopped" in line or line.startswith("faults:"):
            return line
    return lines[-1] if lines else "nothing"
