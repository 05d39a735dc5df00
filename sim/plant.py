"""The simulated device: a chain of operators with actuator lag, transport delay, sensor noise and wrong parameters."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.lstm.initial import initialisation_flexure
from hystmpc.models.operators.delay import Delay
from hystmpc.models.operators.lag import Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.prediction.compiled import CompiledPredictor
from hystmpc.models.simulator import Simulator
from hystmpc.trials.errors import ConfigError, did_you_mean

Vec = NDArray[np.float64]

_SETTLED_LAGS = 20.0  # time constants after which nothing is left of a step: e^-20 of 100 deg is 2e-7 deg


@dataclass(frozen=True)
class Effects:
    """What the device does beyond its simulator.

    Attributes:
        lag_s: time constant of a first-order lag of the actuator, 0 for none [s].
        delay_s: transport delay of the command, fractions of a sample allowed [s].
        noise_deg: standard deviation of the angle sensor's white noise [deg].
        quantisation_deg: step of the angle sensor, 0 for none [deg].
        mismatch: factors on parameters of the simulator, by label, such as `prandtl_ishlinskii.a0`.

    Raises:
        ConfigError: if a number is negative or not finite.
    """

    lag_s: float = 0.0
    delay_s: float = 0.0
    noise_deg: float = 0.0
    quantisation_deg: float = 0.0
    mismatch: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("lag_s", "delay_s", "noise_deg", "quantisation_deg"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0):
                raise ConfigError(f"plant: got {name} {value}, expected a finite number >= 0")


def plant_simulator(simulator: Simulator, effects: Effects, dt_s: float) -> Simulator:
    """The simulator at sample time `dt_s` [s], with wrong parameters and the effects on the command in front.

    Raises:
        ConfigError: if `mismatch` names a parameter that the chain does not have.
        ModelError: if a factor takes a parameter out of its bounds.
    """
    chain = mismatched(simulator.chain, effects.mismatch)
    lag = (Lag(effects.lag_s),) if effects.lag_s > 0 else ()
    delay = (Delay(effects.delay_s, samples=1),) if effects.delay_s > 0 else ()
    return at_sample_time(replace(simulator, chain=replace(chain, before=(*delay, *lag, *chain.before))), dt_s)


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
    back) and then rests at the lowest one, so that a reset always finds the same device.

    Args:
        simulator: the device.
        effects: what it does beyond that.
        dt_s: sample time [s]; the simulator's own where left out.
        commands: commands between which it is flexed, the lowest being its rest; the simulator's limits where left out.
        seed: of the sensor noise; equal seeds give equal noise after every reset.

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
        self._rest = self._flexed(commands)
        self._angle, self._state = self._rest
        self._random = np.random.default_rng(seed)

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
        self._angle, self._state = self._rest
        self._random = np.random.default_rng(self._seed)
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

    def _flexed(self, commands: Range) -> tuple[float, Vec]:
        """Angle and state of the device at rest after its initialisation flexure."""
        settling = _SETTLED_LAGS * self._effects.lag_s + self._effects.delay_s
        flexure = initialisation_flexure(commands, self._dt, warmup_samples=1)
        angle = self.simulator.trained_angle_deg.lower
        state = self._model.initial(angle, commands.lower)
        for u in np.concatenate([flexure, np.full(round(settling / self._dt), commands.lower)]):
            angle, state = self._model.advance(state, float(u))
        return angle, state

    def _measured(self) -> float:
        effects = self._effects
        angle = self._angle + effects.noise_deg * float(self._random.standard_normal())
        return round(angle / effects.quantisation_deg) * effects.quantisation_deg if effects.quantisation_deg else angle
