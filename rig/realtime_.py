"""The control process: garbage collection, scheduling class, core and thread switching, set and restored."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from pydantic import Field
from threadpoolctl import threadpool_limits

from hystmpc.trials.config import Settings

from .settings_types import NotNegative

_SWITCH_S = 0.0002  # how long the recorder's thread may keep the interpreter while the loop wants it


class RealtimeSettings(Settings):
    """Block `realtime`.

    Attributes:
        priority: of SCHED_FIFO, 1 to 99; null leaves the scheduling as it is.
        cpu: core that the process is pinned to; null leaves it to the system.
        spin_s: how long before a deadline sleeping ends and spinning begins.
    """

    priority: int | None = Field(default=None, ge=1, le=99)
    cpu: int | None = Field(default=None, ge=0)
    spin_s: NotNegative = 0.0005


@contextmanager
def control_process(settings: RealtimeSettings) -> Iterator[list[str]]:
    """Prepare the process for the loop and put everything back after it.

    What exists is frozen and the collector is off, so that nothing is collected in the loop; one BLAS thread.

    Yields:
        One line for everything that the system did not permit, and how to permit it.
    """
    notes: list[str] = []
    undo: list[Callable[[], object]] = []
    if settings.cpu is not None:
        _pin(settings.cpu, notes, undo)
    if settings.priority is not None:
        _schedule(settings.priority, notes, undo)
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
        for step in reversed(undo):
            step()


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
