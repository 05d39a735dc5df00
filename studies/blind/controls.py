"""Negative controls: logs in which there is nothing to find, whatever the residual looks like."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hystmpc.trials.types import Vec

from .answer import Answer
from .bench import Bench
from .case import Case
from .retuning import retune

CONTROLS = ("shuffled_residual", "simulator_and_noise", "mis_set")


def control_case(bench: Bench, variant: str) -> Case:
    """A case of one of the `CONTROLS`.

    Shuffled residual: what the retuned simulator leaves of the real logs, its samples in random order, added to that
    simulator: its size is kept and its structure gone. Simulator and noise: the retuned simulator itself. Mis-set: the
    device off its nominal numbers, and nothing else.
    """
    trials = bench.device.record(bench.plan.commands)
    if variant != "mis_set":
        tuned = retune(bench.simulator, bench.plan.commands, [trial.angle for trial in trials])
        noise = _noise(bench, variant, [t.angle - run for t, run in zip(trials, tuned.angles, strict=True)])
        step = bench.device.resolution_deg
        trials = [
            replace(trial, angle=np.round((run + part) / step) * step)
            for trial, run, part in zip(trials, tuned.angles, noise, strict=True)
        ]
    answer = Answer.model_validate({**bench.facts(), "suite": "controls", "variant": variant})
    return Case(tuple(trials), bench.simulator, answer)


def _noise(bench: Bench, variant: str, residuals: list[Vec]) -> list[Vec]:
    whole = np.concatenate(residuals)
    if variant == "shuffled_residual":
        mixed = bench.random.permutation(whole)
    else:
        mixed = bench.device.noise_deg * bench.random.standard_normal(whole.size)
    return np.split(mixed, np.cumsum([part.size for part in residuals])[:-1])
