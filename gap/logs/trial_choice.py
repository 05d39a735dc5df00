"""Recording order, choice of trials within the computing budget, and their split into development and final runs."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.identify.runs import Before, Run, fingerprint
from hystmpc.trials.command_noise import remove_command_noise
from hystmpc.trials.errors import GapError
from hystmpc.trials.recording import by_clock, by_manifest
from hystmpc.trials.trial import Trial, parts_at_gaps, resample
from hystmpc.trials.types import Index, Vec

from ..diagnosis import Order
from .motion_type import MotionType, command_segments, motion_type

SET_ACROSS_TRIALS = "set_across_trials"
NEEDS_ORDER: Mapping[str, str] = {
    "drift": "A drift goes on from trial to trial, and the order of recording is unknown; it may pass for a trial "
    "shift.",
    SET_ACROSS_TRIALS: "A set that the first trials leave in all later ones needs the order of recording, which is "
    "unknown; a first flexure that comes in every trial anew is looked for.",
}
"""Effects that cannot be tested without the recording order, with the reason in one sentence each."""


def in_recording_order(trials: Sequence[Trial], ordered: bool) -> tuple[list[Trial], Order]:
    """Sort the trials by the order of recording, or by their content if that order is unknown.

    Time stamps have precedence, then the caller's statement, then a manifest. A single trial has its order. The order
    by range of commands, length and content makes every later choice (folds, final trials, seeds) independent of the
    order of the files.

    Raises:
        GapError: if time stamps or manifest contradict the caller's statement.
        ConfigError: if a manifest cannot be used.
    """
    if len(trials) < 2:
        return list(trials), "known"
    places = by_clock(trials) or by_manifest([trial.source for trial in trials])
    if ordered and places is not None and places != sorted(places):
        k = next(k for k, place in enumerate(places) if k != place)
        first, given = (Path(trials[j].source).name for j in (places[k], k))
        raise GapError(
            f"--ordered: got {given} as trial {k + 1}, expected {first}, which was recorded before it by time stamps "
            "or manifest; give the files in that order, or leave --ordered out"
        )
    if places is not None:
        return [trials[k] for k in places], "known"
    if ordered:
        return list(trials), "known"

    def content(trial: Trial) -> tuple[float, float, str, str]:  # similar motions go to different folds
        return float(np.ptp(trial.command)), trial.duration_s, fingerprint([trial]), trial.source

    return sorted(trials, key=content), "unknown"


FINAL_SHARE = 0.25
_LEAST_TRIALS = 3
_PART_FINAL = 0.35
_SPEEDS = (0.25, 0.5, 0.75, 0.9, 0.99)
_STILL = 1e-3  # strokes per second
_LENGTH = 0.3
_DIGITS = 2  # digits of a distance: manual repeats are never exactly equal


MOST_SAMPLES = 300_000
"""Greatest number of samples in a diagnosis; 20 trials of 600 s at 25 Hz."""

# Measured with `lab/benchmarks/diagnosis_time.py --trials 20 --seconds 600`: two effects, 69 s of a shared core.
_SECONDS, _START_S = 0.22e-3, 5.0
_BYTES, _START_BYTES = 0.6e3, 0.35e9
_SOON_S = 30.0  # a shorter diagnosis is not announced
_MOST_TRIALS = 200  # repeats are searched in all pairs of trials
_LEAST_UNCUT_TRIALS = 12  # trials are cut before fewer than these are used
_REPEAT = 0.005  # distance of `motion_features` of a repeated motion

MOST_HZ = 50.0
"""Greatest rate of a diagnosis: tip motions end at a few Hz, and time grows with the rate."""

LEAST_HZ = 10.0
"""Least rate of a diagnosis: below it the rate of the logs is used, since fast effects would be invisible."""

LEAST_S = 2.0
"""Shortest trial [s]."""

_NEAR_RATE = 1.5


@dataclass(frozen=True)
class Workload:
    """Selection of trials and the cost of their diagnosis.

    Attributes:
        kept: numbers of the trials, in recording order.
        samples: number of first samples of each that are used.
        estimate: the cost in one line; empty below 30 s.
    """

    kept: tuple[int, ...]
    samples: tuple[int, ...]
    note: str
    estimate: str


@dataclass(frozen=True, eq=False)
class ChosenTrials:
    """Selected trials at one rate.

    Attributes:
        trials: uniform, all at one rate, in recording order.
        given: the same as recorded, cut at gaps, without the noise of a measured command.
        before: history of the device before each, omitted trials included.
    """

    trials: tuple[Trial, ...]
    given: tuple[Trial, ...]
    before: tuple[Before, ...]
    dt: float
    workload: Workload

    def only(self, kept: Sequence[bool]) -> ChosenTrials:
        """Subset of the trials."""
        return replace(
            self,
            trials=tuple(itertools.compress(self.trials, kept)),
            given=tuple(itertools.compress(self.given, kept)),
            before=tuple(itertools.compress(self.before, kept)),
        )


def choose_trials(
    trials: Sequence[Trial], facts: ModelMetadata, fixed: bool, seed: int, ordered: bool = True
) -> ChosenTrials:
    """Choose trials within the computing budget and resample them to one rate.

    Args:
        fixed: whether the simulator is valid only at its nominal rate.
        ordered: whether the trials are in recording order; if not, each has no history.
    """
    parts = remove_command_noise([part for trial in trials for part in _parts(trial)])
    rate = 1.0 / facts.dt_s
    slowest = min(MOST_HZ, *(1.0 / part.dt for part in parts))
    if not fixed and not LEAST_HZ <= rate <= min(_NEAR_RATE * slowest, MOST_HZ):
        rate = slowest
    uniform = [resample(part, rate) for part in parts]
    before = Before.each(uniform) if ordered else (Before(),) * len(uniform)
    motions: list[MotionType] = [motion_type(trial, command_segments(trial)) for trial in uniform]
    workload = affordable(uniform, motions, seed, ordered=ordered)
    kept = list(zip(workload.kept, workload.samples, strict=True))
    return ChosenTrials(
        tuple(_beginning(uniform[k], uniform[k].t[count - 1]) for k, count in kept),
        tuple(_beginning(parts[k], uniform[k].t[count - 1]) for k, count in kept),
        tuple(before[k] for k, _ in kept),
        1.0 / rate,
        workload,
    )


def _beginning(trial: Trial, end_s: float) -> Trial:
    stop = int(np.searchsorted(trial.t, end_s, side="right"))
    return trial if trial.t[-1] - end_s <= 1.5 * trial.dt else trial.select(0, stop)


def _parts(trial: Trial) -> tuple[Trial, ...]:
    parts = parts_at_gaps(trial)
    for part in parts:
        if part.duration_s < LEAST_S:
            raise GapError(f"{trial.source}: gaps leave no part of {LEAST_S:g} s or more")
    return parts


def affordable(
    trials: Sequence[Trial],
    motions: Sequence[MotionType],
    seed: int = 0,
    most: int = MOST_SAMPLES,
    ordered: bool = True,
) -> Workload:
    """Choose trials that together have at most `most` samples; all of them if possible.

    First and last trial (if their order is known), one of every kind of motion and, of every kind, the two most similar
    trials come first; then the kinds in turn, in an order drawn from the seed. If fewer than twelve trials would be
    used, long ones are cut to their first part instead, since the state of the hysteresis is known only at the start of
    a trial.
    """
    sizes = np.array([len(trial) for trial in trials])
    kept, samples = list(range(len(trials))), sizes
    if sizes.sum() > most or len(trials) > _MOST_TRIALS:
        order, needed = _order(trials, motions, seed, ordered)
        level = _length_limit(sizes[order[: max(needed, min(_LEAST_UNCUT_TRIALS, len(order)))]], most)
        samples = np.minimum(sizes, level)
        fitting = int(np.searchsorted(np.cumsum(samples[order]), most, side="right"))
        kept = sorted(order[: min(fitting, _MOST_TRIALS)])
    used_samples = samples[kept]
    what = f"{len(trials)} trials, {int(sizes.sum()):,} samples at {1 / trials[0].dt:.4g} Hz"
    taken = int(used_samples.sum())
    note = _left_out(what, used_samples, sizes[kept], trials[0].dt, most, seed, ordered) if taken < sizes.sum() else ""
    seconds, size = _START_S + _SECONDS * taken, (_START_BYTES + _BYTES * taken) / 1e9
    time = f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
    cost = f"{what}: about {time} and {size:.1f} GB, longer where more effects are found"
    return Workload(tuple(kept), tuple(used_samples.tolist()), note, cost if seconds > _SOON_S else "")


def _left_out(what: str, used: Index, recorded: Index, dt: float, most: int, seed: int, ordered: bool) -> str:
    cut, ends = used < recorded, "the first, the last, " if ordered else ""
    text = (
        f"{what}, more than are diagnosed in minutes ({most:,} samples of {_MOST_TRIALS} trials): {used.size} trials "
        f"with {int(used.sum()):,} samples are used, among them {ends}every kind of motion and repeats "
        f"(drawn by seed {seed})"
    )
    if cut.any():
        text += f"; of {int(cut.sum())} long ones the first {int(used[cut].max()) * dt:.0f} s"
    return text + "."


def _order(trials: Sequence[Trial], motions: Sequence[MotionType], seed: int, ordered: bool) -> tuple[list[int], int]:
    """Numbers of all trials by priority, and the number of necessary ones."""
    features = motion_features([trial.command for trial in trials], trials[0].dt)
    kinds = [np.flatnonzero(np.array(motions) == kind) for kind in dict.fromkeys(motions)]
    needed = dict.fromkeys([0, len(trials) - 1] if ordered else [])
    for members in kinds:
        pair = _most_alike(features[members])
        if pair or not set(members.tolist()) & set(needed):
            needed |= dict.fromkeys(members[list(pair or (0,))].tolist())
    random = np.random.default_rng(seed)
    queues = [random.permutation([k for k in members.tolist() if k not in needed]).tolist() for members in kinds]
    rest = [queue[turn] for turn in range(max(map(len, queues))) for queue in queues if turn < len(queue)]
    return [*needed, *rest], len(needed)


def _most_alike(features: Vec) -> tuple[int, int] | None:
    """Numbers of the two most similar motions; None if no motion repeats another."""
    if len(features) < 2:
        return None
    distance, other = (np.asarray(part) for part in KDTree(features).query(features, k=2))
    first = int(np.argmin(distance[:, 1]))
    second = int(other[first, int(other[first, 1] != first)])  # of equal ones a motion may come after its repeat
    return (first, second) if distance[first, 1] < _REPEAT else None


def _length_limit(sizes: Index, most: int) -> int:
    ascending = np.sort(sizes)
    left = most
    for k, size in enumerate(ascending.tolist()):
        share = left // (len(ascending) - k)
        if size > share:
            return share
        left -= size
    return int(ascending[-1])


def split_runs(
    runs: Sequence[Run], motions: Sequence[str], ordered: bool = True
) -> tuple[tuple[Run, ...], tuple[Run, ...]]:
    """Split whole trials into development and final runs.

    A quarter of the trials is final: first repeats of a motion, then motions most like another, the latest among
    equals. A unique motion stays a development run. Of one or two trials the last third of the counted samples is
    final: it is simulated from the beginning of the trial and scored alone. The other two thirds of a single trial are
    two folds.

    Args:
        ordered: whether they are in recording order; the first one then is never final.
    """
    if len(runs) < _LEAST_TRIALS:
        return _split_in_time(runs)
    features = motion_features([run.command for run in runs], runs[0].dt_s)
    chosen = most_repeated(features, motions, ordered)
    left = [k for k in range(len(runs)) if k not in chosen]
    return tuple(runs[k] for k in left), tuple(runs[k] for k in chosen)


def most_repeated(features: Vec, motions: Sequence[str], ordered: bool = True) -> list[int]:
    """Numbers of a quarter of K trials, those most like another: first repeats, of the most frequent motions.

    Args:
        features: of the trials (K, F), see `motion_features`.
        motions: kind of motion of each.
        ordered: whether they are in recording order; if so, the first one is not chosen.
    """
    count, chosen, left = max(round(FINAL_SHARE * len(features)), 1), list[int](), list(range(len(features)))
    apart = np.linalg.norm(features[:, None] - features[None], axis=-1)
    while len(chosen) < count:
        # The trial most similar to another, of the most frequent remaining motion.
        often = max(
            left[1:] if ordered else left,
            key=lambda k: (
                sum(motions[j] == motions[k] for j in left),
                -round(min(float(apart[k, j]) for j in left if j != k), _DIGITS),
                k,
            ),
        )
        chosen.append(often)
        left.remove(often)
    return sorted(chosen)


def _split_in_time(runs: Sequence[Run]) -> tuple[tuple[Run, ...], tuple[Run, ...]]:
    development, final = [], []
    for run in runs:
        samples, start = np.arange(run.command.size), int(np.argmax(run.counts))
        edge = start + round((1 - _PART_FINAL) * (samples.size - start))
        final.append(replace(run, counts=samples >= edge))
        edges = [start, (start + edge) // 2, edge] if len(runs) == 1 else [start, edge]
        development += [replace(run, counts=(samples >= a) & (samples < b)) for a, b in itertools.pairwise(edges)]
    return tuple(development), tuple(final)


def motion_features(commands: Sequence[Vec], dt_s: float) -> Vec:
    """Levels, speeds, rests and length of K commands (K, 10), with similar values for similar motions."""
    low, high = min(float(u.min()) for u in commands), max(float(u.max()) for u in commands)
    return np.array([_features(u, dt_s, max(high - low, 1e-12)) for u in commands])


def _features(command: Vec, dt_s: float, span: float) -> Vec:
    speed = np.abs(np.diff(command)) / (dt_s * span)
    levels = np.array([command.min(), command.mean(), command.max()]) / span
    quantiles = np.log1p(np.quantile(speed, _SPEEDS))
    still, length = float(np.mean(speed < _STILL)), _LENGTH * float(np.log(command.size * dt_s))
    return np.concatenate([levels, quantiles, [still, length]]).astype(np.float64)
