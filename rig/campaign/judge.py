"""What became of a case: commands in limits, time to the safe state, log, what the user saw."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.presets import CANONICAL
from hystmpc.trials.run_folder import RunFolder

from .cases import Case, Ending
from .play import Played, device_log
from .setup import LOWER, RATE_HZ, RATE_PER_S, SAFE, UPPER

_CLOSE = 1e-6
_STOPPED = 3


@dataclass(frozen=True)
class Verdict:
    """One row of the campaign's table.

    Attributes:
        name: of the case.
        expected, got: how the run had to end, and did.
        commands: that the device received.
        beyond: of those and of the log's, beyond the limits on value or rate. Anything but 0 is a failure.
        safe_s: from the fault to the safe command held for good [s]; NaN where the run went on, nothing moved, or the
            device was gone.
        log: `whole`, or what is wrong with it.
        seen: the last line that says what happened.
    """

    name: str
    expected: Ending
    got: str
    commands: int
    beyond: int
    safe_s: float
    log: str
    seen: str

    @property
    def passed(self) -> bool:
        """Whether everything is as it has to be."""
        return self.got == self.expected and self.beyond == 0 and self.log == "whole"


def judge(case: Case, played: Played) -> Verdict:
    """The row of a case."""
    rows = device_log(played.folder)
    received = [(row[0], row[2]) for row in rows if math.isfinite(row[2])]
    log, beyond = _log(played.folder / "run", case)
    return Verdict(
        name=case.name,
        expected=case.expected,
        got=_ending(played.code, len(received)),
        commands=len(received),
        beyond=beyond + _beyond(received),
        safe_s=_safe_s(case, played, rows, received),
        log=log,
        seen=_seen(played.said),
    )


def _ending(code: int, commands: int) -> str:
    if code == 0:
        return "goes on"
    if code < 0:
        return "left alone"
    if code == _STOPPED:
        return "stops"
    return "refuses" if not commands else f"exit code {code}"


def _beyond(received: Sequence[tuple[float, float]]) -> int:
    """Commands (time of receipt [ns], value) beyond the limits; the rate has a sample's grace for either end's jitter.

    The log of the controller is looked at without any, see `_log`.
    """
    count = 0
    for (t0, u0), (t1, u1) in pairwise(received):
        count += abs(u1 - u0) > RATE_PER_S * (1e-9 * (t1 - t0) + 2 / RATE_HZ) + _CLOSE
    return count + sum(not LOWER - _CLOSE <= u <= UPPER + _CLOSE for _, u in received)


def _safe_s(
    case: Case, played: Played, rows: Sequence[tuple[float, ...]], received: Sequence[tuple[float, float]]
) -> float:
    """Time from the fault until the device holds the safe command for good; none for one that is gone."""
    gone = case.kill == "device" and case.signal == "SIGKILL"
    if case.expected in ("goes on", "refuses") or gone or not received:
        return math.nan
    fault_ns = played.fault_ns or received[0][0] + 1e9 * case.at_s
    moving = [row[0] for row in rows if abs(row[3] - SAFE) > _CLOSE]
    if not moving or abs(rows[-1][3] - SAFE) > _CLOSE:
        return math.inf if moving else 0.0
    return max(0.0, 1e-9 * (moving[-1] - fault_ns) + 1 / RATE_HZ)


def _log(folder: Path, case: Case) -> tuple[str, int]:
    """Whether the log is whole, and commands in it beyond the limits: sample by sample, without grace."""
    if case.expected == "refuses":
        return ("whole" if not (folder / "log.csv").exists() else "a log without a run"), 0
    try:
        log = RunFolder.open(folder).log()
    except HystmpcError as error:
        return str(error), 0
    u = np.asarray(log[CANONICAL.command_column(list(log))], dtype=np.float64)
    sequence = np.asarray(log["sequence"], dtype=np.float64)
    steps = np.abs(np.diff(u))
    beyond = int(np.count_nonzero((u < LOWER - _CLOSE) | (u > UPPER + _CLOSE)))
    beyond += int(np.count_nonzero(steps > RATE_PER_S / RATE_HZ + _CLOSE))
    if not np.all(np.diff(sequence) > 0) or not np.isfinite(u).all():
        return "rows out of order", beyond
    return "whole", beyond


def _seen(said: str) -> str:
    """The line that matters most to whoever stands beside the device."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    for start in ("error:", "stopped:"):
        for line in lines:
            if line.startswith(start):
                return line
    for line in lines:
        if "recording has stopped" in line or line.startswith("faults:"):
            return line
    return lines[-1] if lines else "nothing"
