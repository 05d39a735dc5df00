"""Whole trials laid side by side for truncated backpropagation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.types import Vec

Float32 = NDArray[np.float32]
Rng = np.random.Generator


@dataclass(frozen=True)
class Run:
    """One motion to learn from, from the start of a trial.

    Attributes:
        command, angle: (T,), in units or scaled; exchanged for an inverse map.
        weight: weight of each sample in the loss (T,).
    """

    command: Vec
    angle: Vec
    weight: Vec

    def padded(self, samples: int, command: float, angle: float, weight: float) -> Self:
        """The same motion after `samples` of rest."""
        values = ((self.command, command), (self.angle, angle), (self.weight, weight))
        return type(self)(*(np.concatenate([np.full(samples, value), signal]) for signal, value in values))

    def stretched(self, factor: float) -> Self:
        """The same motion `factor` times as fast, interpolated linearly."""
        at, own = np.arange(0.0, self.command.size - 1, factor), np.arange(self.command.size)
        parts = (np.interp(at, own, signal) for signal in (self.command, self.angle, self.weight))
        return type(self)(*parts)

    def paused(self, at: int, samples: int) -> Self:
        """The same motion with command and angle held for `samples` after sample `at`, as hysteresis would hold."""
        index = np.concatenate([np.arange(at + 1), np.full(samples, at), np.arange(at + 1, self.command.size)])
        return type(self)(self.command[index], self.angle[index], self.weight[index])


@dataclass(frozen=True)
class Streams:
    """P pieces of L samples in N streams.

    Attributes:
        command, angle, weight: (P, N, L) float32; weight 0 where nothing is to be learned (warm-up, filling). The
            angle of a warm-up is the run's first, from which the state starts.
        fresh: (P, N), whether a run begins with this piece, so that the state goes back to the start.
    """

    command: Float32
    angle: Float32
    weight: Float32
    fresh: NDArray[np.bool_]


def stretch(runs: Sequence[Run], share: float, rng: Rng) -> list[Run]:
    """Each run at a speed of its own, up to `1 + share` times faster or slower."""
    reach = np.log1p(share)
    return [run.stretched(float(np.exp(rng.uniform(-reach, reach)))) for run in runs]


def pause(runs: Sequence[Run], longest: int, rng: Rng) -> list[Run]:
    """Each run with a pause of up to `longest` samples after a random one of its samples."""
    return [run.paused(int(rng.integers(run.command.size)), int(rng.integers(longest + 1))) for run in runs]


def arrange(runs: Sequence[Run], streams: int, length: int, warmup: int, rng: Rng) -> Streams:
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
