"""The control loop in C: it executes whole samples while nothing is unusual; Python reads their results."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from threading import Thread
from typing import Any, final

import numpy as np

from hystmpc.codegen.layout import structs
from hystmpc.trials.types import Vec

from ..safety.gate import Gate
from ..safety.intake import Intake
from ..safety.stop import StopFlag
from ..transports.transport import Transport

_SIZES = {"READINGS": 4, "SAMPLES": 256, "REFERENCES": 4096, "RECENT": 128}
# By the names ASKED ... UNSENT of loop.c.
_REASONS = (
    "not begun",
    "asked",
    "the loop stood still",
    "Python did not keep up",
    "no further reference",
    "reading",
    "motion or held command",
    "controller",
    "command not sent",
)
_WATCH_S = 0.002  # between two looks at what was done in C
_BEHIND_S = 0.05  # how far Python may be behind
_AHEAD_S, _MOST_AHEAD = 0.25, 2048  # how far the reference is known ahead: time, samples beyond the preview


def available() -> bool:
    """Whether this system has the functions that the loop in C calls."""
    return sys.platform in ("linux", "darwin")


def source() -> str:
    """The C of the loop, which calls the exported controller."""
    sizes = "".join(f"#define {name} {size}\n" for name, size in _SIZES.items())
    return sizes + resources.files("hystmpc.rig.compiled").joinpath("loop.c").read_text(encoding="utf-8")


@final
class CompiledLoop:
    """Takes samples on the memory of a compiled controller, by a thread that never waits for the interpreter.

    `view` is the struct `hystmpc_loop` of loop.c. A sample is written down whole before it is counted, and its place is
    used again only after Python has looked at it.

    Args:
        library: the controller's, compiled with `source()`.
        controller: address of the struct that is stepped.
        preview: reference samples that a step looks at.
        fixed: fields of the struct that stay as they are.
    """

    def __init__(self, library: Path, controller: int, preview: int, fixed: Mapping[str, float | int]) -> None:
        kind = structs(source(), _SIZES, ctypes.c_double)["hystmpc_loop"]
        functions = ctypes.CDLL(str(library))  # leaves the interpreter to others while it runs
        self._run, self._written, size = (functions[f"hystmpc_loop_{name}"] for name in ("run", "written", "bytes"))
        size.restype, self._written.restype = ctypes.c_ulong, ctypes.c_int64
        self._run.argtypes, self._written.argtypes = [ctypes.c_void_p] * 3, [ctypes.c_void_p]
        if size() != ctypes.sizeof(kind):
            raise OSError(f"loop.c: the struct has {size()} bytes, expected {ctypes.sizeof(kind)}")
        self.view: Any = kind()
        self._controller, self._preview = controller, preview
        self._reference = np.ctypeslib.as_array(self.view.reference)
        self._put(fixed)
        dt_s = self.view.dt_s
        self.view.most_behind = min(max(round(_BEHIND_S / dt_s), 4), _SIZES["SAMPLES"] - 1)
        self._watch_s = min(max(_WATCH_S, 0.25 * dt_s), 0.02)
        self._ahead = preview + min(max(round(_AHEAD_S / dt_s), 4), _MOST_AHEAD)

    def begin(self, numbers: Mapping[str, Any]) -> None:
        """Initialise the struct for the next sample.

        Args:
            numbers: fields of the struct.
        """
        view = self.view
        view.written = view.read = view.asked = view.late = view.skipped = view.unread = view.reason = 0
        self._put(numbers)

    def samples(
        self, numbers: Mapping[str, Any], wanted: Callable[[Vec], Vec], end: int, flag: StopFlag
    ) -> Generator[Any]:
        """Execute samples in C and yield the struct `hystmpc_sample` of each; `view` says afterwards how it ended.

        Args:
            numbers: further fields of the struct as they are now, `steps` among them.
            wanted: numbers of samples to the angles (N,) wanted at their ends [deg]; where it raises, the loop ends.
            end: number of steps after which the loop ends.
            flag: ends the loop at the next sample.
        """
        view = self.view
        self._put(numbers)
        view.end, view.fed = end, view.steps + 1
        self._feed(wanted)
        word = ctypes.byref(flag.word)
        run = Thread(target=self._run, args=(ctypes.byref(view), self._controller, word), name="loop-in-c", daemon=True)
        run.start()
        try:
            with _after_the_loop():
                while run.is_alive():
                    run.join(self._watch_s)
                    yield from self._new()
                    self._feed(wanted)
                yield from self._new()
        finally:
            self.interrupt()  # where nobody looks at the samples any more
            run.join()

    def parts(self, intake: Intake, gate: Gate, transport: Transport) -> dict[str, Any] | None:
        """Initial state of the sensor checks, the gate and the transport in C; None where one of them has no C."""
        judged, limited = intake.numbers(self.view.dt_s, _SIZES["RECENT"]), gate.numbers()
        wire = transport.numbers()
        if judged is None or limited is None or wire is None:
            return None
        return {**judged, **limited, **wire}

    @property
    def reason(self) -> str:
        """Reason for which the loop in C has ended."""
        return _REASONS[self.view.reason]

    def unread(self) -> list[tuple[bytes, int]]:
        """Bytes and time of receipt [ns] of what was read for the sample that was left to Python."""
        return _received(self.view.pending, self.view.unread)

    @staticmethod
    def received(sample: Any) -> list[tuple[bytes, int]]:
        """Bytes and time of receipt [ns] of the readings of a sample."""
        return _received(sample.reading, sample.readings)

    def interrupt(self) -> None:
        """End at the next sample; by any thread."""
        self.view.asked = 1

    def _put(self, numbers: Mapping[str, Any]) -> None:
        for name, value in numbers.items():
            setattr(self.view, name, value)

    def _new(self) -> Iterator[Any]:
        view = self.view
        for k in range(view.read, self._written(ctypes.byref(view))):
            yield view.samples[k % _SIZES["SAMPLES"]]
            view.read = k + 1

    def _feed(self, wanted: Callable[[Vec], Vec]) -> None:
        """Extend the reference in the buffer of the loop; where that fails, the loop ends."""
        view = self.view
        first, last = int(view.fed), min(int(view.steps) + self._ahead, int(view.end) + self._preview + 1)
        missing, whole = last - first, last == view.end + self._preview + 1
        if missing <= 0 or (2 * missing < self._ahead - self._preview and not whole):
            return
        try:
            numbers = np.arange(first, last)
            self._reference[numbers % _SIZES["REFERENCES"]] = wanted(numbers)
        except Exception:  # noqa: BLE001 - a user's function; the sample that Python takes then says what is wrong
            return
        view.fed = last


def _received(readings: Any, count: int) -> list[tuple[bytes, int]]:
    """Bytes and time of receipt [ns] of the first structs `hystmpc_reading`."""
    return [(bytes(one.data[: one.size]), int(one.received_ns)) for one in readings[:count]]


@contextmanager
def _after_the_loop() -> Iterator[None]:
    """Lower the priority of this thread below the loop's where both run under SCHED_FIFO."""
    if not hasattr(os, "sched_getscheduler") or os.sched_getscheduler(0) != os.SCHED_FIFO:
        yield
        return
    before = os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(max(before.sched_priority - 1, 1)))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_FIFO, before)
