"""Which trials a cause is looked for on, and which are opened once, at the end."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .recording import Run

FINAL_SHARE = 0.25
_LEAST_TRIALS = 3
_PART_FINAL = 0.35


def split_runs(runs: Sequence[Run], motions: Sequence[str]) -> tuple[tuple[Run, ...], tuple[Run, ...]]:
    """Development and final runs, by whole trials.

    A quarter of the trials is kept for the end, of motions that the development runs have too where that is possible,
    the latest first. With one or two trials the last third of each is kept, run from its beginning but scored alone; a
    single trial's other two thirds are judged against each other.

    Args:
        runs: in recording order.
        motions: motion type of each.
    """
    if len(runs) < _LEAST_TRIALS:
        return _cut(runs)
    count = max(round(FINAL_SHARE * len(runs)), 1)
    chosen: list[int] = []
    left = list(range(len(runs)))
    while len(chosen) < count:
        # Of the most frequent motion among those that remain, the latest trial; the first of all is never taken.
        often = max(left[1:], key=lambda k: (sum(motions[j] == motions[k] for j in left), k))
        chosen.append(often)
        left.remove(often)
    return tuple(runs[k] for k in left), tuple(runs[k] for k in sorted(chosen))


def _cut(runs: Sequence[Run]) -> tuple[tuple[Run, ...], tuple[Run, ...]]:
    development, final = [], []
    for run in runs:
        samples = np.arange(run.command.size)
        edge = round((1 - _PART_FINAL) * samples.size)
        final.append(replace(run, counts=samples >= edge))
        edges = [0, edge // 2, edge] if len(runs) == 1 else [0, edge]
        development += [replace(run, counts=(samples >= a) & (samples < b)) for a, b in itertools.pairwise(edges)]
    return tuple(development), tuple(final)
