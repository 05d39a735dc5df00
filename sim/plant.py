"""The simulated device: a chain of operators with effects on either side, sensors and wrong parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from copy import copy, deepcopy
from dataclasses import dataclass, field, replace
from typing import Any, Self, final

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.models.effects.place import PlacedEffect, effect_from, with_effect
from hystmpc.models.kernels.chain_kernels import compile_step
from hystmpc.models.lstm.initial import initialisation_flexure
from hystmpc.models.operators.creep import Creep
from hystmpc.models.operators.delay import Delay
from hystmpc.models.operators.lag import Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.sensor import Sensor
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.models.simulator import Simulator
from hystmpc.trials.errors import ConfigError, ModelError, did_you_mean
from hystmpc.trials.types import Vec

_SETTLED = 20.0  # time constants after which nothing is left of a step: e^-20 of 100 deg is 2e-7 deg
_LONGEST_REST_S = 600.0  # slower creep has not settled when an experiment begins


def conditioned(simulator: Simulator, state: Vec, commands: Range) -> tuple[float, Vec]:
    """Angle [deg] and state at the lowest command after the initialisation flexure and a rest.

    The rest lasts until lags have settled, and creep within ten minutes. What follows a clock stands still meanwhile:
    the clock starts with the run.

    Args:
        simulator: the device with its effects.
        state: at rest at the lowest command.
        commands: between which it is flexed.
    """
    flexure = initialisation_flexure(commands, simulator.dt_s, warmup_samples=1)
    samples = round(settling_s(simulator.chain) / simulator.dt_s)
    return _run(simulator, state, np.concatenate([flexure, np.full(samples, commands.lower)]))


def fresh(simulator: Simulator, state: Vec, commands: Range) -> tuple[float, Vec]:
    """Angle [deg] and state at the lowest command of a device that was never bent; arguments as `conditioned`."""
    return _run(simulator, state, np.full(1, commands.lower))


def _run(simulator: Simulator, state: Vec, commands: Vec) -> tuple[float, Vec]:
    """The last angle, and the state with its clocks at zero."""
    chain = simulator.chain
    kernels = compile_step(chain.transition)
    following, theta = state.reshape(1, -1).copy(), np.empty((1, commands.size))
    dt = np.array([simulator.dt_s])
    kernels.simulate(following, commands[None], still(chain), dt, kernels.step_constants, theta)
    return float(theta[0, -1]), np.where(clocks(chain), 0.0, following[0])


def settling_s(chain: Chain) -> float:
    """Time after which a held command leaves the chain at rest [s]."""
    return sum(_settling_of(operator) for operator in chain.operators)


def _settling_of(operator: Operator) -> float:
    if isinstance(operator, Lag):
        return _SETTLED * max(operator.tau_s, *operator.tau_down_s, 0.0)
    if isinstance(operator, Creep):
        return min(_SETTLED * max(operator.taus_s), _LONGEST_REST_S)
    return operator.delay_s if isinstance(operator, Delay) else 0.0


def still(chain: Chain) -> Vec:
    """Parameter values of the chain with everything that follows a clock at its neutral values."""
    values: list[float] = []
    for operator in chain.operators:
        effect = EFFECTS.get(operator.name)
        values += effect.neutral_values(operator) if effect is not None and effect.clocks else operator.values
    return np.array(values)


def clocks(chain: Chain) -> NDArray[np.bool_]:
    """Which entries of the state are clocks."""
    found = []
    for operator in chain.operators:
        effect = EFFECTS.get(operator.name)
        found += [effect is not None and name in effect.clocks for name in operator.states]
    return np.array(found, dtype=bool)


_STEP = np.array([1.0])  # sensors have no time in them


@final
class SensorChain:
    """Sensors one after another, with explicit state; none at all shows the angle itself.

    Args:
        sensors: in the order in which the angle passes them.
    """

    def __init__(self, sensors: Sequence[Sensor]) -> None:
        self._sensors = tuple(sensors)
        if self._sensors:
            chain = Chain(self._sensors[0], after=self._sensors[1:])
            self._values, self._kernels = chain.values, compile_step(chain.transition)

    def start(self, angle: float, seed: int) -> Vec:
        """State (S,) at a true angle [deg]; `seed` is mixed into the seed of every sensor."""
        states = [
            np.asarray(sensor.reseeded(_mixed(sensor.seed, seed, k)).at_rest(angle, angle, sensor.values)).ravel()
            for k, sensor in enumerate(self._sensors)
        ]
        return np.concatenate([np.empty(0), *states])

    def show(self, state: Vec, angle: float) -> tuple[float, Vec]:
        """What is shown of a true angle [deg], and the next state."""
        if not self._sensors:
            return angle, state
        following, shown = state.reshape(1, -1).copy(), np.empty((1, 1))
        constants = self._kernels.step_constants
        self._kernels.simulate(following, np.array([[angle]]), self._values, _STEP, constants, shown)
        return float(shown[0, 0]), following[0]


def _mixed(own: int, seed: int, k: int) -> int:
    """A seed for sensor number `k`; the generator mixes neighbouring seeds itself."""
    return (own + 1_000_003 * (seed + 7919 * k)) % 2**63


@dataclass(frozen=True)
class Sensing:
    """What measures the angle.

    Attributes:
        noise_deg: standard deviation of white noise [deg].
        quantisation_deg: step of the angle, 0 for none [deg].
        sensors: of the library, after both.
    """

    noise_deg: float = 0.0
    quantisation_deg: float = 0.0
    sensors: Sequence[Sensor] = ()


class ComputedPlant(ABC):
    """A `ctrl.protocols.Plant` that is computed; its state is hidden, as that of hardware is.

    A reset always finds the same device: rest, random numbers and noise begin anew. A subclass says where the rest is
    and what a sample does; its state is replaced from sample to sample and never altered, so that copies may share it.

    Args:
        dt_s: sample time [s].
        rest_command: what the device holds at rest.
        command_unit: mm or bar.
        sensing: of the angle.
        seed: of noise and of what is random in the device; equal seeds give the same run after every reset.

    Raises:
        ConfigError: if the sample time is not positive.
    """

    command_limits: Range
    """What the device may be sent; the commands of a study may be narrower."""
    _state: Any

    def __init__(self, dt_s: float, rest_command: float, command_unit: str, sensing: Sensing, seed: int) -> None:
        if not (np.isfinite(dt_s) and dt_s > 0):
            raise ConfigError(f"dt_s: got {dt_s}, expected a positive number")
        self._dt, self._seed, self._sensing = dt_s, seed, sensing
        self.rest_command, self.command_unit = rest_command, command_unit
        self._chain = SensorChain(sensing.sensors)
        self._restart()

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self._dt

    @property
    def true_angle(self) -> float:
        """Tip angle without noise and quantisation [deg]: what metrics are made of, and no controller sees."""
        return self._angle

    def reset(self) -> float:
        """Bring the device to rest at its lowest command and return the measured tip angle [deg]."""
        self._restart()
        return self._measured()

    def apply(self, u: float) -> float:
        """Apply command `u` for one sample and return the tip angle measured at its end [deg]."""
        self._angle, self._state = self._advanced(self._state, u, self._random)
        return self._measured()

    def reseeded(self, seed: int) -> Self:
        """The same device with another realisation of everything random."""
        other = copy(self)
        other._seed = seed
        other.reset()
        return other

    def copied(self) -> Self:
        """A plant that goes on from where this one is, with the same noise to come; neither touches the other."""
        other = copy(self)
        other._random = deepcopy(self._random)
        return other

    def stop(self) -> None:  # noqa: B027  # hardware has something to do here
        """Nothing to do: a computed device is safe as it stands."""

    @abstractmethod
    def _at_rest(self, random: np.random.Generator) -> tuple[float, Any]:
        """True angle [deg] and state before a run."""

    @abstractmethod
    def _advanced(self, state: Any, u: float, random: np.random.Generator) -> tuple[float, Any]:
        """True angle [deg] and state after command `u` for one sample."""

    def _restart(self) -> None:
        self._random = np.random.default_rng(self._seed)
        self._angle, self._state = self._at_rest(self._random)
        self._shown = self._chain.start(self._angle, self._seed)

    def _measured(self) -> float:
        angle = self._angle + self._sensing.noise_deg * float(self._random.standard_normal())
        if self._sensing.quantisation_deg:
            angle = round(angle / self._sensing.quantisation_deg) * self._sensing.quantisation_deg
        angle, self._shown = self._chain.show(self._shown, angle)
        return angle


@dataclass(frozen=True)
class Effects:
    """What the device does beyond its simulator.

    Attributes:
        lag_s: time constant of a first-order lag of the actuator, 0 for none [s].
        delay_s: transport delay of the command, fractions of a sample allowed [s].
        noise_deg: standard deviation of the angle sensor's white noise [deg].
        quantisation_deg: step of the angle sensor, 0 for none [deg].
        mismatch: factors on parameters of the simulator, by label, such as `prandtl_ishlinskii.a0`.
        effects: effects of the library, as objects or as `{effect, side, parameters}`, in the order in which the signal
            meets them: those on the command after delay and lag and the simulator's own, those on the output last.
            Sensors act on what is measured.
        virgin: start without the initialisation flexure, so that a first flexure is still to come.

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
        """The effects of the library that act on the device, sensors left out."""
        return tuple(e for e in self._placed() if not isinstance(e.operator, Sensor))

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The sensors among the effects."""
        return tuple(e.operator for e in self._placed() if isinstance(e.operator, Sensor))

    def sensing(self, before: tuple[Sensor, ...] = ()) -> Sensing:
        """What measures the angle; `before` are sensors that the device has of its own."""
        return Sensing(self.noise_deg, self.quantisation_deg, (*before, *self.sensors))

    @property
    def actuator(self) -> tuple[Operator, ...]:
        """Delay and lag of the actuator."""
        lag = (Lag(self.lag_s),) if self.lag_s > 0 else ()
        return (*((Delay(self.delay_s, samples=1),) if self.delay_s > 0 else ()), *lag)

    def _placed(self) -> tuple[PlacedEffect, ...]:
        return tuple(e for e in self.effects if isinstance(e, PlacedEffect))


def _placed(spec: PlacedEffect | Mapping[str, Any], k: int) -> PlacedEffect:
    if isinstance(spec, PlacedEffect):
        return spec
    try:
        return effect_from({key: value for key, value in spec.items() if value is not None})
    except ModelError as error:
        raise ConfigError(f"plant.effects[{k}]: {error}") from None


def plant_simulator(simulator: Simulator, effects: Effects, dt_s: float) -> Simulator:
    """The simulator at sample time `dt_s` [s], with wrong parameters and all effects but sensors.

    Lag and delay of the actuator stand in front, effects of the library on either side after what is there.

    Raises:
        ConfigError: if `mismatch` names a parameter that the chain does not have.
        ModelError: if a factor takes a parameter out of its bounds.
    """
    chain = mismatched(simulator.chain, effects.mismatch)
    own = tuple(operator for operator in chain.after if not isinstance(operator, Sensor))
    chain = replace(chain, before=(*effects.actuator, *chain.before), after=own)
    for placed in effects.placed:
        chain = with_effect(chain, placed.operator, placed.side)
    return at_sample_time(replace(simulator, chain=chain), dt_s)


def at_sample_time(simulator: Simulator, dt_s: float) -> Simulator:
    """The same simulator at sample time `dt_s` [s]: delays get the store that they need at it."""
    chain = simulator.chain
    before, after = stored(chain.before, dt_s), stored(chain.after, dt_s)
    return replace(simulator, chain=replace(chain, before=before, after=after), dt_s=dt_s)


def stored(operators: Sequence[Operator], dt_s: float) -> tuple[Operator, ...]:
    """The operators, delays with the store that they need at sample time `dt_s` [s]."""
    return tuple(Delay.at_rate(o.delay_s, dt_s) if isinstance(o, Delay) else o for o in operators)


def mismatched(chain: Chain, factors: Mapping[str, float]) -> Chain:
    """The chain with some parameters multiplied.

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
    """A chain of operators as a plant.

    Before every run the device does its initialisation flexure (S2: one period of 0.1 Hz to the highest command and
    back) and then rests at the lowest one, so that a reset always finds the same device. Drift and periodic disturbance
    count from the reset on, sensors start their random numbers anew.

    Args:
        simulator: the device.
        effects: what it does beyond that.
        dt_s: sample time [s]; the simulator's own where left out.
        commands: commands between which it is flexed, the lowest being its rest; the simulator's limits where left out.
        seed: of the sensor noise, mixed into the seed of every sensor among the effects; equal seeds give equal noise
            after every reset.

    Raises:
        ConfigError: if `effects` name a parameter that the simulator does not have.
        ModelError: if a mismatch takes a parameter out of its bounds.
    """

    def __init__(
        self,
        simulator: Simulator,
        effects: Effects | None = None,
        dt_s: float | None = None,
        commands: Range | None = None,
        seed: int = 0,
    ) -> None:
        effects, commands = effects or Effects(), commands or simulator.command_limits
        dt_s = simulator.dt_s if dt_s is None else dt_s
        self.simulator = plant_simulator(simulator, effects, dt_s)
        self._model = CompiledPredictor.of_simulator(self.simulator)
        state = self._model.initial(self.simulator.trained_angle_deg.lower, commands.lower)
        self._rest = (fresh if effects.virgin else conditioned)(self.simulator, state, commands)
        self.command_limits = simulator.command_limits
        own = tuple(o for o in simulator.chain.after if isinstance(o, Sensor))
        super().__init__(dt_s, commands.lower, simulator.command_unit, effects.sensing(own), seed)

    def _at_rest(self, random: np.random.Generator) -> tuple[float, Vec]:
        del random  # nothing in a chain is
        return self._rest

    def _advanced(self, state: Vec, u: float, random: np.random.Generator) -> tuple[float, Vec]:
        del random
        return self._model.advance(state, u)
