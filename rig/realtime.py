"""Real-time setup of the control process: clock, scheduling, CPU affinity, locked memory, garbage collection."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Literal, Protocol, final

from pydantic import Field
from threadpoolctl import threadpool_limits

from hystmpc.trials.config import NotNegative, Settings

# MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT of <sys/mman.h>: without the last one, a new thread waits for its whole stack.
_LOCK = 7
_SWITCH_S = 0.00005  # how long another thread may keep the interpreter while the loop wants it
_BOOT: int | None = getattr(time, "CLOCK_BOOTTIME", None)  # Linux


class Clock(Protocol):
    """Interface of a source of time."""

    def now_ns(self) -> int:
        """Monotonic time [ns]."""
        ...

    def boot_ns(self) -> int:
        """Monotonic time that also counts while the machine is suspended [ns]."""
        ...

    def wall_ns(self) -> int:
        """Wall clock [ns since 1970], for the log only: it may jump."""
        ...

    def wait_until(self, deadline_ns: int) -> None:
        """Wait until the deadline; return at once if it has passed."""
        ...


@final
class MonotonicClock(Clock):
    """Monotonic clock of the system: sleep until `spin_s` [s] before the deadline, then spin; 0 never spins."""

    def __init__(self, spin_s: float = 0.0005) -> None:
        self._spin_ns = round(1e9 * spin_s)

    def now_ns(self) -> int:
        return time.monotonic_ns()

    def boot_ns(self) -> int:
        return time.monotonic_ns() if _BOOT is None else time.clock_gettime_ns(_BOOT)

    def wall_ns(self) -> int:
        return time.time_ns()

    def wait_until(self, deadline_ns: int) -> None:
        """Sleep, then spin; the remaining time is computed anew after every sleep, so that no error accumulates."""
        while (left := deadline_ns - time.monotonic_ns()) > self._spin_ns:
            time.sleep(1e-9 * (left - self._spin_ns))
        while time.monotonic_ns() < deadline_ns:
            pass


@final
class SimulatedClock(Clock):
    """Simulated clock that advances only by waiting, so that a computed device is not slowed to real time."""

    def __init__(self) -> None:
        self._ns = 1_000_000_000

    def now_ns(self) -> int:
        return self._ns

    boot_ns = wall_ns = now_ns

    def wait_until(self, deadline_ns: int) -> None:
        self._ns = max(self._ns, deadline_ns)


class SchedulingSettings(Settings):
    """Block `realtime` of a device.

    Attributes:
        priority: of SCHED_FIFO, 1 to 99; null leaves the scheduling as it is.
        cpu: core that the process is pinned to; null leaves it to the system.
        lock_memory: whether no page of the process may be swapped out once it was used.
    """

    priority: int | None = Field(default=None, ge=1, le=99)
    cpu: int | None = Field(default=None, ge=0)
    lock_memory: bool = False


class RealtimeSettings(SchedulingSettings):
    """Block `realtime` of a run or a recording.

    Attributes:
        spin_s: how long before a deadline sleeping ends and spinning begins.
        backend: `c` takes whole samples of a run in C while all is as expected: over UDP, on Linux and macOS, with a
            continuous sensor. Python takes all others, and with `python` each one. Both step the same controller.
    """

    spin_s: NotNegative = 0.0005
    backend: Literal["python", "c"] = "python"


@contextmanager
def scheduled(settings: SchedulingSettings) -> Iterator[list[str]]:
    """Set CPU affinity, scheduling class and locked memory of this process, and restore them.

    Yields:
        One line for each setting that the system refused, and how to permit it.
    """
    notes: list[str] = []
    undo: list[Callable[[], object]] = []
    if settings.lock_memory:
        _lock_memory(notes, undo)
    if settings.cpu is not None:
        _pin(settings.cpu, notes, undo)
    if settings.priority is not None:
        _schedule(settings.priority, notes, undo)
    try:
        yield notes
    finally:
        for step in reversed(undo):
            step()


@contextmanager
def control_process(settings: RealtimeSettings) -> Iterator[list[str]]:
    """Set up the process for the control loop, and restore it; yields the lines of `scheduled`.

    Existing objects are frozen and the garbage collector is off during the loop; BLAS uses one thread.
    """
    stack = ExitStack()
    notes = stack.enter_context(scheduled(settings))
    enabled, interval = gc.isenabled(), sys.getswitchinterval()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(_SWITCH_S)
    try:
        with threadpool_limits(limits=1):
            yield notes
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()
        if enabled:
            gc.enable()
        gc.collect()
        stack.close()


def _lock_memory(notes: list[str], undo: list[Callable[[], object]]) -> None:
    if sys.platform != "linux":
        notes.append("realtime.lock_memory: only Linux is supported; the run goes on without it")
        return
    system = ctypes.CDLL(None, use_errno=True)
    if system.mlockall(_LOCK) != 0:
        reason = os.strerror(ctypes.get_errno())
        notes.append(
            f"realtime.lock_memory: refused ({reason}); allow it with `ulimit -l unlimited` or a memlock line in "
            "limits.conf; the run goes on without it"
        )
        return
    undo.append(system.munlockall)


def _pin(cpu: int, notes: list[str], undo: list[Callable[[], object]]) -> None:
    if not hasattr(os, "sched_setaffinity"):
        notes.append("realtime.cpu: this system has no CPU pinning; the run goes on without it")
        return
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {cpu})
    except OSError as error:
        free = ", ".join(map(str, sorted(before)))
        notes.append(f"realtime.cpu: core {cpu} refused ({error.strerror}), available: {free}; not pinned")
        return
    undo.append(lambda: os.sched_setaffinity(0, before))


def _schedule(priority: int, notes: list[str], undo: list[Callable[[], object]]) -> None:
    if not hasattr(os, "sched_setscheduler"):
        notes.append("realtime.priority: this system has no SCHED_FIFO; the run goes on without it")
        return
    policy, before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        notes.append(
            f"realtime.priority: SCHED_FIFO {priority} not permitted ({error.strerror}); allow it with `ulimit -r "
            f"{priority}` or an rtprio line in limits.conf; the run goes on under normal scheduling"
        )
        return
    undo.append(lambda: os.sched_setscheduler(0, policy, before))
    if sys.platform == "linux":
        undo.extend(_lifted(thread, max(priority - 1, 1)) for thread in threading.enumerate())


def _lifted(thread: threading.Thread, priority: int) -> Callable[[], object]:
    """Schedule another interpreter thread below the loop under SCHED_FIFO; return how to restore it.

    A thread under normal scheduling may lose its core while it holds the interpreter's lock, and the loop would wait.
    """
    number = thread.native_id
    if number is None or number == threading.get_native_id():
        return lambda: None
    try:
        policy, before = os.sched_getscheduler(number), os.sched_getparam(number)
        os.sched_setscheduler(number, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:  # it has ended meanwhile
        return lambda: None

    def put_back() -> None:
        with suppress(OSError):
            os.sched_setscheduler(number, policy, before)

    return put_back
