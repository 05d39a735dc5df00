"""What came of a fault at a random moment: by the device's log, and the run's own against it; and the table."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from hystmpc.rig.recording.recording import FLUSH_S
from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.run_folder import RunFolder
from hystmpc_lab.faults.cases import IN_FLIGHT_S, OVERSHOOT, SAFE
from hystmpc_lab.faults.judge import rise

KINDS = ("kill", "pause", "stall")
_SPARE_S = 0.1  # between a command's way to the device and that to the log
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Moment:
    """One fault, and what came of it.

    Attributes:
        kind: of the fault.
        at_s: when, after the first command [s].
        from_mm: command that the device held then [mm].
        rise_mm: how far it moved away from the safe command after the commands that were under way then [mm].
        safe_s: until it held the safe command for good; infinite if it never did [s].
        samples: in the log.
        fault: what is not as it has to be; empty if nothing.
    """

    kind: str
    at_s: float
    from_mm: float
    rise_mm: float
    safe_s: float
    samples: int
    fault: str


def judged(kind: str, at_s: float, rows: Sequence[tuple[float, ...]], fault_ns: int, run: Path) -> Moment:
    """What came of a fault, by the device's log; the run's own is judged against it."""
    first = max(k for k, row in enumerate(rows) if row[0] <= fault_ns)
    later = max(k for k, row in enumerate(rows) if row[0] <= fault_ns + 1e9 * IN_FLIGHT_S)
    rose = rise([abs(row[3] - SAFE) for row in rows[later:]])
    moving = [row[0] for row in rows if row[3] != SAFE and row[0] > fault_ns]
    safe_s = math.inf if rows[-1][3] != SAFE else 1e-9 * (max(moving, default=fault_ns) - fault_ns)
    got = [row[2] for row in rows if math.isfinite(row[2]) and row[0] < fault_ns - 1e9 * (FLUSH_S + _SPARE_S)]
    samples, fault = _logged(run, got, kind != "kill")
    faults = [fault] if fault else []
    if rose > OVERSHOOT + _ROUNDING:
        faults.insert(0, f"the device rose by {rose:.2f} mm")
    if math.isinf(safe_s):
        faults.insert(0, f"the device stays at {rows[-1][3]:.2f} mm")
    return Moment(kind, at_s, rows[first][3], rose, safe_s, samples, "; ".join(faults))


def _logged(run: Path, got: Sequence[float], ended: bool) -> tuple[int, str]:
    """Samples in a run's log, and what is wrong with it; the recording process may still be at its end."""
    until, answer = time.monotonic() + 10.0, (0, "")
    while True:
        try:
            log = RunFolder.open(run).log()
            answer = len(log["sequence"]), _missing(log["command_mm"], log["sequence"], got)
            if ended and not answer[1] and log["source"][-1] not in ("stop", "wait"):
                answer = answer[0], "log: the stop is missing"
        except HystmpcError as error:
            answer = 0, f"log: {error}" if got else ""
        if not answer[1] or time.monotonic() > until:
            return answer
        time.sleep(0.1)


def _missing(logged: Sequence[float], sequence: Sequence[float], got: Sequence[float]) -> str:
    if not np.all(np.diff(np.asarray(sequence)) > 0):
        return "log: rows out of order"
    left = iter(logged)
    lost = sum(1 for u in got if not any(abs(u - v) < 1e-12 for v in left))
    return f"log: {lost} of {len(got)} commands are missing" if lost else ""


def table(moments: Sequence[Moment]) -> Table:
    """One row a kind of fault."""
    title = f"faults at random moments; the device may move on by {OVERSHOOT:g} mm"
    grid = Table(title=title, title_justify="left")
    for name in (
        "fault",
        "moments",
        "not as it has to be",
        "held then [mm]",
        "greatest rise [mm]",
        "slowest return [s]",
    ):
        grid.add_column(name, justify="left" if name == "fault" else "right")
    for kind in KINDS:
        here = [m for m in moments if m.kind == kind]
        if here:
            held = [m.from_mm for m in here]
            numbers = f"{max(m.rise_mm for m in here):.2f}", f"{max(m.safe_s for m in here):.1f}"
            wrong = str(sum(bool(m.fault) for m in here))
            grid.add_row(kind, str(len(here)), wrong, f"{min(held):.1f} to {max(held):.1f}", *numbers)
    return grid
