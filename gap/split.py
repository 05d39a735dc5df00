"""Which trials a cause is looked for on, and which are opened once, at the end."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hystmpc.models.identify.runs import Run
from hystmpc.trials.types import Vec

FINAL_SHARE = 0.25
_LEAST_TRIALS = 3
_PART_FINAL = 0.35
_SPEEDS = (0.25, 0.5, 0.75, 0.9, 0.99)
_STILL = 1e-3  # strokes per second
_LENGTH = 0.3
_DIGITS = 2  # of a distance: repeats by hand are never quite equal


def split_runs(runs: Sequence[Run], motions: Sequence[str]) -> tuple[tuple[Run, ...], tuple[Run, ...]]:
    """Development and final runs, by whole trials.

    A quarter of the trials is kept for the end, of motions that the development runs have too where that is possible:
    first a motion's repeat, then what is most like another, the latest among equals. A motion that is like no other,
    such as one recorded because a diagnosis asked for it, stays with the development runs. With one or two trials the
    last third of each is kept, run from its beginning but scored alone; a single trial's other two thirds are judged
    against each other.

    Args:
        runs: in recording order.
        motions: motion type of each.
    """
    if len(runs) < _LEAST_TRIALS:
        return _cut(runs)
    count = max(round(FINAL_SHARE * len(runs)), 1)
    chosen: list[int] = []
    left = list(range(len(runs)))
    found = characters([run.command for run in runs], runs[0].dt_s)
    apart = np.linalg.norm(found[:, None] - found[None], axis=-1)
    while len(chosen) < count:
        # Of the most frequent motion among those that remain, what is most like another; the first is never taken.
        often = max(
            left[1:],
            key=lambda k: (
                sum(motions[j] == motions[k] for j in left),
                -round(min(float(apart[k, j]) for j in left if j != k), _DIGITS),
                k,
            ),
        )
        chosen.append(often)
        left.remove(often)
    return tuple(runs[k] for k in left), tuple(runs[k] for k in sorted(chosen))


def characters(commands: Sequence[Vec], dt_s: float) -> Vec:
    """Levels, speeds, rests and length of K commands (K, 10); near to each other where one repeats another.

    Args:
        commands: (T,) each [cmd].
        dt_s: sample time [s].
    """
    low, high = min(float(u.min()) for u in commands), max(float(u.max()) for u in commands)
    return np.array([_character(u, dt_s, max(high - low, 1e-12)) for u in commands])


def _character(command: Vec, dt_s: float, span: float) -> Vec:
    speed = np.abs(np.diff(command)) / (dt_s * span)
    levels = np.array([command.min(), command.mean(), command.max()]) / span
    quantiles = np.log1p(np.quantile(speed, _SPEEDS))
    still, length = float(np.mean(speed < _STILL)), _LENGTH * float(np.log(command.size * dt_s))
    return np.concatenate([levels, quantiles, [still, length]]).astype(np.float64)


def _cut(runs: Sequence[Run]) -> tuple[tuple[Run, ...], tuple[Run, ...]]:
    development, final = [], []
    for run in runs:
        samples = np.arange(run.command.size)
        edge = round((1 - _PART_FINAL) * samples.size)
        final.append(replace(run, counts=samples >= edge))
        edges = [0, edge // 2, edge] if len(runs) == 1 else [0, edge]
        development += [replace(run, counts=(samples >= a) & (samples < b)) for a, b in itertools.pairwise(edges)]
    return tuple(development), tuple(final)
