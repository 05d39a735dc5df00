"""The final trials are whole, never the first, and the same every time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.gap.logs.trial_choice import FINAL_SHARE, split_runs
from hystmpc.models.identify.runs import Run

from .engine_examples import device_runs

RUN = device_runs()[0]
MOTIONS = st.lists(st.sampled_from(["sine", "holds", "ramps", "point_to_point"]), min_size=3, max_size=24)


def runs_named(count: int) -> tuple[Run, ...]:
    """That many trials."""
    return tuple(replace(RUN, name=f"trial_{k}.csv") for k in range(count))


@given(MOTIONS)
def test_a_quarter_of_the_trials_is_kept_whole(motions: list[str]) -> None:
    runs = runs_named(len(motions))
    development, final = split_runs(runs, motions)
    kept, others = [run.name for run in final], [run.name for run in development]
    assert not set(kept) & set(others)
    assert sorted(kept + others) == sorted(run.name for run in runs)
    assert len(kept) == max(round(FINAL_SHARE * len(runs)), 1)
    assert runs[0].name not in kept
    assert all(run.counts.all() for run in (*development, *final))
    order = [run.name for run in runs]
    assert kept == sorted(kept, key=order.index)
    assert others == sorted(others, key=order.index)


@given(MOTIONS)
def test_the_split_is_the_same_every_time(motions: list[str]) -> None:
    runs = runs_named(len(motions))
    first, second = (split_runs(runs, motions) for _ in range(2))
    assert [[r.name for r in part] for part in first] == [[r.name for r in part] for part in second]


@given(st.integers(4, 20))
def test_a_motion_that_occurs_once_is_not_taken_while_others_repeat(count: int) -> None:
    motions = ["sine"] * (count - 1) + ["holds"]
    _, final = split_runs(runs_named(count), motions)
    if len(final) < count - 2:
        assert f"trial_{count - 1}.csv" not in {run.name for run in final}


def test_two_trials_are_each_cut_at_the_end() -> None:
    runs = runs_named(2)
    development, final = split_runs(runs, ["sine", "sine"])
    assert len(development) == len(final) == 2
    for early, late in zip(development, final, strict=True):
        assert not np.any(early.counts & late.counts)
        assert np.all(early.counts | late.counts)
        assert np.flatnonzero(early.counts)[-1] < np.flatnonzero(late.counts)[0]


def test_one_trial_is_judged_by_its_parts() -> None:
    development, final = split_runs(runs_named(1), ["sine"])
    assert len(development) == 2
    assert len(final) == 1
    together = development[0].counts.astype(int) + development[1].counts + final[0].counts
    assert np.all(together == 1)
    assert final[0].counts[-1]
    assert development[0].counts[0]


@given(st.integers(3, 8), st.integers(1, 7))
def test_a_motion_like_no_other_is_chosen_on_and_not_kept_for_the_end(pairs: int, at: int) -> None:
    """Whatever it is called and wherever it stands: each of the others was recorded twice."""
    base = [replace(RUN, command=RUN.command * (0.4 + 0.1 * k), name=f"{k}") for k in range(pairs)]
    odd = replace(RUN, command=RUN.command[::-1] * 0.05 + 2.0, name="odd")
    runs = [*base, *base]
    runs.insert(min(at, len(runs)), odd)
    _, final = split_runs(runs, ["point_to_point"] * len(runs))
    assert "odd" not in {run.name for run in final}
