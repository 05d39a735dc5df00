"""What a diagnosis costs, and which trials it uses where all of them would cost too much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .motion_type import MotionType
from .split import characters

Index = NDArray[np.int_]

MOST_SAMPLES = 300_000
"""Samples of all trials together that are diagnosed; 20 trials of 600 s at 25 Hz."""

# Measured with `benchmarks/diagnosis_time.py --trials 20 --seconds 600`: two effects, 102 s of one core, 0.53 GB.
_SECONDS, _START_S = 0.33e-3, 5.0
_BYTES, _START_BYTES = 0.6e3, 0.35e9
_SOON_S = 30.0  # what takes no longer is not announced
_MOST_TRIALS = 200  # repeats are looked for in all pairs of trials
_LEAST_TRIALS = 12  # trials are cut before fewer than these are used
_REPEAT = 0.005  # distance of `characters`: the same motion again


@dataclass(frozen=True)
class Workload:
    """Trials that are used, and what is said about them.

    Attributes:
        kept: numbers of the trials, in recording order.
        samples: of each that are used, from its first one on.
        seconds, gigabytes: estimate of the whole diagnosis.
        note: one line on what is left out; empty where nothing is.
        estimate: one line on what it will cost; empty where it is soon done.
    """

    kept: tuple[int, ...]
    samples: tuple[int, ...]
    seconds: float
    gigabytes: float
    note: str
    estimate: str


def affordable(
    trials: Sequence[Trial], motions: Sequence[MotionType], seed: int = 0, most: int = MOST_SAMPLES
) -> Workload:
    """Choose trials that together have no more samples than can be afforded; all of them where that suffices.

    First and last trial, one of every kind of motion and, of every kind, the two trials most alike come first; then
    the kinds in turn, in an order that the seed draws. Where fewer than twelve trials would be used, long ones are cut
    to their first part instead: what is before the end of a trial is a trial, what is after its start is not, since
    the state of a hysteresis there is not known.

    Args:
        trials: uniform, at one rate, in recording order.
        motions: kind of motion of each.
        seed: of the order.
        most: samples in all.
    """
    sizes = np.array([len(trial) for trial in trials])
    kept, samples = list(range(len(trials))), sizes
    if sizes.sum() > most or len(trials) > _MOST_TRIALS:
        order, needed = _order(trials, motions, seed)
        level = _level(sizes[order[: max(needed, min(_LEAST_TRIALS, len(order)))]], most)
        samples = np.minimum(sizes, level)
        fitting = int(np.searchsorted(np.cumsum(samples[order]), most, side="right"))
        kept = sorted(order[: min(fitting, _MOST_TRIALS)])
    used_samples = samples[kept]
    what = f"{len(trials)} trials, {int(sizes.sum()):,} samples at {1 / trials[0].dt:.4g} Hz"
    taken = int(used_samples.sum())
    note = _left_out(what, used_samples, sizes[kept], trials[0].dt, most, seed) if taken < sizes.sum() else ""
    seconds, size = _START_S + _SECONDS * taken, (_START_BYTES + _BYTES * taken) / 1e9
    cost = f"{what}: about {_time(seconds)} and {size:.1f} GB, longer where more effects are found"
    return Workload(tuple(kept), tuple(used_samples.tolist()), seconds, size, note, cost if seconds > _SOON_S else "")


def _left_out(what: str, used: Index, recorded: Index, dt: float, most: int, seed: int) -> str:
    """What is not used, in one line."""
    cut = used < recorded
    text = (
        f"{what}, more than are diagnosed in minutes ({most:,} samples of {_MOST_TRIALS} trials): {used.size} trials "
        f"with {int(used.sum()):,} samples are used, among them the first, the last, every kind of motion and repeats "
        f"(drawn by seed {seed})"
    )
    if cut.any():
        text += f"; of {int(cut.sum())} long ones the first {int(used[cut].max()) * dt:.0f} s"
    return text + "."


def _order(trials: Sequence[Trial], motions: Sequence[MotionType], seed: int) -> tuple[list[int], int]:
    """Numbers of all trials, those that are needed most first, and how many are needed."""
    found = characters([trial.command for trial in trials], trials[0].dt)
    kinds = [np.flatnonzero(np.array(motions) == kind) for kind in dict.fromkeys(motions)]
    needed = dict.fromkeys([0, len(trials) - 1])
    for own in kinds:
        pair = _most_alike(found[own])
        if pair or not set(own.tolist()) & set(needed):
            needed |= dict.fromkeys(own[list(pair or (0,))].tolist())
    random = np.random.default_rng(seed)
    queues = [random.permutation([k for k in own.tolist() if k not in needed]).tolist() for own in kinds]
    rest = [queue[turn] for turn in range(max(map(len, queues))) for queue in queues if turn < len(queue)]
    return [*needed, *rest], len(needed)


def _most_alike(found: Vec) -> tuple[int, int] | None:
    """Numbers of the two motions that are most alike; None where no motion repeats another."""
    if len(found) < 2:
        return None
    distance, other = (np.asarray(part) for part in KDTree(found).query(found, k=2))
    first = int(np.argmin(distance[:, 1]))
    second = int(other[first, int(other[first, 1] != first)])  # of equal ones a motion may come after its repeat
    return (first, second) if distance[first, 1] < _REPEAT else None


def _level(sizes: Index, most: int) -> int:
    """Greatest length to which trials can be cut so that together they have no more than `most` samples."""
    ascending = np.sort(sizes)
    left = most
    for k, size in enumerate(ascending.tolist()):
        share = left // (len(ascending) - k)
        if size > share:
            return share
        left -= size
    return int(ascending[-1])


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
