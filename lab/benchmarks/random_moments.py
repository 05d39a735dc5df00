"""Motion of the device after kill -9, SIGSTOP or a stalled network at random moments of a run; prints a table.

    python lab/benchmarks/random_moments.py [--moments 200] [--lanes 4] [--seed 0] [--only kill] [--out moments.json]

Each lane has one device process behind a relay, and plays consecutive runs against it; controllers, devices and
relays are processes with real sockets, forked from one process after its imports. At a random moment of the motion

    kill     the controller is killed with -9,
    pause    the controller is paused for 3 s (SIGSTOP, SIGCONT),
    stall    the relay drops all datagrams, in both directions, for 1 s.

After the arrival of the commands in transit, the device must not move away from the safe command by more than the
overshoot, and has to return to it. The log has to hold, in order, every command that the device had received up to
one flush interval before and, if the controller lives, the stop. Exit code 1 if one of these conditions is violated.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import multiprocessing
import os
import selectors
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from kit import asked, save, show

from hystmpc.cli.main import main as hystmpc
from hystmpc.rig.config import load_run
from hystmpc.rig.experiment.experiment import tracking_phase
from hystmpc.rig.experiment.review import review_run
from hystmpc.rig.recording.recording import FLUSH_S
from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.run_folder import RunFolder
from hystmpc_lab.faults.cases import IN_FLIGHT_S, OVERSHOOT, SAFE, FaultCase, Link, watchdog_s, write_device, write_run
from hystmpc_lab.faults.judge import rise
from hystmpc_lab.faults.play import device_log

KINDS = ("kill", "pause", "stall")
_SPARE_S = 0.1  # tolerance between a command's arrival at the device and in the log
_ROUNDING = 1e-6
PAUSE_S, STALL_S, MOTION_S = 3.0, 1.0, 3.0
_PATIENCE_S = 60.0
_PARENT_DEATH_SIGNAL = 1  # of prctl
_CASE = FaultCase("random moments", "stops", settings={"reference": {"frequency_hz": 0.8, "cycles": 3}})
_USED = (review_run,)  # imported before the forks, so that no run has to


def dies_with_its_parent() -> None:
    """Let the system end this process together with its parent, so that no device process is left behind."""
    ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL)


def forked(work: Callable[[], object], output: int | None = None) -> int:
    """Fork a process for some work that then exits; return its process id."""
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        os.setsid()
        dies_with_its_parent()
        if output is not None:
            os.dup2(output, 1)
            os.dup2(output, 2)
        work()
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    except BaseException as error:  # noqa: BLE001 - the parent's code must not go on in this process
        os.write(2, f"{type(error).__name__}: {error}\n".encode())
    os._exit(code)


def program(*arguments: object) -> Callable[[], None]:
    """Run `hystmpc` with these arguments."""

    def work() -> None:
        sys.argv = ["hystmpc", *map(str, arguments)]
        hystmpc()

    return work


def relay(wire: socket.socket, device: int, orders: int) -> NoReturn:
    """Relay datagrams in both directions, one socket for each controller; drop them for a time on request."""
    waiting = selectors.DefaultSelector()
    waiting.register(wire, selectors.EVENT_READ)
    waiting.register(orders, selectors.EVENT_READ)
    beyond: dict[tuple[str, int], socket.socket] = {}
    blocked_ns = 0
    while True:
        for key, _ in waiting.select():
            if key.fileobj == orders:
                if not os.read(orders, 1):
                    os._exit(0)
                blocked_ns = time.monotonic_ns() + round(1e9 * STALL_S)
                continue
            with contextlib.suppress(ConnectionRefusedError):
                data, peer = key.fileobj.recvfrom(2048)  # type: ignore[union-attr]  # the orders are dealt with above
                if time.monotonic_ns() < blocked_ns:
                    continue
                if key.fileobj is not wire:
                    wire.sendto(data, key.data)
                    continue
                if peer not in beyond:
                    beyond[peer] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                    beyond[peer].connect(("127.0.0.1", device))
                    waiting.register(beyond[peer], selectors.EVENT_READ, peer)
                beyond[peer].send(data)


@dataclass(frozen=True)
class Lane:
    """Device process and its relay process.

    Attributes:
        orders: a byte written there stalls the network.
    """

    folder: Path
    port: int
    orders: int

    @property
    def size(self) -> int:
        """Present length of the device's log [bytes]."""
        return (self.folder / "device.csv").stat().st_size

    def rows(self, since: int) -> list[tuple[float, ...]]:
        """Rows of the device's log from a byte position on."""
        return device_log(self.folder, self.size - since)


@contextlib.contextmanager
def opened(folder: Path) -> Iterator[Lane]:
    """Open a lane; its processes end with the block."""
    folder.mkdir(parents=True)
    said, output = os.pipe()
    device = forked(program("device", write_device(_CASE, folder)), output)
    os.close(output)
    children = [device]
    try:
        with os.fdopen(said) as lines, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
            line = lines.readline()
            wire.bind(("127.0.0.1", 0))
            takes, orders = os.pipe()
            children.append(forked(lambda: relay(wire, int(line.split("udp port ")[1].split(",")[0]), takes)))
            os.close(takes)
            yield Lane(folder, wire.getsockname()[1], orders)
            os.close(orders)
    finally:
        for child in children:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


def played(lane: Lane, kind: str, at_s: float, folder: Path) -> Moment:
    """Play one run with one fault."""
    folder.mkdir()
    begin = lane.size
    config = write_run(_CASE, folder, Link(port=lane.port))
    with (folder / "said.txt").open("wb") as said:
        controller = forked(program("run", config, "--out", folder / "run"), said.fileno())
    try:
        first_ns = _first_command(lane, begin)
        time.sleep(max(0.0, at_s - 1e-9 * (time.monotonic_ns() - first_ns)))
        fault_ns = time.monotonic_ns()
        if kind == "kill":
            os.kill(controller, signal.SIGKILL)
        elif kind == "pause":
            os.kill(controller, signal.SIGSTOP)
            time.sleep(PAUSE_S)
            os.kill(controller, signal.SIGCONT)
        else:
            os.write(lane.orders, b"x")
        os.waitpid(controller, 0)
    except BaseException:
        os.kill(controller, signal.SIGKILL)
        raise
    _settle(lane)
    return judged(kind, at_s, lane.rows(begin), fault_ns, folder / "run")


def _first_command(lane: Lane, begin: int) -> int:
    """Monotonic time of the run's first command at the device [ns]."""
    until = time.monotonic() + _PATIENCE_S
    while time.monotonic() < until:
        for row in lane.rows(begin):
            if math.isfinite(row[2]):
                return int(row[0])
        time.sleep(0.005)
    raise TimeoutError(f"{lane.folder}: no command within {_PATIENCE_S:g} s")


def _settle(lane: Lane) -> None:
    """Wait until the device holds the safe command for half a second, or the time for its return is over."""
    until = time.monotonic() + watchdog_s(_CASE) + 1.0
    begin = lane.size
    while time.monotonic() < until:
        held = [row[3] for row in lane.rows(begin)][-12:]
        if len(held) == 12 and all(u == SAFE for u in held):
            return
        time.sleep(0.05)


def lane_of(folder: Path, work: Sequence[tuple[str, float]]) -> list[Moment]:
    """Play all moments of one lane in sequence."""
    with opened(folder / "device") as lane:
        return [played(lane, kind, at_s, folder / f"{k:03d}") for k, (kind, at_s) in enumerate(work)]


def campaign(kinds: Sequence[str], moments: int, lanes: int, seed: int, folder: Path) -> list[Moment]:
    """Play the given number of moments of each kind, divided among the lanes."""
    draws = np.random.default_rng(seed)
    work = [(kind, float(draws.uniform(0.0, MOTION_S))) for _ in range(moments) for kind in kinds]
    tracking_phase(load_run(write_run(_CASE, folder, Link())))  # imported once, for all that are forked
    lanes = min(lanes, len(work))
    with ProcessPoolExecutor(lanes, multiprocessing.get_context("fork"), dies_with_its_parent) as pool:
        parts = pool.map(lane_of, [folder / str(k) for k in range(lanes)], [work[k::lanes] for k in range(lanes)])
        return [moment for part in parts for moment in part]


@dataclass(frozen=True)
class Moment:
    """One fault and its consequences.

    Attributes:
        at_s: time after the first command [s].
        from_mm: held command of the device at that time [mm].
        rise_mm: motion away from the safe command after the commands in transit [mm].
        safe_s: time until it holds the safe command for good; infinite if it never does [s].
        fault: violated condition; empty if there is none.
    """

    kind: str
    at_s: float
    from_mm: float
    rise_mm: float
    safe_s: float
    samples: int
    fault: str


def judged(kind: str, at_s: float, rows: Sequence[tuple[float, ...]], fault_ns: int, run: Path) -> Moment:
    """Consequences of a fault according to the device's log, with which the run's own log is compared."""
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
    """Number of samples in a run's log, and its fault; the recording process may still be ending."""
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


_COLUMNS = (
    "fault",
    "moments",
    "not as it has to be",
    "held then [mm]",
    "greatest rise [mm]",
    "slowest return [s]",
)


def summary(moments: Sequence[Moment]) -> Iterator[tuple[object, ...]]:
    """Rows of the table, one for each kind of fault."""
    for kind in KINDS:
        here = [m for m in moments if m.kind == kind]
        if here:
            held, wrong = [m.from_mm for m in here], sum(bool(m.fault) for m in here)
            numbers = f"{max(m.rise_mm for m in here):.2f}", f"{max(m.safe_s for m in here):.1f}"
            yield kind, len(here), wrong, f"{min(held):.1f} to {max(held):.1f}", *numbers


def main() -> int:
    """Play all moments; exit code 1 if a condition is violated."""
    options = asked(
        __doc__,
        moments=(200, "of each kind of fault"),
        lanes=(4, "devices at a time"),
        seed=(0, "of the moments"),
        only={"choices": KINDS, "action": "append", "help": "a kind of fault; may be repeated"},
        out={"type": Path, "help": "JSON file of all moments"},
    )
    with tempfile.TemporaryDirectory() as folder:
        moments = campaign(options.only or KINDS, options.moments, options.lanes, options.seed, Path(folder))
    title = f"faults at random moments; the device may move on by {OVERSHOOT:g} mm"
    show(_COLUMNS, summary(moments), title, width=112)
    for m in moments:
        if m.fault:
            print(f"{m.kind} at {m.at_s:.2f} s, {m.from_mm:.2f} mm: {m.fault}")
    save(options.out, [asdict(m) for m in moments])
    return int(any(m.fault for m in moments))


if __name__ == "__main__":
    sys.exit(main())
