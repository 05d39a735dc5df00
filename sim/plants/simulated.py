"""Simulated plant of a simulator: a chain of operators with additional effects, sensors and parameter errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, cast, final

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range, rest_within
from hystmpc.models.effects.place import PlacedEffect, effect_from, with_effect
from hystmpc.models.motions import initialisation_flexure
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.measurement import Sensor
from hystmpc.models.operators.operator import Operator
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.models.simulator import Simulator
from hystmpc.trials.brief import in_brief
from hystmpc.trials.errors import ConfigError, ModelError, did_you_mean
from hystmpc.trials.types import Vec

from .computed import ComputedPlant, Sensing, run_chain, settling_s

Signals = Mapping[str, Callable[[Vec], Vec]]
"""Measured inputs by name, at times (T,) [s]."""


@dataclass(frozen=True)
class Effects:
    """Effects of the device that its simulator does not contain.

    Attributes:
        lag_s: time constant of a first-order lag of the actuator, 0 for none [s].
        delay_s: transport delay of the command, fractions of a sample allowed [s].
        noise_deg: standard deviation of the angle sensor's white noise [deg].
        quantisation_deg: resolution of the angle sensor, 0 for none [deg].
        mismatch: factors on parameters of the simulator, by label, such as `prandtl_ishlinskii.a0`.
        effects: effects of the library, as objects or as `{effect, side, parameters}`, in the order of the signal:
            those on the command after lag, delay and the simulator's own, those on the output last. Sensors act on the
            reading.
        virgin: start without the initialisation flexure.

    Raises:
        ConfigError: if a number is negative or not finite, or an effect is not one of the library.
    """

    lag_s: float = 0.0
    delay_s: float = 0.0
    noise_deg: float = 0.0
    quantisation_deg: float = 0.0
    mismatch: Mapping[str, float] = field(default_factory=dict)
    effects: Sequence[PlacedEffect | Mapping[str, Any]] = ()
    virgin: bool = False

    def __post_init__(self) -> None:
        for name in ("lag_s", "delay_s", "noise_deg", "quantisation_deg"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ConfigError(f"plant: got {name} {value}, expected a finite number >= 0")
        object.__setattr__(self, "effects", tuple(_placed(spec, k) for k, spec in enumerate(self.effects)))

    @property
    def placed(self) -> tuple[PlacedEffect, ...]:
        """Effects of the library that act on the device, without sensors."""
        return tuple(e for e in self._every if not isinstance(e.operator, Sensor))

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Sensors among the effects."""
        return tuple(e.operator for e in self._every if isinstance(e.operator, Sensor))

    def sensing(self, before: tuple[Sensor, ...] = ()) -> Sensing:
        """Return the angle sensor; `before` are sensors of the device itself."""
        return Sensing(self.noise_deg, self.quantisation_deg, (*before, *self.sensors))

    @property
    def actuator(self) -> tuple[Operator, ...]:
        """Delay and lag of the actuator."""
        lag = (Lag(self.lag_s),) if self.lag_s > 0 else ()
        return (*((Delay(self.delay_s, samples=1),) if self.delay_s > 0 else ()), *lag)

    @property
    def _every(self) -> tuple[PlacedEffect, ...]:
        return cast(tuple[PlacedEffect, ...], self.effects)


def _placed(spec: PlacedEffect | Mapping[str, Any], k: int) -> PlacedEffect:
    if isinstance(spec, PlacedEffect):
        return spec
    try:
        return effect_from({key: value for key, value in spec.items() if value is not None})
    except ModelError as error:
        raise ConfigError(f"plant.effects[{k}]: {error}") from None


def plant_simulator(simulator: Simulator, effects: Effects, dt_s: float) -> Simulator:
    """Return the simulator at sample time `dt_s` [s] with parameter errors and effects, without sensors.

    Lag and delay of the actuator are in front, effects of the library on either side after the existing ones.
    """
    chain = mismatched(simulator.chain, effects.mismatch)
    after = tuple(operator for operator in chain.after if not isinstance(operator, Sensor))
    chain = replace(chain, before=(*effects.actuator, *chain.before), after=after)
    for placed in effects.placed:
        chain = with_effect(chain, placed.operator, placed.side)
    return replace(simulator, chain=chain).at_sample_time(dt_s)


def mismatched(chain: Chain, factors: Mapping[str, float]) -> Chain:
    """Return the chain with some parameters multiplied by factors.

    Raises:
        ConfigError: on a label that the chain does not have.
        ModelError: if a product is out of the parameter's bounds.
    """
    for label in factors:
        if label not in chain.labels:
            raise ConfigError(f"mismatch: no parameter {label!r}, {did_you_mean(label, chain.labels)}")
    return chain.with_values([v * factors.get(k, 1.0) for k, v in zip(chain.labels, chain.values, strict=True)])


@final
class SimulatedPlant(ComputedPlant):
    """Plant of a chain of operators.

    Before every run the device does its initialisation flexure (S2: one period of 0.1 Hz to the highest command and
    back) and rests at the simulator's `rest_command`, at the lowest one without it. Drift and periodic disturbance
    count from the reset on, sensors restart their random numbers.

    Args:
        dt_s: sample time [s]; the simulator's own where left out.
        commands: range of flexure and rest; the simulator's limits where left out.
        seed: of the sensor noise and the sensors among the effects; equal seeds give equal noise after every reset.
        inputs: measured inputs of the simulator by name, at times (T,) [s] from the reset on; the identified values
            where left out.

    Raises:
        ConfigError: if `effects` name a parameter that the simulator does not have, or `inputs` an input.
        ModelError: if a mismatch takes a parameter out of its bounds.
    """

    def __init__(
        self,
        simulator: Simulator,
        effects: Effects | None = None,
        dt_s: float | None = None,
        commands: Range | None = None,
        seed: int = 0,
        inputs: Signals = MappingProxyType({}),
    ) -> None:
        effects, commands = effects or Effects(), commands or simulator.command_limits
        simulator = _at_first(simulator, inputs)
        self._inputs = inputs
        dt_s = simulator.dt_s if dt_s is None else dt_s
        self.simulator = plant_simulator(simulator, effects, dt_s)
        self._model = CompiledPredictor.of_simulator(self.simulator)
        self._rest = (fresh if effects.virgin else conditioned)(self.simulator, commands)
        self.command_limits = simulator.command_limits
        sensors = tuple(o for o in simulator.chain.after if isinstance(o, Sensor))
        super().__init__(dt_s, rest_of(simulator, commands), simulator.command_unit, effects.sensing(sensors), seed)

    def __repr__(self) -> str:
        return in_brief(self, repr(self.simulator))

    @property
    def rest(self) -> tuple[float, Vec]:
        """True angle [deg] and state (S,) after every reset."""
        return self._rest

    @property
    def inputs(self) -> Mapping[str, float]:
        """Measured inputs at the present instant; those that are not given have their identified values."""
        given = {one.name: one.reference for one in self._model.inputs}
        return given | {name: float(f(self.dt * np.array([self._state[1]]))[0]) for name, f in self._inputs.items()}

    def _at_rest(self, random: np.random.Generator) -> tuple[float, tuple[Vec, int]]:
        del random  # a chain has no randomness
        return self._rest[0], (self._rest[1], 0)

    def _advanced(self, state: tuple[Vec, int], u: float, random: np.random.Generator) -> tuple[float, tuple[Vec, int]]:
        del random
        x, samples = state
        if self._inputs:
            x = x.copy()
            for name, value in self.inputs.items():
                x[list(self._model.input_states[name])] = value
        angle, x = self._model.advance(x, u)
        return angle, (x, samples + 1)


def _at_first(simulator: Simulator, inputs: Signals) -> Simulator:
    """Simulator at rest at the first values of its inputs."""
    known = [one.name for one in simulator.chain.inputs]
    for name in inputs:
        if name not in known:
            raise ConfigError(f"plant.inputs: the simulator does not depend on {name!r}, {did_you_mean(name, known)}")
    first = {name: float(signal(np.zeros(1))[0]) for name, signal in inputs.items()}
    return replace(simulator, chain=simulator.chain.at_inputs(first)) if first else simulator


def rest_of(simulator: Simulator, commands: Range) -> float:
    """Rest command within a range: that of the simulator's file, or the lower end of the range without one."""
    return rest_within(simulator.rest_command, commands.lower, commands.upper)


def conditioned(simulator: Simulator, commands: Range) -> tuple[float, Vec]:
    """Return angle [deg] and state after a full bend and return to the rest command, once the device has settled.

    The rest lasts until lags have settled, and creep within ten minutes. Clock-driven effects are frozen until the run
    starts. Before the flexure the device is at its lowest command.
    """
    rest = rest_of(simulator, commands)
    flexure = initialisation_flexure(commands, simulator.dt_s, warmup_samples=1, rest=rest)
    samples = round(settling_s(simulator.chain) / simulator.dt_s)
    return _run(simulator, _lowest(simulator, commands), np.concatenate([flexure, np.full(samples, rest)]))


def fresh(simulator: Simulator, commands: Range) -> tuple[float, Vec]:
    """Return angle [deg] and state at the rest command of a device without any earlier flexure."""
    rest = rest_of(simulator, commands)
    samples = round(settling_s(simulator.chain) / simulator.dt_s) if rest > commands.lower else 0
    return _run(simulator, _lowest(simulator, commands), np.full(1 + samples, rest))


def _lowest(simulator: Simulator, commands: Range) -> Vec:
    """State (S,) at rest at the lowest command and nearly the least trained angle."""
    return CompiledPredictor.of_simulator(simulator).initial(simulator.trained_angle_deg.lower, commands.lower)


def _run(simulator: Simulator, state: Vec, commands: Vec) -> tuple[float, Vec]:
    theta, after = run_chain(simulator.chain, simulator.dt_s, state, commands, settle=True)
    return float(theta[-1]), after
