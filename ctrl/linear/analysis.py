"""Analysis of a controller around an identified model before the device moves: margins, limit cycles, settling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from hystmpc.models.linear.harmonic import HarmonicModel
from hystmpc.models.linear.systems import LinearPart, control_system, reduced
from hystmpc.models.model import LoadedModel
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.prediction.build import controller_model, predictor_for
from hystmpc.trials.errors import ControllerError

from ..command import CommandLimits, attempt
from ..config import AnyControllerSettings
from ..estimation.observer import EstimatorSettings
from ..feedback import InversePidControllerSettings, PidControllerSettings
from ..mpc_settings import LinearisedMpcSettings, PredictiveSettings
from .laws import pid_system, predictive_system
from .limit_cycles import LimitCycle, LoopAnalysis, PidLoop
from .margins import LoopMargins, margins_of

System = Any
"""A system of python-control, which has no types."""

_RAMP, _HOLD_S = 200, 4.0  # to the operating point: samples of the rise, time of the hold
_RESPONSE_S, _SMALL = 1.5, 1e-6


@dataclass(frozen=True, eq=False)
class DeviceModel:
    """Identified model of a device as a loop sees it, at rest at a command that it has come to from below.

    Attributes:
        model: the model.
        lag_s: first-order lag of the command that the model does not contain [s].
        delay_samples: transport delay that the model does not contain.
        command: at rest.
    """

    model: LoadedModel
    lag_s: float
    delay_samples: int
    command: float

    @property
    def drive(self) -> tuple[Operator, ...]:
        """Operators before the model: lag, delay."""
        dt = self.model.dt
        lag = (Lag(self.lag_s),) if self.lag_s > 0 else ()
        delay = (Delay(self.delay_samples * dt, self.delay_samples),) if self.delay_samples else ()
        return (*lag, *delay)

    @cached_property
    def linear(self) -> System:
        """Linearisation where the command rises on: every play moves, the loop gain is greatest.

        Of a network it is the impulse response of 1.5 s, by exact derivatives: its numbers may be single precision.
        """
        if self.model.operators:
            return self._linear(control_system(self.model, "device", self.model.operators, self.drive))
        predictor, samples = self.harmonics.predictor, round(_RESPONSE_S / self.model.dt)
        facts = self.model.metadata
        rise = np.append(
            np.linspace(facts.command_limits.lower, self.command, _RAMP),
            [self.command] * round(_HOLD_S / self.model.dt),
        )
        state = predictor.initial(facts.trained_angle.lower, float(rise[0]))
        for u in rise:
            state = predictor.advance(state, float(u))[1]
        slopes = predictor.linearise(state, np.full(samples, self.command + _SMALL * self.command))[1]
        size = samples + self.delay_samples
        shown = np.zeros((1, size))
        shown[0, self.delay_samples :] = slopes[-1, ::-1]
        from control import ss

        part = (np.eye(size, k=-1), np.eye(size)[:, :1], shown, np.zeros((1, 1)))
        return ss(*part, self.model.dt, remove_useless_states=False)

    @cached_property
    def without_delay(self) -> LinearPart:
        """The same without the further delay, as a predictive law has it."""
        undelayed = DeviceModel(self.model, self.lag_s, 0, self.command)
        system = undelayed.linear
        return LinearPart(*(np.asarray(matrix) for matrix in (system.A, system.B, system.C, system.D)))

    @cached_property
    def harmonics(self) -> HarmonicModel:
        """Describing function of the model behind its lag; the delay is the loop's."""
        lag = [operator for operator in self.drive if isinstance(operator, Lag)]
        whole = [*lag, *self.model.operators] if self.model.operators else []
        if not self.lag_s:
            return HarmonicModel(predictor_for(self.model), whole, self.command)
        return HarmonicModel(controller_model(self.model, None, self.lag_s).predictive[0], whole, self.command)

    def _linear(self, system: System) -> System:
        import control as library

        control: System = library  # whose annotations call an array a float
        dt, low = self.model.dt, self.model.metadata.command_limits.lower
        u = np.append(np.linspace(low, self.command, _RAMP), np.full(round(_HOLD_S / dt), self.command))
        angle = 0.5 * (self.model.metadata.trained_angle.lower + self.model.metadata.trained_angle.upper)
        start = np.append(np.zeros(system.nstates - self.model.state_size - 1), self.model.resting_x(angle, low))
        run = control.input_output_response(system, dt * np.arange(u.size), u, start)
        return reduced(control.linearize(system, run.states[:, -1], [self.command], params={"branch": 1.0}))


@dataclass(frozen=True, eq=False)
class ControllerAnalysis:
    """What a controller will do around the identified model.

    Attributes:
        name, kind: of the controller.
        loop: L(z) of the linearised loop, a system of python-control; None where there is none.
        margins: of it.
        balance: limit cycles by harmonic balance; None for a law that is not a PID.
        delay_samples: greatest further delay without a lasting oscillation, the hysteresis included; see `PidLoop`.
        tolerance_deg: angle beyond which an oscillation counts as too great for a hold.
        notes: what is not analysed, or not valid.
        pid: loop of the balance, for its figure.
    """

    name: str
    kind: str
    loop: System = None
    margins: LoopMargins | None = None
    balance: LoopAnalysis | None = None
    delay_samples: int | None = None
    tolerance_deg: float = 0.5
    notes: tuple[str, ...] = ()
    pid: PidLoop | None = None

    @property
    def cycle(self) -> LimitCycle | None:
        """Predicted limit cycle."""
        return None if self.balance is None else self.balance.cycle

    @property
    def too_great(self) -> bool:
        """Whether the loop is unstable, or its predicted oscillation exceeds the tolerance of a hold."""
        if self.margins is not None and not self.margins.stable:
            return True
        grows = self.balance is not None and self.balance.diverges
        return grows or (self.cycle is not None and self.cycle.angle_deg > self.tolerance_deg)

    @property
    def rest(self) -> str:
        """Whether the loop comes to rest, in words."""
        if self.margins is None:
            return "not analysed"
        if self.balance is None:
            return f"settles in {self.margins.settling_s:.2g} s" if self.margins.stable else "unstable"
        if self.balance.diverges and self.balance.starts_at:
            return f"rests; from {self.balance.starts_at:.2g} on grows to the command limits"
        if not self.balance.oscillates:
            return f"rests, {self.margins.settling_s:.2g} s to 2 %"
        start = f"; from {self.balance.starts_at:.2g} on " if self.balance.starts_at else ""
        return f"rests{start}{self.balance}" if start else str(self.balance)


def analyse_controllers(
    device: DeviceModel,
    limits: CommandLimits,
    controllers: Sequence[tuple[str, AnyControllerSettings]],
    tolerance_deg: float,
) -> tuple[ControllerAnalysis, ...]:
    """Analyse controllers around one model. Where that fails a note says why: it must not cost the report around it.

    Args:
        device: the model at its operating point.
        limits: of the command.
        controllers: name and settings of each.
        tolerance_deg: oscillation that a hold may have [deg].

    Raises:
        ControllerError: if the operating point is not within the limits.
    """
    if not limits.lower < device.command < limits.upper:
        raise ControllerError(
            f"analyse: got an operating point at {device.command:.6g}, expected one within {limits.lower:.6g} to "
            f"{limits.upper:.6g}"
        )
    analysed = []
    for name, settings in controllers:
        one, why = attempt(partial(_analysed, device, limits, name, settings, tolerance_deg))
        analysed.append(one or ControllerAnalysis(name, settings.kind, notes=(f"not analysed: {why}",)))
    return tuple(analysed)


def _analysed(
    device: DeviceModel, limits: CommandLimits, name: str, settings: AnyControllerSettings, tolerance_deg: float
) -> ControllerAnalysis:
    known = settings.resolved()
    if known.estimator.sensor != "continuous":
        note = f"the sensor is {known.estimator.sensor}, expected continuous: the loop is not time-invariant"
        return ControllerAnalysis(name, settings.kind, notes=(note,))
    if isinstance(known, PidControllerSettings | InversePidControllerSettings):
        return _of_pid(device, limits, name, known, tolerance_deg)
    if isinstance(known, PredictiveSettings):
        return _of_plan(device, name, known, tolerance_deg)
    note = "no feedback" if settings.kind == "inverse" else "a law from outside, which is not known here"
    return ControllerAnalysis(name, settings.kind, notes=(note,))


def _of_pid(
    device: DeviceModel,
    limits: CommandLimits,
    name: str,
    settings: PidControllerSettings | InversePidControllerSettings,
    tolerance_deg: float,
) -> ControllerAnalysis:
    loop = PidLoop(device.harmonics, settings.gains, limits, device.delay_samples)
    linear, balance = device.linear * pid_system(settings.gains, device.model.dt), loop.analyse()
    slowest = f"describing function by settled cycles: none of more than {device.harmonics.slowest_s:.3g} s is seen"
    notes = [slowest] if device.harmonics.parts is None else []
    if balance.diverges:
        notes.append("the command limits bound the oscillation: its size is not predicted")
    if balance.cycle is not None:
        notes += balance.cycle.doubts
    if not balance.oscillates and balance.gain > _NEAR:
        notes.append(f"loop gain {balance.gain:.2f} at -180 deg: near 1 the prediction is uncertain")
    return ControllerAnalysis(
        name, settings.kind, linear, margins_of(linear), balance, loop.delay_margin(), tolerance_deg, tuple(notes), loop
    )


_NEAR = 0.9


def _of_plan(device: DeviceModel, name: str, settings: PredictiveSettings, tolerance_deg: float) -> ControllerAnalysis:
    predictor = controller_model(device.model, None, device.lag_s).predictive[0]
    gain = settings.estimator.observer(predictor).greatest_gain
    law = predictive_system(settings, device.without_delay, device.model.dt, gain)
    linear = device.linear * law
    notes = [
        "linear law around a resting plan: no limit active, no hold, all plays moving, and the greatest gain that the "
        f"estimator may take, {gain:.2g}"
    ]
    if any(getattr(o, name, 0) for o in device.model.operators for name in ("beta", "rate", "width_s")):
        notes.append("at rest: what the model widens with speed is not in these margins")
    if settings.adaptation is not None:
        notes.append("without learning")
    if settings.weights.effort:
        notes.append("without the effort weight")
    if not isinstance(settings, LinearisedMpcSettings):
        notes.append("the law that its samples search for")
    margins = margins_of(linear)
    kind = str(getattr(settings, "kind", ""))
    return ControllerAnalysis(name, kind, linear, margins, None, margins.delay_samples, tolerance_deg, tuple(notes))


def delay_of(settings: AnyControllerSettings) -> int:
    """Delay that a controller is given in its estimator [samples]."""
    estimator = settings.resolved().estimator
    return estimator.delay_samples if isinstance(estimator, EstimatorSettings) else 0
