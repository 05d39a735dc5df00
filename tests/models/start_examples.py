"""Random devices and motions for the law of the start: what begins a free run, and what its error is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.model import LoadedModel
from hystmpc.models.operators.dynamics import Delay, Lag, Servo
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.models.operators.static_curves import Contact, NonlinearGain
from hystmpc.models.simulator import Simulator
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .zoo import CURVED, DRDPI, DT, simulator

NOISE_DEG = 0.05
Rng = np.random.Generator


class StagedModel(LoadedModel):
    """A simulator run operator by operator."""

    def __init__(self, device: Simulator) -> None:
        super().__init__(device.metadata(), "initial")
        self.chain, self._staged = device.chain, StagedChain(device.chain)

    def advance(self, state: Vec, u: Vec) -> tuple[Vec, Vec]:
        theta, following = self.run_on(state, u)
        return theta, following

    def run_on(self, states: Vec, commands: Vec) -> tuple[Vec, Vec]:
        theta, following = self._staged.simulate(commands.T, self.dt, states.T)
        return theta.T, following.T

    def casadi_function(self) -> Any:
        raise NotImplementedError


def random_chain(rng: Rng, widest: float = 3.0) -> Chain:
    """Drive, creep and valve or none of them, before a core whose plays are up to `widest` mm wide."""
    before: list[Operator] = []
    if rng.random() < 0.3:
        before.append(NonlinearGain(rng.uniform(-0.03, 0.05), 0.0, 2.0))
    if rng.random() < 0.5:
        before.append(Delay.at_rate(rng.uniform(0.01, 0.3), DT))
    if rng.random() < 0.7:
        before.append(Lag(rng.uniform(0.05, 1.0)) if rng.random() < 0.6 else Servo(rng.uniform(0.1, 0.4), 0.7, 0))
    if rng.random() < 0.4:
        before.append(Creep((-rng.uniform(0.02, 0.15),), (rng.uniform(1.0, 20.0),)))
    plays = int(rng.integers(1, 6))
    cores = (
        lambda: PrandtlIshlinskii(3.0, tuple(rng.uniform(0.5, 3.0, plays)), widest / plays * rng.random(), 0.0, 22.0),
        lambda: Backlash(10.27, 10.7, 2.8 + 0.5 * widest * rng.random(), 2.0),
        lambda: CURVED,
        lambda: replace(DRDPI, beta=0.0),
    )
    after = (Contact(70.0, 0.5),) if rng.random() < 0.2 else ()
    return Chain(cores[int(rng.integers(len(cores)))](), before=tuple(before), after=after)


def model_of(chain: Chain) -> StagedModel:
    """The chain as a catheter's simulator."""
    return StagedModel(simulator(chain))


def wandering(rng: Rng, seconds: float, low: float = 0.0, high: float = 6.0) -> Vec:
    """A sum of sines within a range (T,) [mm]."""
    t = np.arange(round(seconds / DT)) * DT
    waves = [np.sin(2 * np.pi * (f * t + rng.random())) for f in rng.uniform(0.08, 0.5, 3)]
    wave = sum(a * w for a, w in zip(rng.uniform(0.3, 1.0, 3), waves, strict=True))
    wave = (wave - wave.min()) / np.ptp(wave)
    return np.asarray(low + (high - low) * wave)


def rested(rng: Rng, model: LoadedModel, seconds: float = 20.0) -> Trial:
    """A trial from rest at a command and an angle drawn at random, held for a second, with noise."""
    u, y = rng.uniform(0.5, 5.5), rng.uniform(20.0, 85.0)
    motion = wandering(rng, seconds)
    way = np.linspace(u, motion[0], 25)
    command = np.concatenate([np.full(26, u), way, motion])
    return trial_of(rng, model, command, model.at_rest(y, u))


def trial_of(rng: Rng, model: LoadedModel, command: Vec, state: Vec) -> Trial:
    """What the device shows, with noise."""
    theta: Vec = model.run_on(state[None], command[None])[0][0]
    noise = NOISE_DEG * rng.standard_normal(command.size)
    return Trial(np.arange(command.size, dtype=np.float64) * DT, command, theta + noise)
