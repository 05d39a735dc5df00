"""Studies, nothing trained: statistics against hand-computed numbers, printed tables, plans, settings, files."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.models.evaluate import Errors
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc_lab.papers.job import Score, TrainingTask, study_splits
from hystmpc_lab.papers.printed import (
    S1_ERRORS,
    S1_TRAINING,
    S2_ORDER,
    S2_RELATIVE,
    S2_VALIDATION,
    S2_WINDOWS,
    s2_symbol,
)
from hystmpc_lab.papers.s1 import TESTS, relative_change
from hystmpc_lab.papers.s2_tables import s2_tasks
from hystmpc_lab.papers.settings import S1_KINDS, S2_KINDS, PaperSettings
from hystmpc_lab.papers.study import STUDIES
from hystmpc_lab.statistics import compared, holm, least_p, pairwise, signed_rank

from .study_examples import JOB, small_splits, small_trial

PAIRS = [(row, column) for k, row in enumerate(S2_KINDS) for column in S2_KINDS[:k]]


def test_signed_rank_by_hand() -> None:
    """Three smaller errors: one of eight signs. Six with losing ranks 2 or 1 + 2: 3 and 5 of the 64 subsets."""
    assert signed_rank([1, 2, 3], [2, 4, 6]) == (3, 1 / 8, 1.0, 1 / 4)
    column = np.zeros(6)
    assert signed_rank([-1, 2, -3, -4, -5, -6], column)[1] == pytest.approx(3 / 64)
    assert signed_rank([1, 2, -3, -4, -5, -6], column)[1] == pytest.approx(5 / 64)
    assert least_p(6) == 1 / 64


def test_trials_that_do_not_differ_say_nothing() -> None:
    assert signed_rank([1.0, 2.0], [1.0, 2.0]) == (0, 1.0, 1.0, 1.0)
    n, less, greater, both = signed_rank([1, 2, 3, 4], [1, 1, 2, 3])  # three equal differences: no exact ranks
    assert n == 3
    assert less > 0.5 > greater > 0
    assert both == pytest.approx(2 * greater)


@pytest.mark.parametrize("row", [[1.0, math.nan], [1.0], [[1.0, 2.0]]])
def test_errors_that_cannot_be_paired_are_refused(row: list[float]) -> None:
    with pytest.raises(ConfigError, match="signed-rank"):
        signed_rank(row, [1.0, 2.0])


def test_holm_by_hand() -> None:
    """0.005 x 4, 0.01 x 3, 0.03 x 2, and 0.04 x 1 lifted to the one before it."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == pytest.approx([1.0, 1.0])
    assert holm([]).size == 0


@given(st.lists(st.floats(0, 1), min_size=1, max_size=30))
def test_holm_never_helps_and_keeps_the_order(p: list[float]) -> None:
    corrected, order = holm(p), np.argsort(p, kind="stable")
    assert np.all(corrected >= np.array(p))
    assert np.all(corrected <= 1)
    assert np.all(np.diff(corrected[order]) >= 0)
    assert corrected[order[0]] == pytest.approx(min(1.0, len(p) * p[order[0]]))


def test_pairs_are_rows_against_earlier_columns_and_symbols_follow_the_papers_rule() -> None:
    rng = np.random.default_rng(0)
    good, bad = rng.uniform(1, 2, 20), rng.uniform(3, 4, 20)
    tests = pairwise({"bad": bad, "good": good, "same": good + 1e-6 * rng.standard_normal(20)})
    assert [(t.row, t.column) for t in tests] == [("good", "bad"), ("same", "bad"), ("same", "good")]
    assert [t.symbol for t in tests] == ["<", "<", "~"]
    assert [t.symbol_holm for t in tests] == ["<", "<", "~"]
    (other,) = compared({"bad": bad, "good": good}, [("bad", "good")])
    assert other.symbol == ">"
    assert other.p_holm == other.p
    assert other.p_greater == tests[0].p_less


def test_the_papers_tables_are_complete() -> None:
    for direction in ("forward", "inverse"):
        signs = [s2_symbol("p2p", direction, row, column) for row, column in PAIRS]
        assert len(signs) == 28
        assert all(sign is not None and sign.value in ("<", ">", "~") and sign.mark == "P" for sign in signs)
        assert all(s2_symbol("p2p", direction, kind, "fnn").value == "<" for kind in S2_KINDS[1:])  # type: ignore[union-attr]
        for motion in ("sin", "p2p"):
            assert set(S2_VALIDATION[direction, motion]) == set(S2_KINDS)
    ordered = {motion: [kind for group in groups for kind in group] for motion, groups in S2_ORDER.items()}
    assert sorted(ordered["sin"]) == sorted(S2_KINDS)
    assert sorted([*ordered["p2p"], "gru"]) == sorted(S2_KINDS)  # where the GRU stands is not said of these motions
    assert {kind for _, _, kind in S2_RELATIVE} == {"lstm", "hb2", "fnn_hib"}
    assert set(S1_ERRORS) == set(S1_TRAINING) == set(S1_KINDS)
    assert all(set(rows) == set(TESTS) for rows in S1_ERRORS.values())
    assert all(sorted(row) == list(row) and len(row) > 6 for row in S2_WINDOWS.values())


@pytest.mark.parametrize("test", list(TESTS))
def test_the_papers_nrmse_is_its_rmse_over_one_range(test: str) -> None:
    """S1 eq. (9): a typing error in any of the numbers would show. (SVR (a) is off by a rounding.)"""
    ranges = [float(rows[test][0].value) / float(rows[test][2].value) for rows in S1_ERRORS.values()]
    assert np.ptp(ranges) / np.mean(ranges) < 0.025


def test_relative_change_by_hand() -> None:
    """Errors 2, 1 and a rise that the best so far does not follow: losses 4, 1, 1."""
    result = replace(JOB, history=((1, 2.0), (2, 1.0), (3, 5.0)))
    assert relative_change(result) == 0.0
    assert relative_change(replace(JOB, history=((9, 2.0), (10, 1.0)))) == pytest.approx(0.75)
    assert math.isnan(relative_change(replace(JOB, history=((1, 2.0),))))


def tasks_of(**changes: object) -> tuple[TrainingTask, ...]:
    settings = PaperSettings.for_study("s2", **changes)
    return s2_tasks(settings, small_splits())


def test_a_plan_has_every_kind_direction_motion_and_beta_under_keys_of_their_own() -> None:
    tasks = tasks_of(stages=("main", "cross", "window"), kinds=("fnn", "backlash", "lstm"))
    keys = [task.job.key for task in tasks]
    assert len(set(keys)) == len(keys)
    main = [task.job for task in tasks if task.job.stage == "main"]
    assert len(main) == 2 * 2 * (2 + 1 + 2)  # motions, directions, betas of networks and one backlash
    assert {job.constancy for job in main if job.kind == "lstm"} == {0.0, 1e-4}
    assert {job.constancy for job in main if job.kind == "backlash"} == {None}
    mixed = next(task for task in tasks if task.job.train == "mixed")
    assert len(mixed.training) == 2
    assert all(set(task.tests) == {"sin/test", "p2p/test"} for task in tasks)
    assert [task.job.window for task in tasks if task.job.stage == "window"] == list(S2_WINDOWS["lstm"])


def test_the_share_of_epochs_is_for_networks_only() -> None:
    steps = {task.job.kind: task.job.steps for task in tasks_of(epochs_scale=0.25, kinds=("backlash", "lstm"))}
    assert steps == {"backlash": None, "lstm": 25}
    assert all(task.job.steps is None for task in tasks_of(epochs_scale=1.0, kinds=("lstm",)))


def printed(task: TrainingTask) -> str:
    return STUDIES["s2"].fingerprint(task, PaperSettings.for_study("s2"), Path())


def test_a_fingerprint_follows_settings_and_trials() -> None:
    task = tasks_of(kinds=("backlash",))[0]
    assert printed(task) == printed(tasks_of(kinds=("backlash",))[0])
    others = [
        replace(task, job=replace(task.job, seed=2)),
        replace(task, training=(small_trial("other", phase=0.1),)),
        replace(task, tests={}),
        replace(task, validation=()),
    ]
    assert len({printed(task), *(printed(other) for other in others)}) == 5


def test_a_result_reads_back_as_it_was_written(tmp_path: Path) -> None:
    errors = Errors(1.0, -0.5, 0.9, 3.0, math.inf, 0.0)
    score = Score("p2p/test", "a/b", errors, replace(errors, rmse_deg=0.5))
    result = replace(JOB, history=((1, 2.5), (2, 0.1)), scores=(score, replace(score, later=None)))
    STUDIES["s2"].files(tmp_path).save(result)
    assert STUDIES["s2"].files(tmp_path).load(result.job) == result
    assert STUDIES["s2"].files(tmp_path).load(replace(result.job, seed=7)) is None
    assert result.figures("rmse_deg", ["p2p/test"]).tolist() == [1.0, 1.0]


@pytest.mark.parametrize("text", ["", "{}", '{"format": "other"}', "[1]", '{"format": "hystmpc-study-job/1"}'])
def test_a_damaged_result_is_named(tmp_path: Path, text: str) -> None:
    path = STUDIES["s2"].files(tmp_path).path(JOB.job)
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(LogError, match=path.name):
        STUDIES["s2"].files(tmp_path).load(JOB.job)


@pytest.mark.parametrize(
    ("study", "changes", "message"),
    [
        ("s3", {}, "available: real, s1, s2"),
        ("s2", {"kinds": ("fnm",)}, "did you mean 'fnn'"),
        ("s2", {"presets": ("papers",)}, "did you mean 'paper'"),
        ("s2", {"stages": ("mian",)}, "did you mean 'main'"),
        ("s2", {"directions": ("back",)}, "directions"),
        ("s2", {"logs": ("a.csv",)}, "expected none"),
        ("real", {}, "expected at least two with --logs"),
        ("s1", {"seed": -1}, "seed"),
    ],
)
def test_wrong_settings_are_one_line(study: str, changes: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        PaperSettings.for_study(study, **changes)
    assert "\n" not in str(error.value)


def test_one_log_cannot_be_left_out(tmp_path: Path) -> None:
    log = tmp_path / "one.csv"
    t = np.arange(0, 10, 0.02)
    log.write_text("time_s,command,angle_deg\n" + "".join(f"{x:.2f},{np.sin(x)},{np.cos(x)}\n" for x in t))
    with pytest.raises(ConfigError, match="at least two"):
        study_splits(PaperSettings.for_study("real", logs=(str(log),)))
    with pytest.raises(ConfigError, match="given twice"):
        study_splits(PaperSettings.for_study("real", logs=(str(log), str(log))))
