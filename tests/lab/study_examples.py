"""Small trials and results for tests of studies."""

from __future__ import annotations

import numpy as np

from hystmpc.models.simulator import ChainModel
from hystmpc.trials.trial import Trial
from hystmpc_lab.papers.job import JobResult, Splits, TrainingJob

from ..models.zoo import CHAINS, simulator

JOB = JobResult(
    TrainingJob("main", "backlash", "paper", "forward", "sin", None, 1, None), "abc", "done", "fine", 1.5, 100
)


def small_trial(source: str, phase: float = 0.0, seconds: float = 20.0) -> Trial:
    """A decaying sinusoid with a hold at its end on a simulated device with noise, 25 Hz."""
    t = np.arange(0, seconds, 0.04)
    u = 3 * np.exp(-0.05 * t) * (np.sin(2 * np.pi * 0.25 * t - np.pi / 2 + phase) + 1)
    u[-50:] = u[-50]
    model = ChainModel(simulator(CHAINS["pi"], dt=0.04))
    noise = np.random.default_rng(len(source)).normal(0, 0.05, t.size)
    return Trial(t, u, model.run(u, 23.0) + noise, source=source)


def small_splits() -> Splits:
    """One trial in each split of S2's data set."""
    names = [f"{motion}/{part}" for motion in ("sin", "p2p") for part in ("train", "val", "test")]
    return {name: (small_trial(f"s2/{name}", 0.3 * k),) for k, name in enumerate(names)}
