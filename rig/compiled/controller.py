"""`realtime.backend: c`: the controller of a run as C, compiled, stepped in the place of the Python one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, final

import numpy as np

from hystmpc.codegen.controller import ControllerExport, export_controller
from hystmpc.codegen.library import LoadedController, controller_library
from hystmpc.ctrl.command import EMPTY, Command, Source, Stopwatch, Timing
from hystmpc.ctrl.estimation.observer import Estimate, usable_angle
from hystmpc.ctrl.guarded import (
    FallbackState,
    GuardedController,
    GuardedState,
    UnusableReferenceError,
    usable_reference,
)
from hystmpc.ctrl.planner.memory import PlannersController
from hystmpc.ctrl.planner.settings import TipSettings
from hystmpc.ctrl.supervisor import LEVELS
from hystmpc.trials.errors import ConfigError, ControllerError, ExportError
from hystmpc.trials.types import Vec

from . import loop
from .loop import CompiledLoop

# In the order of the header's HYSTMPC_MPC ... HYSTMPC_STOP.
_SOURCES = (Source.MPC, Source.CONTROLLER, Source.SHIFTED_PLAN, Source.INVERSE, Source.HOLD, Source.STOP)
_FEEDBACK = 1
_CHECKED, _SAME = 24, 1e-6  # steps in which the C is compared with the Python; by how much they may differ [mm or bar]
_SWING_DEG = 4.0
_ODD = {7: np.nan, 8: np.nan, 15: 1e9}  # angles of the check that no device measures [deg]

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
    """Export, compile and check the controller of the settings as C.

    Args:
        controller: the same in Python.
        spin_s: of its loop, as `RealtimeSettings.spin_s`.

    Raises:
        ConfigError: if a part of it has no C, there is no compiler, the compiler fails, or what it made answers
            otherwise than the Python.
    """
    try:
        export = export_controller(settings)
        loop_source = loop.source() if loop.available() else ""
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
    """First difference between the controllers in Python and C over some steps from rest; empty without one.

    The reference rises and falls, the angle follows as predicted, and some samples have none or one far off.
    """
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
    """A controller compiled from C with the commands, sources and status lines of the Python one; states are snapshots.

    Of the estimate there is what the rig looks at: angle of now, disturbance, learned part, counts. Of the plan there
    is its first angle. `refusal` says why the next steps have no time for a plan, as that of `TimelyLaw`.

    Args:
        python: the same controller in Python; it judges whether the start makes sense.
        library: the compiled export, with the loop where the system has what that calls.
        fixed: what the loop is given once, see `CompiledLoop`.

    Attributes:
        loop: steps this controller in C; None where the system has not what it calls.
    """

    def __init__(
        self, python: GuardedController[Any], export: ControllerExport, library: Path, fixed: Mapping[str, float]
    ) -> None:
        self._python, self._export, self._library = python, export, library
        self._loaded = LoadedController(export, library)
        self._learns = hasattr(self._loaded.view, "learning")
        self._newest = b""  # what the loaded one remembers
        self._unusable = np.full(self.horizon, np.nan)
        self.refusal = ""
        self.loop: CompiledLoop | None = None
        if loop.available():
            self.loop = CompiledLoop(library, self._loaded.address, self.horizon, {**fixed, "dt_s": self.dt})

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self._python.dt

    @property
    def horizon(self) -> int:
        """Reference samples that `step` looks at."""
        return self._export.reference_samples

    def init(self, y: float, u: float) -> GuardedState[bytes]:
        """State at rest.

        Raises:
            ControllerError: as `GuardedController.init`.
        """
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
        """Standard deviation of the error of the estimated angle [deg]; not-a-number where it is not known."""
        return self._python.sigma_deg(state)

    def sigma_ahead_deg(self, state: GuardedState[Any], commands: Vec) -> Vec:
        """Not-a-number: the noises that the estimator has found stay in the memory of the C."""
        del state
        return np.full(commands.size, np.nan)

    def measure(self, state: GuardedState[Any], y: float, age: float) -> GuardedState[Any]:
        """Refused: frames of an intermittent sensor have no C.

        Raises:
            ControllerError: always.
        """
        return self._python.measure(state, y, age)

    def stop(self, state: GuardedState[Any], cause: str) -> GuardedState[Any]:
        """The state after which every step stops; only a new `init` releases it."""
        return self._python.stop(state, cause)

    def step(self, state: GuardedState[bytes], y: float, reference: Vec) -> tuple[Command, GuardedState[bytes]]:
        """One sample; any `y` and any `reference` are answered."""
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
            view.learning.forecast_error if answer.source == _FEEDBACK else 0.0,
            cause=state.fallback.cause,
            reference=fault,
            stalled=state.estimate.stalled,
            refusal=self.refusal,
        )
        return _command(answer.u, answer, status, watch.stages), after

    def taken(self, sample: Any, stalled: int, refusal: str) -> Command:
        """Command of a sample that the loop in C has executed.

        Args:
            stalled: of the sample before it.
            refusal: why there was no time for a plan, where there was none.
        """
        status = _line(sample, sample.stalled, sample.level, sample.forecast_error, stalled=stalled, refusal=refusal)
        return _command(sample.wanted, sample, status, {"law": 1e-9 * sample.step_ns})

    def after(self, cause: str = "") -> GuardedState[bytes]:
        """The state after the last step; `cause` is that of a latched stop."""
        view = self._loaded.view
        after = self._state(self._loaded, FallbackState(view.failures, bool(view.stopped), cause=cause))
        self._newest = after.memory
        return after

    def take_up(self, state: GuardedState[bytes]) -> None:
        """Set the memory of the C to `state`."""
        c = self._loaded
        if state.memory is not self._newest:
            c.remember(state.memory)
        if state.estimate.command != c.view.estimate.command:
            c.hold(state.estimate.command)
        if state.fallback.stopped and not c.view.stopped:
            c.stop()

    def _begun(self, y: float, u: float) -> LoadedController:
        """New memory of the C, initialised at rest."""
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
    """Status line as `GuardedController` writes it for an answer of the C."""
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
