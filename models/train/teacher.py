"""Free runs of an identified operator over random motions: additional training data of a network."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal, final

import numpy as np

from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..contract.metadata import DeviceLimits, Range
from ..identify.runs import check_trial_set, command_range, fastest_command
from ..identify.simulators import identify
from ..play_kernel.fit import PlayKernelSettings, fit_play_kernel, play_kernel_bundle
from ..play_kernel.predictor import PlayKernelPredictor
from ..simulator import ChainModel
from .runs import Rng, TrainingRun

Answer = Callable[[Vec, float], Vec]
"""Free run (T,) [deg] over commands (T,) from a first angle [deg]."""

_CYCLES = 7
_DURATION_S = (12.0, 40.0)
_FREQUENCY_HZ = (0.08, 0.6)  # slightly wider than the tip motions of S1 (RA-L 2021) and S2 (RA-L 2024)
_HOLD_S = (0.1, 10.0)
_SINES = 4
_PAUSE_S = (0.1, 3.0)
_JUMP, _JITTER = 0.15, 0.005  # shares of the command range
_CROSSING = 5


@final
class Teacher:
    """Model of plays fitted to `trials`, simulated over random motions from the start of a trial.

    Attributes:
        rmse_deg: its error on the trials [deg].
        lag_s: time constant of the lag in front of its hysteresis [s]; 0 for a Prandtl-Ishlinskii model, which has
            none, and for an inverse map, whose input is the lag's output.
        answer: its free run (T,) [deg] over commands (T,) from a first angle [deg].

    Raises:
        FitError: as `identify` and `fit_play_kernel` do.
        KeyboardInterrupt: if the user stops the fit.
    """

    def __init__(self, trials: Sequence[Trial], plays: int, model: Literal["pi", "play_kernel"] = "pi") -> None:
        self._inverted = trials[0].inverted
        trials = [trial.swapped() for trial in trials] if self._inverted else trials
        self.rmse_deg, lag_s, self.answer = _operator(trials, plays) if model == "pi" else _play_kernel(trials)
        self.lag_s = 0.0 if self._inverted else lag_s
        self._starts = [(float(t.command[0]), float(t.angle[0])) for t in trials]
        self._range, self._rate, self._dt = command_range(trials), fastest_command(trials), check_trial_set(trials)

    def runs(self, count: int, weight: float, rng: Rng) -> list[TrainingRun]:
        """Random motions in equal parts of each kind, in the units of the trials."""
        return [self._run(_KINDS[k % len(_KINDS)], weight, rng) for k in range(count)]

    def centred(self, trial: Trial) -> Trial:
        """Trial without the mean difference between its angles and the teacher's free run."""
        forward = trial.swapped() if self._inverted else trial
        offset = np.mean(forward.angle - self.answer(forward.command, float(forward.angle[0])))
        moved = replace(forward, angle=forward.angle - offset)
        return moved.swapped() if self._inverted else moved

    def _run(self, kind: Callable[[Range, float, float, Rng], Vec], weight: float, rng: Rng) -> TrainingRun:
        rest, angle = self._starts[rng.integers(len(self._starts))]
        motion = kind(self._range, self._rate, self._dt, rng)
        approach = abs(motion[0] - rest) / (self._rate * self._dt)
        command = np.concatenate([np.linspace(rest, motion[0], 1 + math.ceil(approach), endpoint=False), motion])
        answer, weights = self.answer(command, angle), np.full(command.size, weight)
        return TrainingRun(answer, command, weights) if self._inverted else TrainingRun(command, answer, weights)


def _operator(trials: Sequence[Trial], plays: int) -> tuple[float, float, Answer]:
    """Error on the trials [deg], lag of zero [s], and free run of a Prandtl-Ishlinskii model."""
    simulator, fit = identify("pi", trials, plays=plays)
    if fit.interrupted:
        raise KeyboardInterrupt  # the user wants the training to end, not only this part of it
    return fit.rmse_deg, 0.0, ChainModel(simulator).run


def _play_kernel(trials: Sequence[Trial]) -> tuple[float, float, Answer]:
    """Error on the trials without their offsets [deg], lag [s], and free run of a play-kernel model."""
    settings = PlayKernelSettings()
    fit = fit_play_kernel(trials, settings)
    if fit.interrupted:
        raise KeyboardInterrupt
    facts = play_kernel_bundle(fit, trials, settings, DeviceLimits()).metadata
    predictor, warmup = PlayKernelPredictor(fit.weights, facts), facts.warmup_samples

    def answer(command: Vec, angle: float) -> Vec:
        state = facts.initial.state(np.array([[angle]]), command[None, :1])[0]
        plan = np.concatenate([np.full(warmup, command[0]), command])
        return predictor.rollout(state, plan[None])[0, warmup:]

    return fit.rmse, fit.choice.lag_s, answer


def _decaying_sine(commands: Range, rate: float, dt: float, rng: Rng) -> Vec:
    """Commands of S2 eq. (9)-(10) with random frequency, amplitude, decay and baseline (low, middle, high)."""
    del rate
    frequency = _log_uniform(*_FREQUENCY_HZ, rng)
    t = np.arange(0.0, min(_CYCLES / frequency, _DURATION_S[1]), dt)
    decay = np.exp(-frequency / (_CYCLES - 1) * math.log(_CYCLES) * rng.uniform(0.0, 1.5) * t)
    swing = rng.uniform(0.5, 1.0) * 0.5 * decay
    sine = np.sin(2 * np.pi * frequency * t - np.pi / 2)
    shape = (swing * (sine + 1), 0.5 + swing * sine, 1 + swing * (sine - 1))[rng.integers(3)]
    return commands.lower + (commands.upper - commands.lower) * shape


def _moves_and_holds(commands: Range, rate: float, dt: float, rng: Rng) -> Vec:
    """Commands of S2 eq. (11): moves of constant speed to random targets, and holds."""
    samples = round(rng.uniform(*_DURATION_S) / dt)
    parts, last, total = [], commands.lower, 0
    while total < samples:
        target, speed = rng.uniform(commands.lower, commands.upper), _log_uniform(0.03 * rate, rate, rng)
        move = np.linspace(last, target, 2 + math.ceil(abs(target - last) / (speed * dt)))
        hold = np.full(math.ceil(_log_uniform(*_HOLD_S, rng) / dt), target)
        parts += [move, hold]
        last, total = target, total + move.size + hold.size
    return np.concatenate(parts)[:samples]


def _sum_of_sines(commands: Range, rate: float, dt: float, rng: Rng) -> Vec:
    """Commands with nested and crossing loops of all sizes, not faster than in the trials."""
    t = np.arange(0.0, rng.uniform(*_DURATION_S), dt)
    frequencies = [_log_uniform(0.3 * _FREQUENCY_HZ[0], _FREQUENCY_HZ[1], rng) for _ in range(_SINES)]
    waves = sum(rng.uniform() * np.sin(2 * np.pi * (f * t + rng.uniform())) for f in frequencies)
    unit = (waves - np.min(waves)) / np.ptp(waves)
    fastest = np.max(np.abs(np.diff(unit))) / dt
    swing = min(rng.uniform(0.3, 1.0) * (commands.upper - commands.lower), rate / fastest)
    return rng.uniform(commands.lower, commands.upper - swing) + swing * unit


def _controlled_moves(commands: Range, rate: float, dt: float, rng: Rng) -> Vec:
    """Commands of a controller that compensates hysteresis: minimum-jerk moves, a jump at each reversal, jitter."""
    samples, span = round(rng.uniform(*_DURATION_S) / dt), commands.upper - commands.lower
    jump, jitter = rng.uniform(0.0, _JUMP) * span, rng.uniform(0.0, _JITTER) * span
    crossing = 1 + rng.integers(_CROSSING)
    parts, last, total = [], commands.lower, 0
    while total < samples:
        target, peak = rng.uniform(commands.lower, commands.upper), _log_uniform(0.1 * rate, rate, rng)
        s = np.linspace(0.0, 1.0, 2 + math.ceil(1.875 * abs(target - last) / (peak * dt)))
        hold = np.full(math.ceil(_log_uniform(*_PAUSE_S, rng) / dt), target)
        parts += [last + (target - last) * s**3 * (10 - 15 * s + 6 * s**2), hold]
        last, total = target, total + s.size + hold.size
    smooth = np.concatenate(parts)[:samples]
    moves = np.diff(smooth, prepend=smooth[0])
    moving = np.maximum.accumulate(np.where(moves != 0, np.arange(samples), 0))
    direction = np.convolve(np.sign(moves[moving]), np.full(crossing, 1.0 / crossing))[:samples]
    noise = jitter * rng.standard_normal(samples) * (moves != 0)
    return np.clip(smooth + 0.5 * jump * direction + noise, commands.lower, commands.upper)


_KINDS = (_decaying_sine, _moves_and_holds, _sum_of_sines, _controlled_moves)


def _log_uniform(low: float, high: float, rng: Rng) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
