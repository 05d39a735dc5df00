"""The benchmark measures what it says: same problems, same answers, every row, on any machine."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.ctrl.linearised.qp import OsqpOptions, OsqpSolver
from hystmpc.ctrl.mpc_settings import WeightsSettings
from hystmpc.models.model import Predictor
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Progress
from hystmpc_lab.performance import controllers, run, subjects
from hystmpc_lab.performance.controllers import (
    active_set,
    linearised_controller,
    program_rows,
    recorded_programs,
    sampling_rows,
)
from hystmpc_lab.performance.kernels import jacobian_flops, products, rollout_flops, step_flops
from hystmpc_lab.performance.peers_ import METHODS, SQP, Method, SingleShooting, TorchMppi, pytorch_mppi_installed
from hystmpc_lab.performance.report import COLUMNS, FORMAT, BenchReport, Comparison, Reads, report_json, table_rows
from hystmpc_lab.performance.run import run_bench
from hystmpc_lab.performance.subjects import (
    QUICK,
    WEIGHTS,
    BenchSettings,
    Clock,
    Effort,
    Instant,
    Subject,
    TimedCall,
    Times,
    in_turn,
    lstm_subject,
    operator_subjects,
    record_scan,
)

pytestmark = pytest.mark.slow

TINY = Effort(rounds=2, burst_s=1e-3, burst_most=2)
SMALL = BenchSettings(hidden=8, horizon=6, samples=16, effort=TINY)
SECTIONS = {
    "LSTM, kernels, one thread": 2,
    "LSTM, kernels, 2 threads": 1,
    "LSTM, linearised MPC, one thread": 1 + len(METHODS),
    "LSTM, sampling MPC, 1 thread": 2,
    "LSTM, sampling MPC, 2 threads": 2,
    "LSTM, QP alone H={h}": 1,
    "backlash, linearised MPC, one thread": 1 + len(METHODS),
    "PI, linearised MPC, one thread": 1 + len(METHODS),
}


@pytest.fixture(scope="module")
def lstm() -> Subject:
    return lstm_subject(SMALL.hidden)


@pytest.fixture(scope="module")
def instants(lstm: Subject) -> list[Instant]:
    return record_scan(linearised_controller(lstm, SMALL), lstm)


def check_complete(content: dict[str, Any], settings: BenchSettings) -> None:
    """Every section with every row, ratios finite and positive wherever the peer is installed."""
    assert content["format"] == FORMAT
    assert not content["interrupted"]
    counts: dict[str, int] = {}
    for row in content["rows"]:
        counts[row["section"]] = counts.get(row["section"], 0) + 1
        assert row["state"] == ("measured" if installed(row["other"]["name"]) else "not installed")
        if row["state"] == "measured":
            assert row["ratio"] > 0
            assert math.isfinite(row["ratio"])
        assert row["ours"]["p99_s"] >= row["ours"]["median_s"] >= row["ours"]["least_s"] > 0
    assert counts == {name.format(h=settings.horizon): count for name, count in SECTIONS.items()}


def installed(peer: str) -> bool:
    return not peer.startswith("pytorch-mppi") or pytorch_mppi_installed()


@dataclass(frozen=True, eq=False)
class Ran:
    """What the quick verb left, and what it was told of its progress."""

    folder: Path
    content: dict[str, Any]
    report: BenchReport
    told: list[tuple[float, float, str]]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    """The quick verb once, on a network so small that it takes seconds."""
    from hystmpc_lab.verbs.bench import bench

    folder, told, reports = tmp_path_factory.mktemp("bench"), list[tuple[float, float, str]](), list[BenchReport]()

    def told_too(settings: BenchSettings, progress: Progress) -> BenchReport:
        def tell(done: float, total: float, note: str = "") -> None:
            told.append((done, total, note))
            progress(done, total, note)

        reports.append(run_bench(settings, tell))
        return reports[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subjects, "QUICK", SMALL)
        patch.setattr(run, "run_bench", told_too)
        bench(folder / "out", folder / "bench.json", quick=True)
    content = json.loads((folder / "bench.json").read_text(encoding="utf-8"))
    return Ran(folder, content, reports[0], told)


def test_a_run_has_every_row(ran: Ran) -> None:
    content = json.loads(json.dumps(report_json(ran.report), allow_nan=False))
    check_complete(content, SMALL)
    assert set(content["models"]) == {"LSTM", "backlash", "PI"}
    assert [done for done, _, _ in ran.told] == sorted(done for done, _, _ in ran.told)
    assert ran.told[-1][0] == ran.told[-1][1] >= TINY.rounds * len(SECTIONS)  # the growth series come on top
    assert all(len(row) == len(COLUMNS) for row in table_rows(ran.report))


def test_the_quick_verb_writes_its_table_and_json(ran: Ran) -> None:
    check_complete(ran.content, SMALL)
    assert json.loads((ran.folder / "out" / "bench.json").read_text(encoding="utf-8")) == ran.content
    text = (ran.folder / "out" / "bench.txt").read_text(encoding="utf-8")
    assert ran.content["models"]["LSTM"] in text


def test_quick_times_everything_at_full_size() -> None:
    assert replace(QUICK, effort=BenchSettings().effort) == BenchSettings()
    assert QUICK.effort.rounds < BenchSettings().effort.rounds


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_a_peer_finds_our_commands_on_a_smooth_model(method: Method, lstm: Subject, instants: list[Instant]) -> None:
    peer = SingleShooting(lstm.function, lstm.limits, WEIGHTS, SMALL.horizon, lstm.metadata.dt_s, method)
    answers = [(peer.solve(instant.problem), instant.command) for instant in instants[:12]][2:]
    assert max(abs(answer.plan[0] - command.u) for answer, command in answers) < 2e-3
    assert all(answer.converged for answer, _ in answers) or method.iterations == 1


@pytest.mark.parametrize("subject", operator_subjects(), ids=lambda s: s.name)
def test_a_peer_plans_within_the_limits_at_the_cost_that_we_count(subject: Subject) -> None:
    recorded = record_scan(linearised_controller(subject, SMALL), subject)
    limits, dt = subject.limits, subject.metadata.dt_s
    peer = SingleShooting(subject.function, limits, WEIGHTS, SMALL.horizon, dt, SQP)
    for instant in recorded[:20]:
        answer, problem = peer.solve(instant.problem), instant.problem
        np.testing.assert_allclose(limits.clip_plans(answer.plan, problem.u_last, dt), answer.plan, atol=1e-5)
        both = np.stack([answer.plan, instant.command.plan])
        along = subject.own.rollout(problem.state[: subject.state_size], both)
        theirs, ours = (problem.cost(plan, angles) for plan, angles in zip(both, along, strict=True))
        assert not answer.converged or theirs < ours + 1e-2


def test_the_torch_peer_runs_the_same_network(lstm: Subject) -> None:
    if not pytorch_mppi_installed():
        pytest.skip("pytorch-mppi or torch is not installed")
    assert lstm.weights is not None
    sizes = (SMALL.samples, SMALL.horizon, lstm.metadata.dt_s, 0.3)
    peer = TorchMppi(lstm.weights, lstm.limits, WEIGHTS, *sizes)
    state = lstm.own.initial(29.0, 1.0)
    plan = np.array([1.2, 1.5, 1.9, 1.6, 1.3, 0.9])
    np.testing.assert_allclose(peer.angles(state, 1.0, plan), lstm.own.rollout(state, plan[None])[0], atol=1e-3)
    np.testing.assert_allclose(peer.angles(state, 1.0, np.full(6, 6.0))[0], lstm.own.advance(state, 1.48)[0], atol=1e-3)


def test_a_missing_peer_is_said_and_nothing_else(lstm: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(controllers, "pytorch_mppi_installed", lambda: False)
    for row in sampling_rows(lstm, SMALL, Clock(TINY), threads=1):
        assert (row.state, row.ratio) == ("not installed", None)
        assert row.times is not None


def test_costs_of_both_samplers_stand_beside_the_ratio(lstm: Subject) -> None:
    if not pytorch_mppi_installed():
        pytest.skip("pytorch-mppi or torch is not installed")
    for row in sampling_rows(lstm, SMALL, Clock(TINY), threads=1):
        assert 0.0 <= row.facts["plan_cost_mean"] < row.facts["peer_plan_cost_mean"]


def test_programs_mean_the_same_to_both_solvers(lstm: Subject) -> None:
    (row,) = program_rows(lstm, SMALL, Clock(TINY))
    assert row.facts["solution_difference_greatest"] < 1e-3


def test_programs_with_soft_limits_mean_the_same_to_both_solvers(lstm: Subject) -> None:
    """The rows of the angles move from program to program; the limits cut through the scan."""
    angle = lstm.metadata.trained_angle
    soft = WeightsSettings(effort=0.0, angle_lower_deg=angle.lower, angle_upper_deg=0.5 * (angle.lower + angle.upper))
    around, programs = recorded_programs(lstm, SMALL, soft)
    iterated = OsqpSolver(around.pattern, OsqpOptions(eps=1e-7, iterations=20_000))
    beyond = [np.maximum(p.lower - (at := active_set(p) @ p.columns), at - p.upper)[p.soft > 0] for p in programs]
    assert max(float(excess.max()) for excess in beyond) > 1.0
    for program in programs[::10]:
        np.testing.assert_allclose(active_set(program), iterated.solve(program).primal, atol=1e-3)


def test_operations_are_those_of_the_matrix_products() -> None:
    """Counted once more from the shapes: gates of both layers, the command, the head."""
    h = 64
    gates = sum(2 * 4 * h * inputs for inputs in (1, h, h, h))
    assert step_flops(h, 2) == gates + 2 * h
    rows = [1 + k for k in range(1, 21)]  # the motion, and a tangent for each command so far
    assert jacobian_flops(h, 2, 20) == sum(rows) * step_flops(h, 2)
    assert rollout_flops(h, 2, 256, 20) == 256 * 20 * step_flops(h, 2)


def test_both_libraries_multiply_at_every_shape() -> None:
    candidates = products(8, 16, 6)
    assert {p.library for p in candidates} == {"numpy", "onnxruntime"}
    times = Clock(TINY).measure([replace(p, rows=4).job(1) for p in candidates[:1] + candidates[-1:]])
    assert all(t.least_s > 0 for t in times.values())


def test_jobs_take_turns_and_warm_up() -> None:
    calls: list[str] = []
    effort = Effort(rounds=4, burst_s=1e-9, burst_most=1)
    times = Clock(effort).measure([TimedCall(name, lambda name=name: calls.append(name)) for name in "abc"])
    assert {name: t.seconds.size for name, t in times.items()} == dict.fromkeys("abc", 4)
    counted = "".join(calls[-12:])
    assert [counted[k : k + 3] for k in range(0, 12, 3)] == ["abc", "bca", "cab", "abc"]


def test_the_keyboard_leaves_what_there_is() -> None:
    count = 0

    def second() -> None:
        nonlocal count
        count += 1
        if count > 5:
            raise KeyboardInterrupt

    clock = Clock(Effort(rounds=50, burst_s=1e-9, burst_most=1))
    times = clock.measure([TimedCall("first", lambda: None), TimedCall("second", second)])
    assert clock.interrupted
    assert 0 < times["second"].seconds.size < 50


def test_an_interrupted_run_reports_the_sections_before() -> None:
    def stop(done: float, total: float, title: str = "") -> None:
        if title.startswith("linearised"):
            raise KeyboardInterrupt

    report = run_bench(SMALL, stop)
    assert report.interrupted
    assert {row.section for row in report.rows} == {"LSTM, kernels, one thread", "LSTM, kernels, 2 threads"}


@pytest.mark.parametrize(
    ("reads", "ratio", "goal", "reached"),
    [
        (Reads.FASTER, 61.0, 60.0, True),
        (Reads.FASTER, 59.0, 60.0, False),
        (Reads.OVER_LIMIT, 1.5, 1.67, True),
        (Reads.TAIL, 2.5, 2.0, False),
        (Reads.FASTER, 61.0, None, None),
        (Reads.FASTER, None, 60.0, None),
    ],
)
def test_goals_are_judged_by_what_the_ratio_says(
    reads: Reads, ratio: float | None, goal: float | None, reached: bool | None
) -> None:
    assert Comparison("s", "ours", "other", reads, goal, ratio=ratio).reached is reached


def test_a_goal_that_only_stalls_have_reached_is_not_reached() -> None:
    ours, stalled = Times(np.array([1.0, 1.0, 1.0])), Times(np.array([2.0, 9.0, 9.0]))
    row = Comparison("s", "ours", "peer", Reads.FASTER, 5.0).with_times(ours, stalled).measured(9.0)
    assert row.least_ratio == 2.0
    assert row.reached is False
    (cells,) = table_rows(BenchReport({}, {}, {}, [row], interrupted=False))
    assert cells[-2:] == ["≥ 5 no", "2.00 by the shortest calls"]


def test_durations_and_missing_values_are_readable() -> None:
    times = Times(np.array([173e-6]))
    rows = [
        Comparison("s", "ours", "peer", Reads.FASTER, 60.0)
        .with_times(times, Times(np.array([0.0173])))
        .measured(100.0),
        Comparison("s", "ours", "absent", Reads.FASTER).with_times(times, None).without_peer(),
    ]
    first, second = table_rows(BenchReport({}, {}, {}, rows, interrupted=False))
    assert first == ["s: ours", "173 us", "173 us", "peer", "17.3 ms", "100 x faster", "≥ 60 yes", ""]
    assert second == ["", "", "", "absent", "-", "not installed", "-", ""]


def test_work_is_repeated_in_order() -> None:
    seen: list[tuple[int, str]] = []
    run = in_turn("ab", lambda k, item: seen.append((k, item)))
    for _ in range(3):
        run()
    assert seen == [(0, "a"), (1, "b"), (0, "a")]


def test_effort_has_to_be_positive() -> None:
    with pytest.raises(ConfigError, match="values > 0"):
        Effort(rounds=0, burst_s=1.0, burst_most=1)


def test_the_subjects_predict_what_their_peers_see(lstm: Subject) -> None:
    for subject in (lstm, *operator_subjects()):
        state = own_state(subject.own, subject)
        theta, _ = subject.function(state, 2.0)
        assert float(theta) == pytest.approx(subject.own.advance(state, 2.0)[0], abs=1e-3)


def own_state(predictor: Predictor, subject: Subject) -> np.ndarray:
    return predictor.initial(subject.metadata.trained_angle.lower, 1.0)
