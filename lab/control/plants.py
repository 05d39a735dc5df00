"""The plants of the closed-loop benchmark: tendon catheters, each as its models know it and with other parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.load import library_file
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.models.simulator import ChainModel, Simulator, load_simulator
from hystmpc.sim.plants.simulated import Effects, SimulatedPlant, mismatched

MISMATCH = 1.2
"""Factor on every parameter of a plant whose models are off, its lag and delay included."""

_LAG_S, _DELAY_S, _NOISE_DEG = 0.08, 0.08, 0.15
# The answer creeps on by a twentieth of the step within some seconds.
_CREEP = Creep((-0.05,), (5.0,))
_SLOW_S = 120.0  # of a quasi-static loop: the thresholds' growth with speed is a thousandth of a millimetre then
_WHOLE = 1e-9


@dataclass(frozen=True)
class Plant:
    """One device of the benchmark.

    Attributes:
        family: its name without mismatch: what models are identified on.
        lag_s, delay_s: of its actuator [s].
        noise_deg: standard deviation of its sensor [deg].
        factor: on all its parameters, lag and delay included; 1 for the device that models were identified on.
    """

    name: str
    family: str
    library: str
    lag_s: float = 0.0
    delay_s: float = 0.0
    noise_deg: float = 0.0
    before: tuple[Operator, ...] = ()
    factor: float = 1.0

    @property
    def off(self) -> bool:
        """Whether models have other parameters than the device."""
        return self.factor != 1.0

    @property
    def ideal(self) -> bool:
        """Without lag, delay, noise and creep."""
        return self.effects == Effects() and not self.before

    @property
    def effects(self) -> Effects:
        """Effects of the device that its simulator does not contain."""
        return Effects(lag_s=self.factor * self.lag_s, delay_s=self.factor * self.delay_s, noise_deg=self.noise_deg)

    def nominal(self) -> Plant:
        """The device that models are identified on."""
        return replace(self, name=self.family, factor=1.0)

    def simulator(self, dt_s: float) -> Simulator:
        """Hysteresis and creep, without lag and delay, at a sample time [s]."""
        base = load_simulator(library_file(self.library))
        chain = replace(base.chain, before=self.before)
        return replace(base, chain=mismatched(chain, dict.fromkeys(chain.labels, self.factor))).at_sample_time(dt_s)

    def device(self, dt_s: float, seed: int = 0) -> SimulatedPlant:
        """The device, without anything that is written to files."""
        return SimulatedPlant(self.simulator(dt_s), self.effects, dt_s, seed=seed)

    def oracle(self, dt_s: float) -> tuple[Simulator, int]:
        """A simulator that knows everything but whole samples of delay, and these."""
        effects, simulator = self.effects, self.simulator(dt_s)
        samples = int(effects.delay_s / dt_s + _WHOLE)
        rest = effects.delay_s - samples * dt_s
        delay = (Delay.at_rate(rest, dt_s),) if rest > _WHOLE else ()
        lag = (Lag(effects.lag_s),) if effects.lag_s > 0 else ()
        chain = simulator.chain
        return replace(simulator, chain=replace(chain, before=(*delay, *lag, *chain.before))), samples


def _pairs(*plants: Plant) -> Mapping[str, Plant]:
    off = [replace(plant, name=f"{plant.name}-off", factor=MISMATCH) for plant in plants]
    return MappingProxyType({plant.name: plant for pair in zip(plants, off, strict=True) for plant in pair})


PLANTS: Mapping[str, Plant] = _pairs(
    Plant("backlash", "backlash", "backlash"),
    Plant("pi", "pi", "tendon-catheter"),
    Plant("noisy", "noisy", "tendon-catheter", _LAG_S, _DELAY_S, _NOISE_DEG, (_CREEP,)),
)
"""All plants by name; `-off` has every parameter `MISMATCH` times that of the device that models were identified on."""


def half_width(simulator: Simulator) -> float:
    """Half the width of the hysteresis loop at its middle angle [cmd], from a slow run over the whole command range.

    Only the core counts; what stands before and after it has no part in the backlash.
    """
    slow = replace(simulator, chain=Chain(simulator.chain.core)).at_sample_time(0.01)
    limits = simulator.command_limits
    up = np.linspace(limits.lower, limits.upper, round(0.5 * _SLOW_S / slow.dt_s))
    theta = ChainModel(slow).run(np.concatenate([up, up[::-1], up, up[::-1]]), simulator.trained_angle_deg.lower)
    rising, falling = theta[2 * up.size : 3 * up.size], theta[3 * up.size :]
    middle = 0.5 * (rising[0] + rising[-1])
    return 0.5 * float(np.interp(middle, rising, up) - np.interp(middle, falling[::-1], up))
