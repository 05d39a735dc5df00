"""Control loop in C (`realtime.backend: c`), core/loop.h; Python reads the results of each sample."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from threading import Thread
from typing import Any, final

import numpy as np

from hystmpc.core.library import engine
from hystmpc.core.structs import constants, layout
from hystmpc.ctrl.answers import SOURCES, status_words
from hystmpc.ctrl.command import EMPTY, Command, Timing, replace
from hystmpc.ctrl.estimation.observer import ANGLE_BOUND_DEG
from hystmpc.ctrl.guarded import GuardedController, GuardedState
from hystmpc.ctrl.problem import written_in
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from ..safety.gate import Gate
from ..safety.intake import Intake
from ..safety.stop import StopFlag
from ..transports.transport import Transport

_CODES = constants()
_SAMPLES, _REFERENCES, _RECENT = (_CODES[f"HYSTMPC_{name}"] for name in ("SAMPLES", "REFERENCES", "RECENT"))
_FEEDBACK = _CODES["HYSTMPC_FEEDBACK"]
_ENDINGS = {0: "not begun"} | {
    _CODES[f"HYSTMPC_LOOP_{name}"]: words
    for name, words in {
        "ASKED": "asked",
        "STOOD": "the loop stood still",
        "UNWATCHED": "Python did not keep up",
        "UNFED": "no further reference",
        "ODD": "reading",
        "STRAYED": "motion or held command",
        "FAILING": "controller",
        "UNSENT": "command not sent",
        "ABSENT": "no loop in C on this system",
    }.items()
}
_WATCH_S = 0.002  # polling period of the samples done in C
_BEHIND_S = 0.05  # greatest delay of Python
_AHEAD_S, _MOST_AHEAD = 0.25, 2048  # extent of the known reference: time, samples beyond the preview


def available() -> bool:
    """Whether this system has the functions that the loop in C calls."""
    return sys.platform in ("linux", "darwin")


def compiled_loop(controller: GuardedController, spin_s: float = 0.0) -> CompiledLoop | None:
    """Return the loop in C for a controller; None on a system without one.

    Args:
        spin_s: as `RealtimeSettings.spin_s`.

    Raises:
        ConfigError: if a part of the controller is written in Python, or its preview is too long.
    """
    if part := written_in(controller.problem):
        raise ConfigError(
            f"realtime.backend c: got {part} written in Python, expected all of its parts to be the engine's; "
            "backend: python takes this one"
        )
    if controller.horizon > _REFERENCES - _MOST_AHEAD:
        most = _REFERENCES - _MOST_AHEAD
        raise ConfigError(f"realtime.backend c: got a preview of {controller.horizon} samples, expected at most {most}")
    return CompiledLoop(controller, spin_s) if available() else None


@final
class CompiledLoop:
    """Control loop in C on the memory of a controller; its thread never waits for the interpreter.

    `view` is the struct `hystmpc_loop` of core/loop.h. A sample is written whole before it is counted, and its place is
    reused only after Python has read it.

    Args:
        controller: whose problem is stepped.
        spin_s: how long before a deadline sleeping ends and spinning begins [s].
    """

    def __init__(self, controller: GuardedController, spin_s: float = 0.0) -> None:
        core, problem = engine(), controller.problem
        self._run, self._written = core.loop_run, core.loop_written
        self.view: Any = layout("hystmpc_loop")()
        self._address, self._controller = ctypes.addressof(self.view), controller
        self._room = np.empty(core.loop_room_bytes(problem.address), dtype=np.uint8)
        self._memory = np.zeros(core.memory_bytes(problem.address), dtype=np.uint8)
        self._preview, self._reference = controller.horizon, np.ctypeslib.as_array(self.view.reference)
        dt_s, stop_after = controller.dt, problem.fields["stop_after"]
        self._put({"dt_s": dt_s, "spin_ns": round(1e9 * spin_s), "stop_after": stop_after})
        self.view.most_behind = min(max(round(_BEHIND_S / dt_s), 4), _SAMPLES - 1)
        self._watch_s = min(max(_WATCH_S, 0.25 * dt_s), 0.02)
        self._ahead = self._preview + min(max(round(_AHEAD_S / dt_s), 4), _MOST_AHEAD)

    def begin(self, numbers: Mapping[str, Any]) -> None:
        """Initialise the struct with these fields for the next sample."""
        view = self.view
        view.written = view.read = view.asked = view.late = view.skipped = view.unread = view.reason = 0
        self._put(numbers)

    def take_up(self, state: GuardedState) -> None:
        """Step a copy of this state."""
        self._memory = state.memory.copy()

    def after(self, state: GuardedState) -> GuardedState:
        """Return the state after the last sample, in place of the one that was taken up."""
        return replace(state, memory=self._memory.copy())

    def run(self, flag: ctypes.c_int) -> None:
        """Execute samples until one is not as expected, or the flag is not zero."""
        word = ctypes.addressof(flag)
        self._run(self._address, self._controller.problem.address, self._memory, self._room, word)

    def samples(
        self, numbers: Mapping[str, Any], wanted: Callable[[Vec], Vec], end: int, flag: StopFlag
    ) -> Generator[Any]:
        """Execute samples in C and yield the struct `hystmpc_sample` of each; `view` then holds the reason of the end.

        Args:
            numbers: further fields of the struct at present, `steps` among them.
            wanted: numbers of samples to the reference angles (N,) at their ends [deg]; an exception ends the loop.
            end: number of steps after which the loop ends.
            flag: ends the loop at the next sample.
        """
        view = self.view
        self._put(numbers)
        view.end, view.fed = end, view.steps + 1
        self._feed(wanted)
        run = Thread(target=self.run, args=(flag.word,), name="loop-in-c", daemon=True)
        run.start()
        try:
            with _after_the_loop():
                while run.is_alive():
                    run.join(self._watch_s)
                    yield from self._new()
                    self._feed(wanted)
                yield from self._new()
        finally:
            self.interrupt()  # the samples are no longer consumed
            run.join()

    @staticmethod
    def command(sample: Any, stalled: int, refusal: str) -> Command:
        """Return the command of a sample, with the words of `GuardedController`; of its plan only the first angle.

        Args:
            stalled: age of the model state before it [samples].
            refusal: why there was no time for a plan, where there was none.
        """
        answer = sample.answer
        more = {
            "cause": "",
            "reference": f"reference: not finite or beyond {ANGLE_BOUND_DEG:.0f} deg",
            "stalled": stalled,
            "refusal": refusal,
            "unfinished": "",
        }
        level = sample.level if answer.source == _FEEDBACK else 0
        status = status_words(answer, level, sample.forecast_error, sample.stalled, (), more)
        predicted = EMPTY if np.isnan(answer.predicted_deg) else np.array((answer.predicted_deg,))
        timing = Timing({"step": 1e-9 * sample.step_ns})
        return Command(answer.u, SOURCES[answer.source], status, EMPTY, predicted, answer.departure_deg, timing)

    def parts(self, intake: Intake, gate: Gate, transport: Transport) -> dict[str, Any] | None:
        """Initial state of sensor checks, gate and transport in C; None if one of them is not available in C."""
        judged, limited = intake.numbers(self.view.dt_s, _RECENT), gate.numbers()
        wire = transport.numbers()
        if judged is None or limited is None or wire is None:
            return None
        return {**judged, **limited, **wire}

    @property
    def reason(self) -> str:
        """Reason for which the loop in C has ended."""
        return _ENDINGS[self.view.reason]

    def unread(self) -> list[tuple[bytes, int]]:
        """Bytes and receipt time [ns] of the readings of the sample that was left to Python."""
        return _received(self.view.pending, self.view.unread)

    @staticmethod
    def received(sample: Any) -> list[tuple[bytes, int]]:
        """Bytes and receipt time [ns] of the readings of a sample."""
        return _received(sample.reading, sample.readings)

    def interrupt(self) -> None:
        """End the loop at the next sample; callable from any thread."""
        self.view.asked = 1

    def _put(self, numbers: Mapping[str, Any]) -> None:
        for name, value in numbers.items():
            setattr(self.view, name, value)

    def _new(self) -> Iterator[Any]:
        view = self.view
        for k in range(view.read, self._written(self._address)):
            yield view.samples[k % _SAMPLES]
            view.read = k + 1

    def _feed(self, wanted: Callable[[Vec], Vec]) -> None:
        """Extend the reference in the buffer of the loop; a failure ends the loop."""
        view = self.view
        first, last = int(view.fed), min(int(view.steps) + self._ahead, int(view.end) + self._preview + 1)
        missing, whole = last - first, last == view.end + self._preview + 1
        if missing <= 0 or (2 * missing < self._ahead - self._preview and not whole):
            return
        try:
            numbers = np.arange(first, last)
            self._reference[numbers % _REFERENCES] = wanted(numbers.astype(np.float64))
        except Exception:  # noqa: BLE001 - a user's function; the sample that Python takes then says what is wrong
            return
        view.fed = last


def _received(readings: Any, count: int) -> list[tuple[bytes, int]]:
    """Bytes and receipt time [ns] of the first structs `hystmpc_reading`."""
    return [(bytes(one.data[: one.size]), int(one.received_ns)) for one in readings[:count]]


@contextmanager
def _after_the_loop() -> Iterator[None]:
    """Lower the priority of this thread below that of the loop if both run under SCHED_FIFO."""
    if not hasattr(os, "sched_getscheduler") or os.sched_getscheduler(0) != os.SCHED_FIFO:
        yield
        return
    before = os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(max(before.sched_priority - 1, 1)))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_FIFO, before)
