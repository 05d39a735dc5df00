"""Effects injected into real logs: real noise and hysteresis with one known effect added."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hystmpc.models.identify.chain_fit import OperatorFitSettings
from hystmpc.models.identify.simulators import identify
from hystmpc.models.simulator import Simulator
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from . import kernels
from .retuning import retune
from .sealed import Answer, Case, EffectAnswer

_FINE = 20
_RATIOS = (3.0, 2.2, 1.5)


@dataclass(frozen=True)
class Injection:
    """One way to change measured angles.

    Attributes:
        typical, greatest: size to begin with, and the largest that a log in use could have.
        change: angle (T,) [deg], its times [s] and the session's clock [s], size and draws to the changed angle.
    """

    name: str
    label: str
    typical: float
    greatest: float
    change: Callable[[Vec, Vec, float, float, np.random.Generator], Vec]


def _delayed(angle: Vec, t: Vec, clock: float, size: float, random: np.random.Generator) -> Vec:
    del clock, random
    return np.interp(t - size, t, angle)


def _low_pass(angle: Vec, t: Vec, clock: float, size: float, random: np.random.Generator) -> Vec:
    """Critically damped second order whose lag on a ramp is `size` [s]."""
    del clock, random
    fine = np.interp(np.linspace(t[0], t[-1], (t.size - 1) * _FINE + 1), t, angle)
    out = np.empty(fine.size)
    kernels.second_order(fine, (t[1] - t[0]) / _FINE, 2 / size, 1.0, out)
    return out[::_FINE]


def _quantised(angle: Vec, t: Vec, clock: float, size: float, random: np.random.Generator) -> Vec:
    del t, clock, random
    return np.round(angle / size) * size


def _drifting(angle: Vec, t: Vec, clock: float, size: float, random: np.random.Generator) -> Vec:
    """`size` [deg/min] over the session, with a random walk about it."""
    walk = np.cumsum(random.standard_normal(t.size)) * np.sqrt((t[1] - t[0]) / 60)
    return angle + size * ((clock + t) / 60 + 0.15 * walk)


INJECTIONS = (
    Injection("delayed", "delay", 0.1, 0.4, _delayed),
    Injection("low_pass", "lag", 0.1, 0.8, _low_pass),
    Injection("quantised", "sensor", 2.0, 10.0, _quantised),
    Injection("drifting", "drift", 1.0, 15.0, _drifting),
)


def injection_case(logs: Sequence[Trial], number: int, random: np.random.Generator) -> Case:
    """The logs with one effect in their angles, and a backlash identified on the logs as they were.

    The gap of these logs without the injection is that of the real device; the ratio counts in it. Where the greatest
    size comes first the ratio is smaller than was wanted.

    Raises:
        ConfigError: if there are fewer than two logs.
        FitError: if no backlash can be identified on them.
    """
    if len(logs) < 2:
        raise ConfigError(f"injection: got {len(logs)} logs, expected at least 2 of one device")
    injection, ratio = INJECTIONS[number % len(INJECTIONS)], _RATIOS[number // len(INJECTIONS) % len(_RATIOS)]
    named = [replace(trial, channels={}, source=f"fit_{k + 1:02d}.csv") for k, trial in enumerate(logs)]
    simulator, fit = identify("backlash", named, OperatorFitSettings(restarts=0))
    seed = int(random.integers(2**31))
    size = injection.typical
    for _ in range(5):  # the gap of delay, lag and drift is about in proportion to the size
        changed = _changed(logs, injection, size, seed)
        gap = _gap(simulator, logs, changed)
        factor = float(np.clip(ratio * fit.rmse_deg / max(gap, 1e-9), 0.25, 4.0))
        size = min(size * factor, injection.greatest)
    changed = _changed(logs, injection, size, seed)
    gap = _gap(simulator, logs, changed)
    effect = EffectAnswer(
        label=injection.label, generator=injection.name, size=size, ratio=gap / fit.rmse_deg, gap_deg=gap
    )
    answer = Answer(
        suite="injection",
        variant=Path(logs[0].source).parent.name,
        effects=(effect,),
        separable=False,  # nobody planned these motions
        plan="recorded",
        motions=tuple("recorded" for _ in logs),
        floor_deg=fit.rmse_deg,
        form_deg=fit.rmse_deg,
        baseline="backlash",
        seed=seed,
    )
    return Case(tuple(changed), simulator, answer)


def _changed(logs: Sequence[Trial], injection: Injection, size: float, seed: int) -> list[Trial]:
    random, clock, trials = np.random.default_rng(seed), 0.0, []
    for k, trial in enumerate(logs):
        angle = injection.change(trial.angle, trial.t - trial.t[0], clock, size, random)
        trials.append(Trial(trial.t - trial.t[0], trial.command, angle, {}, trial.units, f"trial_{k + 1:02d}.csv"))
        clock += trial.duration_s
    return trials


def _gap(simulator: Simulator, logs: Sequence[Trial], changed: Sequence[Trial]) -> float:
    """RMSE that a refit leaves of the change, added to the simulator's own runs [deg]."""
    commands = [trial.command for trial in logs]
    base = retune(simulator, commands, [trial.angle for trial in logs])
    target = [run + (b.angle - a.angle) for run, a, b in zip(base.angles, logs, changed, strict=True)]
    return retune(base.simulator, commands, target).rmse_deg
