"""The simulated device: a chain of operators with effects on either side, sensors and wrong parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.effects.place import PlacedEffect, effect_from, with_effect
from hystmpc.models.operators.delay import Delay
from hystmpc.models.operators.lag import Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.sensor import Sensor
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.models.simulator import Simulator
from hystmpc.trials.errors import ConfigError, ModelError, did_you_mean

from .conditioning import conditioned, fresh
from .sensors import SensorChain

Vec = NDArray[np.float64]


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
    lag = (Lag(effects.lag_s),) if effects.lag_s > 0 else ()
    delay = (Delay(effects.delay_s, samples=1),) if effects.delay_s > 0 else ()
    own = tuple(operator for operator in chain.after if not isinstance(operator, Sensor))
    chain = replace(chain, before=(*delay, *lag, *chain.before), after=own)
    for placed in effects.placed:
        chain = with_effect(chain, placed.operator, placed.side)
    return at_sample_time(replace(simulator, chain=chain), dt_s)


def at_sample_time(simulator: Simulator, dt_s: float) -> Simulator:
    """The same simulator at sample time `dt_s` [s]: delays get the store that they need at it."""

    def stored(operators: tuple[Operator, ...]) -> tuple[Operator, ...]:
        return tuple(Delay.at_rate(o.delay_s, dt_s) if isinstance(o, Delay) else o for o in operators)

    chain = simulator.chain
    return replace(simulator, chain=replace(chain, before=stored(chain.before), after=stored(chain.after)), dt_s=dt_s)


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
class SimulatedPlant:
    """A `ctrl.protocols.Plant` that is computed; its state is hidden, as that of hardware is.

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
        self._effects, self._seed = effects or Effects(), seed
        self._dt = simulator.dt_s if dt_s is None else dt_s
        commands = commands or simulator.command_limits
        self.simulator = plant_simulator(simulator, self._effects, self._dt)
        self.rest_command = commands.lower
        self._model = CompiledPredictor.of_simulator(self.simulator)
        self._rest = self._at_rest(commands)
        self._angle, self._state = self._rest
        own = tuple(o for o in simulator.chain.after if isinstance(o, Sensor))
        self._sensors = SensorChain((*own, *self._effects.sensors))
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
        self._angle, self._state = self._model.advance(self._state, u)
        return self._measured()

    def reseeded(self, seed: int) -> SimulatedPlant:
        """The same device with another realisation of its sensor noise."""
        other = copy(self)
        other._seed = seed
        other.reset()
        return other

    def stop(self) -> None:
        """Nothing to do: a computed device is safe as it stands."""

    def _restart(self) -> None:
        self._angle, self._state = self._rest
        self._random = np.random.default_rng(self._seed)
        self._sensing = self._sensors.start(self._angle, self._seed)

    def _at_rest(self, commands: Range) -> tuple[float, Vec]:
        """Angle and state of the device at rest, after its initialisation flexure or without it."""
        state = self._model.initial(self.simulator.trained_angle_deg.lower, commands.lower)
        return (fresh if self._effects.virgin else conditioned)(self.simulator, state, commands)

    def _measured(self) -> float:
        effects = self._effects
        angle = self._angle + effects.noise_deg * float(self._random.standard_normal())
        if effects.quantisation_deg:
            angle = round(angle / effects.quantisation_deg) * effects.quantisation_deg
        angle, self._sensing = self._sensors.show(self._sensing, angle)
        return angle
