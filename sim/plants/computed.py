"""Base class of simulated plants, and series of operators with explicit state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy, deepcopy
from dataclasses import dataclass
from typing import Any, Self, final

import numpy as np
from numpy.typing import NDArray

from hystmpc.core.chain import PreparedChain
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.measurement import Sensor
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.models.stages import chain_code, prepared
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec


@dataclass(frozen=True)
class Sensing:
    """Angle sensor: white noise, resolution (0 for continuous) [deg], and sensors of the library after both."""

    noise_deg: float = 0.0
    quantisation_deg: float = 0.0
    sensors: Sequence[Sensor] = ()


class RepeatablePlant(ABC):
    """Base class of plants whose random numbers can be repeated; their state is replaced and never altered."""

    seed: int
    _random: np.random.Generator

    @abstractmethod
    def reset(self) -> Any:
        """Bring the device to rest, with the random numbers of its seed, and return what is measured."""

    def reseeded(self, seed: int) -> Self:
        """Return the same device with another realisation of all random numbers."""
        other = copy(self)
        other.seed = seed
        other.reset()
        return other

    def copied(self) -> Self:
        """Return a plant that continues from the present state with the same future noise; the two are independent."""
        other = copy(self)
        other._random = deepcopy(self._random)
        return other


class ComputedPlant(RepeatablePlant):
    """Base class of computed plants (`ctrl.loop.Plant`); the state is hidden, as in a real device.

    A reset always returns to the same rest and restarts the random numbers. A subclass defines the rest and the change
    within a sample; its state is replaced in each sample and never altered, so that copies may share it.

    Args:
        seed: of noise and randomness of the device; equal seeds give the same run after every reset.

    Raises:
        ConfigError: if the sample time is not positive.
    """

    command_limits: Range
    """What the device may be sent; the commands of a study may be narrower."""
    _state: Any

    def __init__(self, dt_s: float, rest_command: float, command_unit: str, sensing: Sensing, seed: int) -> None:
        if not (np.isfinite(dt_s) and dt_s > 0):
            raise ConfigError(f"dt_s: got {dt_s}, expected a positive number")
        self.dt, self.seed, self.sensing = dt_s, seed, sensing
        self.rest_command, self.command_unit = rest_command, command_unit
        self._sensors = OperatorCascade(sensing.sensors, 1.0)  # sensors do not depend on time
        self._restart()

    @property
    def true_angle(self) -> float:
        """Tip angle without noise and quantisation [deg], for metrics; hidden from controllers."""
        return self._angle

    def reset(self) -> float:
        """Bring the device to rest at its rest command, and return the measured tip angle [deg]."""
        self._restart()
        return self._measured()

    def apply(self, u: float) -> float:
        """Apply command `u` for one sample and return the tip angle measured at its end [deg]."""
        self._angle, self._state = self._advanced(self._state, u, self._random)
        return self._measured()

    def stop(self) -> None:  # hardware has something to do here
        """Do nothing: a computed device is always safe."""

    @abstractmethod
    def _at_rest(self, random: np.random.Generator) -> tuple[float, Any]:
        """Return the true angle [deg] and the state before a run."""

    @abstractmethod
    def _advanced(self, state: Any, u: float, random: np.random.Generator) -> tuple[float, Any]:
        """Return the true angle [deg] and the state after command `u` for one sample."""

    def _restart(self) -> None:
        self._random = np.random.default_rng(self.seed)
        self._angle, self._state = self._at_rest(self._random)
        self._shown = sensors_at_rest(self.sensing.sensors, self._angle, self.seed)

    def _measured(self) -> float:
        angle = self._angle + self.sensing.noise_deg * float(self._random.standard_normal())
        if self.sensing.quantisation_deg:
            angle = round(angle / self.sensing.quantisation_deg) * self.sensing.quantisation_deg
        shown, self._shown = self._sensors.run(self._shown, np.array([angle]))
        return float(shown[0])


def sensors_at_rest(sensors: Sequence[Sensor], angle: float, seed: int) -> Vec:
    """Return the state (S,) of sensors in series at a true angle [deg]; `seed` is mixed into every sensor's seed."""
    states = [
        np.asarray(sensor.reseeded(_mixed(sensor.seed, seed, k)).at_rest(angle, angle, sensor.values)).ravel()
        for k, sensor in enumerate(sensors)
    ]
    return np.concatenate([np.empty(0), *states])


def _mixed(sensor_seed: int, seed: int, k: int) -> int:
    """Seed of sensor number `k`; the generator decorrelates neighbouring seeds."""
    return (sensor_seed + 1_000_003 * (seed + 7919 * k)) % 2**63


_SETTLED = 20.0  # time constants after which a step response has settled: e^-20 of 100 deg is 2e-7 deg
_LONGEST_REST_S = 600.0  # slower creep has not settled at the start of an experiment


def settling_s(chain: Chain) -> float:
    """Return the time after which a chain under a held command is at rest [s]."""
    return sum(_settling_of(operator) for operator in chain.operators)


def _settling_of(operator: Operator) -> float:
    operator = operator.inner
    if isinstance(operator, Lag):
        return _SETTLED * max(operator.tau_s, *operator.tau_down_s, 0.0)
    if isinstance(operator, Creep):
        return min(_SETTLED * max(operator.taus_s), _LONGEST_REST_S)
    return operator.delay_s if isinstance(operator, Delay) else 0.0


def still(chain: Chain) -> Vec:
    """Return the chain's parameter values with every clock-driven operator at its neutral values."""
    values: list[float] = []
    for operator in chain.operators:
        effect = EFFECTS.get(operator.name)
        values += effect.neutral_values(operator) if effect is not None and effect.clocks else operator.values
    return np.array(values)


def clocks(chain: Chain) -> NDArray[np.bool_]:
    """Return the mask of the state's entries that are clocks."""
    mask = []
    for operator in chain.operators:
        effect = EFFECTS.get(operator.name)
        mask += [effect is not None and name in effect.clocks for name in operator.states]
    return np.array(mask, dtype=bool)


@final
class OperatorCascade:
    """Operators in series with explicit state and sample time `dt_s` [s]; the identity without operators."""

    def __init__(self, operators: Sequence[Operator], dt_s: float) -> None:
        self._chain = Chain(operators[0], after=tuple(operators[1:])) if operators else None
        self._run = prepared(operators, dt_s) if operators else None
        self._dt_s = dt_s

    @property
    def settling_s(self) -> float:
        """Time after which the output is at rest under a constant signal [s]."""
        return 0.0 if self._chain is None else settling_s(self._chain)

    def at_rest(self, signal: float) -> Vec:
        """Return the state (S,) after a signal that has been constant for long."""
        if self._chain is None:
            return np.empty(0)
        return np.asarray(self._chain.rest(signal, signal, self._chain.values), dtype=np.float64).ravel()

    def run(self, state: Vec, signal: Vec, settle: bool = False) -> tuple[Vec, Vec]:
        """Compute the output for a signal (T,), and the state after it; `settle` as of `run_chain`."""
        if self._chain is None:
            return signal, state
        return run_chain(self._chain, self._dt_s, state, signal, self._run, settle)


def run_chain(
    chain: Chain, dt_s: float, state: Vec, signal: Vec, run: PreparedChain | None = None, settle: bool = False
) -> tuple[Vec, Vec]:
    """Compute the output (T,) of a chain for a signal (T,), and its final state; the given state (S,) is unchanged.

    Args:
        run: of the chain and the sample time; made where left out, which takes longer than a sample.
        settle: whether clock-driven effects are frozen, with their clocks at zero afterwards.
    """
    if settle:
        run = PreparedChain(chain_code(chain.operators), still(chain), dt_s)
    run = run or prepared(chain.operators, dt_s)
    shown, after = run.run(state[None], signal[None])
    return shown[0], np.where(clocks(chain), 0.0, after[0]) if settle else after[0]
