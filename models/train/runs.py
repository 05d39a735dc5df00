"""Training data of networks: held-out trials, scaled runs, windows, and rest before them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.errors import FitError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..identify.runs import angle_range, command_range
from ..networks.nodes import Scaling
from ..networks.settings import NetworkSettings, RestSettings, ScalingSettings, WindowTraining

Float32 = NDArray[np.float32]
Rng = np.random.Generator


@dataclass(frozen=True)
class TrainingRun:
    """Motion for training, from the start of a trial.

    Attributes:
        command, angle: (T,), in units or scaled; exchanged for an inverse map.
        weight: weight of each sample in the loss (T,).
    """

    command: Vec
    angle: Vec
    weight: Vec

    def padded(self, samples: int, command: float, angle: float, weight: float) -> Self:
        """Motion after `samples` of rest."""
        values = ((self.command, command), (self.angle, angle), (self.weight, weight))
        return type(self)(*(np.concatenate([np.full(samples, value), signal]) for signal, value in values))

    def stretched(self, factor: float) -> Self:
        """Motion with `factor` times the speed, interpolated linearly."""
        at, samples = np.arange(0.0, self.command.size - 1, factor), np.arange(self.command.size)
        parts = (np.interp(at, samples, signal) for signal in (self.command, self.angle, self.weight))
        return type(self)(*parts)

    def paused(self, at: int, samples: int) -> Self:
        """Motion with command and angle constant for `samples` after sample `at`, as hysteresis would hold."""
        index = np.concatenate([np.arange(at + 1), np.full(samples, at), np.arange(at + 1, self.command.size)])
        return type(self)(self.command[index], self.angle[index], self.weight[index])


def prepared(trials: Sequence[Trial], scaling: Scaling, settings: NetworkSettings) -> list[TrainingRun]:
    """Scaled runs, with a rest before them where the training requires it."""
    return [_run(trial, scaling, settings) for trial in trials]


def scaling_of(trials: Sequence[Trial], given: ScalingSettings | None) -> Scaling:
    """Given scaling for devices of its unit, else the one that maps the trials' ranges to [-1, 1]."""
    inverted = trials[0].inverted
    if given is not None and _command_unit(trials[0]) == given.unit:
        command, angle = (given.command_offset, given.command_scale), (given.angle_offset, given.angle_scale)
        return Scaling(*angle, *command) if inverted else Scaling(*command, *angle)
    u, theta = command_range(trials), angle_range(trials)
    pairs = [(0.5 * (r.lower + r.upper), 0.5 * (r.upper - r.lower)) for r in (u, theta)]
    # Single precision, as the graph will hold them: what was trained is what is exported.
    return Scaling(*(float(np.float32(number)) for pair in pairs for number in pair))


def rest_of(trials: Sequence[Trial], scaling: Scaling, given: RestSettings | None) -> float:
    """Scaled input of a device at rest: the given one for devices of that unit, else the least input of the trials."""
    if given is not None and _command_unit(trials[0]) == given.unit:
        rest = given.angle if trials[0].inverted else given.command
    else:
        rest = command_range(trials).lower
    return float(scaling.scale_in(np.array(rest)))


def scaled_run(run: TrainingRun, scaling: Scaling) -> TrainingRun:
    """Motion in scaled units."""
    return TrainingRun(scaling.scale_in(run.command), scaling.scale_out(run.angle), run.weight)


def _run(trial: Trial, scaling: Scaling, settings: NetworkSettings) -> TrainingRun:
    weight = np.ones(len(trial))
    if settings.first_flexure_weight != 1.0:
        weight[: first_flexure_end(trial)] = settings.first_flexure_weight
    run = TrainingRun(trial.command, trial.angle, weight)
    if isinstance(settings.training, WindowTraining):
        run = _padded(run, trial, settings, settings.training)
    return scaled_run(run, scaling)


def _padded(run: TrainingRun, trial: Trial, settings: NetworkSettings, scheme: WindowTraining) -> TrainingRun:
    """Run with a rest before it, at least as long as the context of the network."""
    command, angle = float(trial.command[0]), float(trial.angle[0])
    if settings.rest is not None and _command_unit(trial) == settings.rest.unit:
        rest = (settings.rest.command, settings.rest.angle)
        command, angle = rest[::-1] if trial.inverted else rest
    scored = settings.first_flexure_weight if scheme.padding_samples else 0.0
    return run.padded(max(scheme.padding_samples, settings.network.context), command, angle, scored)


def _command_unit(trial: Trial) -> str:
    """Command unit of a device with angles in deg, in a swapped trial as well; empty for any other."""
    command, output = (trial.units.angle, trial.units.command)[:: 1 if trial.inverted else -1]
    return command if output == "deg" else ""


@dataclass(frozen=True)
class Streams:
    """P pieces of L samples in N streams.

    Attributes:
        command, angle, weight: (P, N, L) float32; weight 0 where nothing is to be learned (warm-up, filling). The angle
            of a warm-up is the run's first, from which the state starts.
        fresh: (P, N), whether a run begins with this piece, so that the state is reset.
    """

    command: Float32
    angle: Float32
    weight: Float32
    fresh: NDArray[np.bool_]


def arrange(runs: Sequence[TrainingRun], streams: int, length: int, warmup: int, rng: Rng) -> Streams:
    """Distribute runs over streams of about equal length, each run from the start of a piece.

    A run's first command is held for `warmup` samples before it, its last one to the end of its last piece.
    """
    pieces = [-(-(warmup + run.command.size) // length) for run in runs]
    queues: list[list[int]] = [[] for _ in range(streams)]
    filled = np.zeros(streams, np.int64)
    for k in np.argsort(pieces)[::-1].tolist():  # longest first, each to the emptiest stream
        shortest = int(np.argmin(filled))
        queues[shortest].append(k)
        filled[shortest] += pieces[k]
    shape = (streams, int(filled.max()) * length)
    command, angle, weight = (np.zeros(shape, np.float32) for _ in range(3))
    fresh = np.zeros((streams, shape[1] // length), bool)
    for n, queue in enumerate(queues):
        at = 0
        for k in rng.permutation(queue).tolist():
            run, first, end = runs[k], at + warmup, at + pieces[k] * length
            fresh[n, at // length] = True
            last = first + run.command.size
            command[n, at:first], command[n, first:last], command[n, last:end] = (
                run.command[0],
                run.command,
                run.command[-1],
            )
            angle[n, at:first], angle[n, first:last], weight[n, first:last] = run.angle[0], run.angle, run.weight
            at = end
    cut = [np.ascontiguousarray(a.reshape(streams, -1, length).swapaxes(0, 1)) for a in (command, angle, weight)]
    return Streams(cut[0], cut[1], cut[2], fresh.T)


def stretch(runs: Sequence[TrainingRun], share: float, rng: Rng) -> list[TrainingRun]:
    """Runs with a random speed each, up to `1 + share` times faster or slower."""
    reach = np.log1p(share)
    return [run.stretched(float(np.exp(rng.uniform(-reach, reach)))) for run in runs]


def pause(runs: Sequence[TrainingRun], longest: int, rng: Rng) -> list[TrainingRun]:
    """Runs with a pause each of up to `longest` samples after a random sample."""
    return [run.paused(int(rng.integers(run.command.size)), int(rng.integers(longest + 1))) for run in runs]


FEW_TRIALS = 8


def hold_out(trials: Sequence[Trial], count: int, seed: int) -> tuple[list[Trial], list[Trial]]:
    """Training and held-out trials, both in the order given.

    Of fewer than eight trials the most ordinary ones are held out, so that the extreme motions (slowest, fastest,
    lowest, highest) remain in training. From eight on the draw is random by `seed`.

    Raises:
        FitError: if no trial would be left for training.
    """
    if count >= len(trials):
        raise FitError(f"got {len(trials)} trials, expected at least {count + 1}: {count} held out and one to train on")
    if len(trials) < FEW_TRIALS:
        chosen = set(np.argsort(_distance_from_median(trials), kind="stable")[:count].tolist())
    else:
        chosen = set(np.random.default_rng(seed).permutation(len(trials))[:count].tolist())
    return [t for k, t in enumerate(trials) if k not in chosen], [t for k, t in enumerate(trials) if k in chosen]


def _distance_from_median(trials: Sequence[Trial]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Distance of each trial from the median one in mean command, spread of the command and logarithm of its speed."""
    features = np.array(
        [[t.command.mean(), t.command.std(), np.log(np.mean(np.abs(np.diff(t.command))) / t.dt)] for t in trials]
    )
    spread = features.std(axis=0)
    return np.linalg.norm((features - np.median(features, axis=0)) / np.where(spread > 0, spread, 1.0), axis=1)


def draw_windows(runs: Sequence[tuple[Vec, ...]], count: int, length: int, rng: Rng) -> tuple[Float32, ...]:
    """Random windows (count, length) of random runs, one array for each signal (T,); uniform, as in the code of S2.

    Raises:
        FitError: if a run is shorter than a window.
    """
    shortest = min(run[0].size for run in runs)
    if shortest < length:
        raise FitError(f"shortest trial has {shortest} samples, expected at least the {length} of a window")
    chosen = [runs[k] for k in rng.integers(len(runs), size=count)]
    starts = [int(rng.integers(run[0].size - length + 1)) for run in chosen]
    return tuple(
        np.stack([run[j][a : a + length] for run, a in zip(chosen, starts, strict=True)]).astype(np.float32)
        for j in range(len(runs[0]))
    )
