"""Controller and control loop compiled from C (`realtime.backend: c`); Python reads the results of each sample."""

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

from hystmpc.codegen.controller import ControllerExport, export_controller
from hystmpc.codegen.layout import structs
from hystmpc.codegen.library import LoadedController, controller_library
from hystmpc.ctrl.command import EMPTY, Command, Source, Stopwatch, Timing
from hystmpc.ctrl.estimation.observer import Estimate, usable_angle
from hystmpc.ctrl.feedback import LEVELS
from hystmpc.ctrl.guarded import GuardedController, GuardedState, UnusableReferenceError, usable_reference
from hystmpc.ctrl.planner.memory import PlannersController
from hystmpc.ctrl.planner.settings import TipSettings
from hystmpc.trials.errors import ConfigError, ControllerError, ExportError
from hystmpc.trials.types import Vec

from ..safety.gate import Gate
from ..safety.intake import Intake
from ..safety.stop import StopFlag
from ..transports.transport import Transport

# In the order of the header's HYSTMPC_MPC ... HYSTMPC_STOP.
_SOURCES = (Source.MPC, Source.CONTROLLER, Source.SHIFTED_PLAN, Source.INVERSE, Source.HOLD, Source.STOP)
_FEEDBACK = 1
_CHECKED, _SAME = 24, 1e-6  # compared steps; tolerance [mm or bar]
_SWING_DEG = 4.0
_ODD = {7: np.nan, 8: np.nan, 15: 1e9}  # invalid angles in the check [deg]

# By the header's HYSTMPC_OK ... HYSTMPC_NO_TIME; `{...}` are filled in.
_REASONS = (
    "ok",
    "latched {cause}",
    "{reference}",
    "no usable measurement for {missing} samples",
    "the model state is {stalled} samples old",
    "PlanningError: prediction, Jacobian or quadratic program is not finite",
    "PlanningError: the quadratic program was not solved",
    "the law answers no finite command",
    "NoTimeError: {refusal}",
)


def compiled_controller(
    controller: GuardedController[Any], settings: TipSettings, spin_s: float = 0.0
) -> CompiledController:
    """Export the controller of the settings as C, compile it and compare it with the Python controller.

    Args:
        spin_s: as `RealtimeSettings.spin_s`.

    Raises:
        ConfigError: if a part of the controller has no C export, there is no compiler, the compiler fails, or the
            compiled controller answers otherwise than the Python one.
    """
    try:
        export = export_controller(settings)
        loop_source = source() if available() else ""
        fixed = {
            "spin_ns": round(1e9 * spin_s),
            "stop_after": settings.controller.resolved().ladder.stop_after_failures,
        }
        compiled = CompiledController(controller, export, controller_library(export, loop_source), fixed)
    except (ExportError, OSError) as error:
        reason = str(error).removeprefix("export-c: ")
        raise ConfigError(f"realtime.backend c: {reason}; backend: python needs nothing") from None
    if differs := _difference(controller, compiled):
        raise ConfigError(f"realtime.backend c: {differs}; expected another compiler or CC, or backend: python")
    return compiled


def _difference(python: GuardedController[Any], compiled: CompiledController) -> str:
    """First difference between the Python and the C controller over some steps from rest; empty if they agree."""
    low = python.limits.lower
    rest = python.init(0.0, low).estimate.angles[0]
    states: list[Any] = [controller.init(rest, low) for controller in (python, compiled)]
    y, preview = rest, np.arange(python.horizon)
    for k in range(_CHECKED):
        wanted = rest + _SWING_DEG * (1.0 - np.cos(2.0 * np.pi * (k + preview) / _CHECKED))
        measured = _ODD.get(k, y)
        commands = []
        for j, controller in enumerate((python, compiled)):
            command, states[j] = controller.step(states[j], measured, wanted)
            commands.append(command)
        one, other = commands
        if not abs(one.u - other.u) <= _SAME or one.source is not other.source:
            return f"in step {k} of its check it sends {other.u} ({other.source}), Python {one.u} ({one.source})"
        y = float(one.predicted[0]) if one.predicted.size else y
    return ""


@final
class CompiledController(PlannersController):
    """Controller compiled from C, with the commands, sources and status lines of the Python controller.

    States are snapshots. The estimate contains only the parts that the rig reads: present angle, disturbance, learned
    part, counts. Of the plan only the first angle is available. `refusal` is the reason for which the next steps have
    no time for a plan, as in `TimelyLaw`.

    Args:
        python: the same controller in Python; it judges whether the start makes sense.
        library: the compiled export, with the loop where the system supports it.

    Attributes:
        loop: steps this controller in C; None on a system without its functions.
    """

    def __init__(
        self, python: GuardedController[Any], export: ControllerExport, library: Path, fixed: Mapping[str, float]
    ) -> None:
        self._python, self._export, self._library = python, export, library
        self._loaded = LoadedController(export, library)
        self._learns = hasattr(self._loaded.view, "learning")
        self._newest = b""  # memory of the loaded controller
        self._unusable = np.full(self.horizon, np.nan)
        self.refusal = ""
        self.loop: CompiledLoop | None = None
        if available():
            self.loop = CompiledLoop(library, self._loaded.address, self.horizon, {**fixed, "dt_s": self.dt})

    @property
    def dt(self) -> float:
        return self._python.dt

    @property
    def horizon(self) -> int:
        return self._export.reference_samples

    def init(self, y: float, u: float) -> GuardedState[bytes]:
        return self._state(self._begun(y, u), FallbackState())

    def replay(self, commands: Vec, angles: Vec) -> GuardedState[bytes]:
        """State after a recording, see `GuardedController.replay`; another thread may step meanwhile.

        Raises:
            ControllerError: as `GuardedController.replay`.
        """
        first = int(self._python.usable_in(commands, angles)[0])
        replayed = self._begun(float(angles[first]), float(commands[max(first - 1, 0)]))
        for y, u in zip(angles[first:].tolist(), commands[first:].tolist(), strict=True):
            if replayed.look_on(y, u):
                raise ControllerError(f"replay: the model fails at command {u}")
        return self._state(replayed, FallbackState())

    def sigma_deg(self, state: GuardedState[Any]) -> float:
        return self._python.sigma_deg(state)

    def sigma_ahead_deg(self, state: GuardedState[Any], commands: Vec) -> Vec:
        """Always not-a-number, since the noise estimates stay in the memory of the C code."""
        del state
        return np.full(commands.size, np.nan)

    def measure(self, state: GuardedState[Any], y: float, age: float) -> GuardedState[Any]:
        """Always an error: frames of an intermittent sensor are not supported in C.

        Raises:
            ControllerError: always.
        """
        return self._python.measure(state, y, age)

    def stop(self, state: GuardedState[Any], cause: str) -> GuardedState[Any]:
        return self._python.stop(state, cause)

    def step(self, state: GuardedState[bytes], y: float, reference: Vec) -> tuple[Command, GuardedState[bytes]]:
        """Execute one sample; any `y` and any `reference` are answered."""
        watch = Stopwatch()
        try:
            wanted, fault = usable_reference(reference, self.horizon), ""
        except UnusableReferenceError as error:
            wanted, fault = self._unusable, str(error)
        c = self._loaded
        self.take_up(state)
        if self.refusal:
            c.hurry()
        answer = c.step(usable_angle(y), np.ascontiguousarray(wanted))
        after = self.after(state.fallback.cause)
        watch.lap("law")
        view = c.view
        status = _line(
            answer,
            after.estimate.stalled,
            view.feedback.level if answer.source == _FEEDBACK else 0,
            view.learning.filters.forecast_error if answer.source == _FEEDBACK else 0.0,
            cause=state.fallback.cause,
            reference=fault,
            stalled=state.estimate.stalled,
            refusal=self.refusal,
        )
        return _command(answer.u, answer, status, watch.stages), after

    def taken(self, sample: Any, stalled: int, refusal: str) -> Command:
        """Return the command of a sample that the loop in C has executed.

        Args:
            stalled: age of the model state before it [samples].
            refusal: reason for which there was no time for a plan, empty otherwise.
        """
        status = _line(sample, sample.stalled, sample.level, sample.forecast_error, stalled=stalled, refusal=refusal)
        return _command(sample.wanted, sample, status, {"law": 1e-9 * sample.step_ns})

    def after(self, cause: str = "") -> GuardedState[bytes]:
        """State after the last step; `cause` is the cause of a latched stop."""
        view = self._loaded.view
        after = self._state(self._loaded, FallbackState(view.failures, bool(view.stopped), cause=cause))
        self._newest = after.memory
        return after

    def take_up(self, state: GuardedState[bytes]) -> None:
        """Load `state` into the memory of the C code."""
        c = self._loaded
        if state.memory is not self._newest:
            c.remember(state.memory)
        if state.estimate.command != c.view.estimate.command:
            c.hold(state.estimate.command)
        if state.fallback.stopped and not c.view.stopped:
            c.stop()

    def _begun(self, y: float, u: float) -> LoadedController:
        self._python.init(y, u)
        begun = LoadedController(self._export, self._library)
        if refused := begun.init(y, u):
            raise ControllerError(f"controller: the C cannot start at {y} deg, command {u}: answer {refused}")
        return begun

    def _state(self, c: LoadedController, fallback: FallbackState) -> GuardedState[bytes]:
        e = c.view.estimate
        added = c.view.learning.added[0] if self._learns else 0.0
        seen = Estimate(
            EMPTY,
            e.command,
            (e.angles[0],),
            (True,),
            (0.0,),
            e.disturbance,
            e.variance,
            e.measured,
            e.missing,
            e.stalled,
            added,
        )
        return GuardedState(seen, c.memory, fallback, c.view.due)


def _line(
    answer: Any,
    stalled_after: int,
    level: int,
    forecast_error: float,
    *,
    cause: str = "",
    reference: str = "",
    stalled: int = 0,
    refusal: str = "",
) -> str:
    """Status line for an answer of the C code, in the form of `GuardedController`."""
    notes = []
    if answer.status:
        reason = _REASONS[answer.status].format(
            cause=cause, reference=reference, missing=answer.missing, stalled=stalled, refusal=refusal
        )
        notes.append(f"stopped: {reason}" if _SOURCES[answer.source] is Source.STOP else reason)
    elif answer.source == _FEEDBACK:
        notes.append(f"{LEVELS[level]}: forecasts are off by {100 * forecast_error:.0f} % of the motion")
    if answer.missing:
        notes.append(f"measurement missing or outlying for {answer.missing} samples, predicted")
    if stalled_after:
        notes.append("model state not advanced: the model fails")
    return "; ".join(notes) or "ok"


def _command(u: float, answer: Any, status: str, stages: Mapping[str, float]) -> Command:
    predicted = np.array((answer.predicted_deg,))
    return Command(u, _SOURCES[answer.source], status, EMPTY, predicted, answer.departure_deg, Timing(stages))


_SIZES = {"READINGS": 4, "SAMPLES": 256, "REFERENCES": 4096, "RECENT": 128}
# By the names ASKED ... UNSENT of loop.c.
_ENDINGS = (
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
_WATCH_S = 0.002  # polling period of the samples done in C
_BEHIND_S = 0.05  # greatest delay of Python
_AHEAD_S, _MOST_AHEAD = 0.25, 2048  # extent of the known reference: time, samples beyond the preview


def available() -> bool:
    """Whether this system has the functions that the loop in C calls."""
    return sys.platform in ("linux", "darwin")


def source() -> str:
    """C source of the loop, which calls the exported controller."""
    sizes = "".join(f"#define {name} {size}\n" for name, size in _SIZES.items())
    return sizes + resources.files("hystmpc.rig.compiled").joinpath("loop.c").read_text(encoding="utf-8")


@final
class CompiledLoop:
    """Control loop in C on the memory of a compiled controller; its thread never waits for the interpreter.

    `view` is the struct `hystmpc_loop` of loop.c. A sample is written whole before it is counted, and its place is
    reused only after Python has read it.

    Args:
        library: the controller's, compiled with `source()`.
        controller: address of the struct that is stepped.
        preview: reference samples of a step.
    """

    def __init__(self, library: Path, controller: int, preview: int, fixed: Mapping[str, float | int]) -> None:
        kind = structs(source(), _SIZES, ctypes.c_double)["hystmpc_loop"]
        functions = ctypes.CDLL(str(library))  # its calls release the interpreter's lock
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
        """Initialise the struct with these fields for the next sample."""
        view = self.view
        view.written = view.read = view.asked = view.late = view.skipped = view.unread = view.reason = 0
        self._put(numbers)

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
            self.interrupt()  # the samples are no longer consumed
            run.join()

    def parts(self, intake: Intake, gate: Gate, transport: Transport) -> dict[str, Any] | None:
        """Initial state of sensor checks, gate and transport in C; None if one of them is not available in C."""
        judged, limited = intake.numbers(self.view.dt_s, _SIZES["RECENT"]), gate.numbers()
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
        for k in range(view.read, self._written(ctypes.byref(view))):
            yield view.samples[k % _SIZES["SAMPLES"]]
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
            self._reference[numbers % _SIZES["REFERENCES"]] = wanted(numbers)
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
