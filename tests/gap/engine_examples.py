"""Small devices, commands and problems that the tests of the diagnosis run over."""

from __future__ import annotations

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.effects.catalogue import EFFECTS, candidates
from hystmpc.models.effects.effect import Candidate, Scale, base_name
from hystmpc.models.identify.baseline import Baseline, ScaledBaseline, baseline_of
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.identify.runs import Run, runs_of
from hystmpc.models.operators.operator import Operator
from hystmpc.models.simulator import Identification, Residual, Simulator
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..models.zoo import BACKLASH, RATE_PI, STATIC_PI

DT = 0.04
REST_DEG = 23.5  # what all devices can show at rest at zero
COMMAND = Range(lower=0.0, upper=6.0)
BASELINES: dict[str, Baseline] = {
    "backlash": baseline_of(Chain(BACKLASH), COMMAND),
    "plays": baseline_of(Chain(RATE_PI), COMMAND),
    "network": ScaledBaseline(Chain(STATIC_PI), COMMAND),
}
SCALE = Scale(0.0, 6.0, 22.0, 85.0, 12.0, 24.0, DT)
CANDIDATES: dict[str, tuple[Candidate, ...]] = {
    name: candidates(SCALE, baseline.effects) for name, baseline in BASELINES.items()
}
EVERY = [(name, candidate) for name, found in CANDIDATES.items() for candidate in found]
LABELS = [f"{name}: {candidate.label}" for name, candidate in EVERY]


def neutral_values(candidate: Candidate) -> list[float]:
    """Free parameters that make a candidate the identity; those that do not matter then keep their first start."""
    names = (*(operator.name for operator in candidate.operators), candidate.effect)
    known = {"toe": 1e-9} | {k: v for name in names if name in EFFECTS for k, v in EFFECTS[name].neutral.items()}
    pairs = zip(candidate.free, candidate.starts[0], strict=True)
    return [known.get(freedom.name, known.get(base_name(freedom.name), start)) for freedom, start in pairs]


def moves(seed: int, seconds: float = 12.0, hold_s: float = 1.2, speed: float = 6.0) -> Vec:
    """Moves between random levels with holds, from rest at zero."""
    random, times, levels = np.random.default_rng(seed), [0.0, 0.4], [0.0, 0.0]
    while times[-1] < seconds:
        level = float(random.uniform(0.0, 6.0))
        way = abs(level - levels[-1]) / speed + DT
        times += [times[-1] + way, times[-1] + way + hold_s * float(random.uniform(0.5, 1.5))]
        levels += [level, level]
    return np.interp(DT * np.arange(round(seconds / DT)), times, levels)


def sine(hz: float, seconds: float = 20.0) -> Vec:
    """One sine over the whole range, from rest."""
    return 3.0 * (1 - np.cos(2 * np.pi * hz * DT * np.arange(round(seconds / DT))))


def trials_of(
    chain: Chain, commands: list[Vec], noise_deg: float = 0.05, seed: int = 0, shifts: tuple[float, ...] = ()
) -> list[Trial]:
    """What a device of that chain would record; each trial starts at rest and anew."""
    random, staged, trials = np.random.default_rng(seed), StagedChain(chain), []
    for k, command in enumerate(commands):
        state = staged.rest(command[:1], np.array([REST_DEG]))
        angle = staged.simulate(command[:, None], DT, state)[0][:, 0] + noise_deg * random.standard_normal(command.size)
        shift = shifts[k] if shifts else 0.0
        trials.append(
            Trial(DT * np.arange(command.size, dtype=np.float64), command, angle + shift, source=f"trial_{k}.csv")
        )
    return trials


def device_runs(speed: float = 6.0) -> tuple[Run, ...]:
    """Two trials of a backlash without any effect."""
    return runs_of(trials_of(Chain(BACKLASH), [moves(1, speed=speed), moves(2, speed=speed)]))


def simulator_of(core: Operator, residuals: tuple[Residual, ...] = (), data_hash: str = "") -> Simulator:
    """A simulator of a device that goes from 0 to 6 mm."""
    return Simulator(
        chain=Chain(core),
        dt_s=DT,
        command_unit="mm",
        command_limits=COMMAND,
        command_rate_per_s=12.0,
        trained_command=COMMAND,
        trained_angle_deg=Range(lower=20.0, upper=90.0),
        trained_rate_per_s=12.0,
        identification=Identification(method="known", residuals=residuals, training_data_hash=data_hash),
    )
