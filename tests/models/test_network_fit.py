"""Training of LSTMs: it learns, it repeats itself, it stops when told and says why it cannot start."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import count
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import load_onnx
from hystmpc.models.evaluate import evaluate
from hystmpc.models.kinds.networks import LSTM
from hystmpc.models.networks.settings import (
    DeviceFacts,
    GatedSettings,
    NetworkSettings,
    RecurrentSettings,
    StreamTraining,
    TeacherSettings,
    WindowTraining,
)
from hystmpc.models.train.networks import NetworkCheck, NetworkFit, fit_network, network_bundle
from hystmpc.models.train.runs import TrainingRun, arrange, draw_windows, hold_out, pause, stretch
from hystmpc.models.train.teacher import Teacher
from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial

from .lstm_examples import DT, decaying_trial, four_trials

torch = pytest.importorskip("torch")
pytestmark = pytest.mark.slow

STREAMS = StreamTraining(length=25, streams=4, updates=240, rounds_between_checks=1, averaging=0.9, teacher=None)
SMALL = NetworkSettings(
    network=RecurrentSettings(hidden=8),
    warmup_samples=5,
    learning_rate=1e-2,
    validation_trials=1,
    training=STREAMS,
)
WAYS = {
    "streams": SMALL,
    "streams with teacher": SMALL.model_copy(
        update={"training": STREAMS.model_copy(update={"teacher": TeacherSettings(plays=3, runs=2)})}
    ),
    "gated, centred on a play kernel": SMALL.model_copy(
        update={
            "network": GatedSettings(hidden=8, plays=4),
            "training": STREAMS.model_copy(
                update={"teacher": TeacherSettings(model="play_kernel", runs=2, centred=True)}
            ),
        }
    ),
    "windows": SMALL.model_copy(update={"training": WindowTraining(length=20, epochs=6, windows_per_epoch=160)}),
    "windows, constant in constant out": SMALL.model_copy(
        update={"training": WindowTraining(length=20, epochs=6, windows_per_epoch=160, constancy_weight=1e-4)}
    ),
}
every_way = pytest.mark.parametrize("settings", WAYS.values(), ids=WAYS.keys())


def same(a: NetworkFit, b: NetworkFit) -> bool:
    pairs = zip(a.net.state_dict().values(), b.net.state_dict().values(), strict=True)
    return a.history == b.history and all(torch.equal(x, y) for x, y in pairs)


@cache
def fitted(way: str) -> tuple[NetworkFit, list[tuple[int, float]]]:
    """Fitted once for all tests that look at it, with what was reported meanwhile."""
    seen: list[tuple[int, float]] = []
    return fit_network(four_trials(), WAYS[way], lambda done, best: seen.append((done, best))), seen


@pytest.mark.parametrize("way", WAYS)
def test_error_falls_and_the_best_look_is_kept(way: str) -> None:
    (fit, seen), settings = fitted(way), WAYS[way]
    errors = [look.validation_rmse_deg for look in fit.history]
    assert fit.validation_rmse_deg == min(errors) < 0.7 * errors[0]
    assert fit.history[[look.step for look in fit.history].index(fit.best_step)].validation_rmse_deg == min(errors)
    assert [done for done, _ in seen] == [look.step for look in fit.history]
    assert seen[-1] == (settings.steps, min(errors))
    assert not fit.interrupted


def until_third_look(settings: NetworkSettings) -> NetworkFit:
    """A training that is interrupted at its third look."""
    looks = count(1)

    def stop(done: int, best: float) -> None:
        if next(looks) == 3:
            raise KeyboardInterrupt

    return fit_network(four_trials(), settings, stop)


@every_way
def test_same_seed_same_network_and_another_seed_another(settings: NetworkSettings) -> None:
    first, state = until_third_look(settings), torch.random.get_rng_state()
    assert same(first, until_third_look(settings))
    assert torch.equal(torch.random.get_rng_state(), state)  # the caller's random numbers are his own
    assert not same(first, until_third_look(settings.model_copy(update={"seed": 2})))


@every_way
def test_interrupting_keeps_the_best_so_far(settings: NetworkSettings) -> None:
    threads = torch.get_num_threads()
    fit = until_third_look(settings)
    assert fit.interrupted
    assert len(fit.history) == 3
    assert fit.validation_rmse_deg == min(look.validation_rmse_deg for look in fit.history)
    assert torch.get_num_threads() == threads


def test_trained_network_is_exported_and_predicts_as_its_history_says(tmp_path: Path) -> None:
    trials = four_trials()
    fit = fit_network(trials, SMALL)
    export_onnx(network_bundle(fit, trials), tmp_path / "small.onnx")
    model = load_onnx(tmp_path / "small.onnx")
    (held_out,) = [trial for trial in trials if trial.source in fit.held_out]
    assert evaluate(model, held_out).errors.rmse_deg == pytest.approx(fit.validation_rmse_deg, rel=1e-3)
    facts = model.metadata
    assert (facts.kind, facts.dt_s, facts.warmup_samples) == ("lstm", DT, 5)
    assert facts.trained_command.upper == max(trial.command.max() for trial in trials)
    assert facts.initial.offset == (0.0,) * 32
    assert np.any(facts.conditioned.offset)
    assert facts.training["validation_rmse_deg"] == fit.validation_rmse_deg
    assert facts.training["preset"] == "best"


def test_unusable_input_is_named() -> None:
    trials = four_trials()
    with pytest.raises(FitError, match="got no trials"):
        fit_network([], SMALL)
    with pytest.raises(FitError, match="1 held out and one to train on"):
        fit_network(trials[:1], SMALL)
    with pytest.raises(FitError, match="40 samples, expected at least 50"):
        fit_network([*trials, trials[0].select(0, 40)], SMALL)
    rest = Trial(trials[0].t, 0 * trials[0].t, trials[0].angle, source="rest")
    with pytest.raises(FitError, match="rest: the command is constant"):
        fit_network([*trials, rest], SMALL)
    slow = Trial(2 * trials[0].t, trials[0].command, trials[0].angle, source="slow")
    with pytest.raises(FitError, match=r"slow: sampled every 0\.08 s"):
        fit_network([*trials, slow], SMALL)
    windows = SMALL.model_copy(update={"training": WindowTraining(length=1000, epochs=1)})
    with pytest.raises(FitError, match="the 1000 of a window"):
        fit_network(trials, windows)


@every_way
def test_divergence_is_an_error(settings: NetworkSettings) -> None:
    with pytest.raises(FitError, match="diverged"):
        fit_network(four_trials(), settings.model_copy(update={"learning_rate": 1e30}))


def test_interrupting_before_the_first_look_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hystmpc.models.train.runs._run", interrupted)
    with pytest.raises(FitError, match="before its first check"):
        fit_network(four_trials(), SMALL)


def test_without_held_out_trials_the_training_trials_judge() -> None:
    fit = fit_network(four_trials(), SMALL.model_copy(update={"validation_trials": 0}))
    assert fit.held_out == ()
    assert np.isfinite(fit.validation_rmse_deg)


def test_few_trials_keep_the_edges_in_training() -> None:
    trials = four_trials()
    above, below = (decaying_trial(0.57, baseline, "") for baseline in (True, False))
    middle = Trial(above.t, 0.5 * (above.command + below.command), above.angle, source="middle")
    training, held_out = hold_out([*trials, middle], 1, seed=5)
    assert [trial.source for trial in held_out] == ["middle"]
    assert [trial.source for trial in training] == [trial.source for trial in trials]


def test_many_trials_are_drawn_by_seed() -> None:
    trials = four_trials() * 3
    parts = [hold_out(trials, 3, seed)[1] for seed in (1, 1, 2)]
    assert [id(t) for t in parts[0]] == [id(t) for t in parts[1]] != [id(t) for t in parts[2]]


def test_streams_hold_every_run_once_from_the_start_of_a_piece() -> None:
    rng = np.random.default_rng(0)
    runs = [
        TrainingRun(np.arange(n) + 1000.0 * n, -np.arange(n) - 1000.0 * n, np.full(n, 0.5))
        for n in (7, 95, 120, 33, 60)
    ]
    streams = arrange(runs, 3, 20, 5, rng)
    assert streams.fresh.sum() == len(runs)
    lines = [part.swapaxes(0, 1).reshape(3, -1) for part in (streams.command, streams.angle, streams.weight)]
    found = []
    for n, k in np.argwhere(streams.fresh.T):
        first = 20 * k + 5
        length = int(lines[0][n, first] // 1000)
        found.append(length)
        span = slice(first, first + length)
        np.testing.assert_array_equal(lines[0][n, span], np.arange(length) + 1000 * length)
        np.testing.assert_array_equal(lines[1][n, span], -lines[0][n, span])
        np.testing.assert_array_equal(lines[0][n, 20 * k : first], 1000 * length)
        assert (lines[2][n, span] == 0.5).all()
        assert not lines[2][n, 20 * k : first].any()
    assert sorted(found) == [7, 33, 60, 95, 120]
    assert lines[2].sum() == 0.5 * sum(found)


def test_stretched_runs_are_the_same_motion_at_another_speed() -> None:
    t = np.arange(500) * DT
    run = TrainingRun(np.sin(t), np.cos(t), np.ones(500))
    rng = np.random.default_rng(1)
    for copy in stretch([run] * 20, 0.2, rng):
        speed = 500 / copy.command.size
        assert 1 / 1.21 < speed < 1.21
        np.testing.assert_allclose(copy.command**2 + copy.angle**2, 1.0, atol=1e-3)


def test_paused_runs_hold_and_go_on() -> None:
    run = TrainingRun(np.arange(40.0), np.arange(40.0) + 7, np.ones(40))
    copies = pause([run] * 50, 30, np.random.default_rng(2))
    assert {copy.command.size for copy in copies} <= set(range(40, 71))
    assert len({copy.command.size for copy in copies}) > 10
    for copy in copies:
        np.testing.assert_array_equal(copy.angle, copy.command + 7)
        np.testing.assert_array_equal(np.unique(copy.command), run.command)
        assert np.count_nonzero(np.diff(copy.command) == 0) == copy.command.size - 40
        assert (np.diff(copy.command) >= 0).all()
        assert copy.weight.all()


def test_windows_are_pieces_of_runs() -> None:
    ramps = np.arange(30.0), np.arange(50.0, 90.0)
    runs = [TrainingRun(ramp, ramp + 100, np.ones(ramp.size)) for ramp in ramps]
    signals = [(run.command, run.angle, run.weight) for run in runs]
    command, angle, weight = draw_windows(signals, 200, 10, np.random.default_rng(0))
    assert (np.diff(command, axis=1) == 1).all()
    assert (angle == command + 100).all()
    assert weight.all()
    assert {0.0, 50.0} <= set(command[:, 0]) <= {*np.arange(21.0), *np.arange(50.0, 81.0)}


def test_teacher_stays_within_what_the_trials_showed() -> None:
    trials = four_trials()
    teacher = Teacher(trials, plays=4)
    runs = teacher.runs(12, 0.3, np.random.default_rng(0))
    fastest = max(np.abs(np.diff(trial.command)).max() for trial in trials)
    for run in runs:
        assert run.command.min() >= min(trial.command.min() for trial in trials) - 1e-9
        assert run.command.max() <= max(trial.command.max() for trial in trials) + 1e-9
        assert (run.weight == 0.3).all()
    for run in runs[1::4]:  # moves and holds
        assert np.abs(np.diff(run.command)).max() <= fastest * (1 + 1e-9)
    assert teacher.rmse_deg < 1.0


def test_trainings_are_the_papers_and_ours() -> None:
    paper, best, other = (LSTM.settings[name] for name in ("paper", "best", "s1"))
    assert isinstance(paper.training, WindowTraining)
    assert (paper.training.length, paper.training.batch, paper.steps) == (50, 16, 100)
    assert isinstance(paper.network, RecurrentSettings)
    assert (paper.network.hidden, paper.network.layers, paper.seed, paper.learning_rate) == (64, 2, 1, 1e-3)
    assert (other.scaling, other.steps) == (None, 50)
    assert isinstance(best.training, StreamTraining)
    assert NetworkSettings.parse(best.model_dump()) == best


def test_a_network_that_amplifies_rounding_is_noticed() -> None:
    from hystmpc.models.train.updates_ import rounding_error, whole_runs

    ramp = np.linspace(-1, 1, 400)
    judged = whole_runs([TrainingRun(ramp, ramp, np.ones(400))] * 2, 0)
    torch.manual_seed(0)
    settings = RecurrentSettings(hidden=32, layers=1, memory_samples=0, command_gain=1.0)
    calm, chaotic = (settings.network(DeviceFacts()) for _ in range(2))
    with torch.no_grad():
        chaotic.get_parameter("lstm.weight_hh_l0").mul_(60.0)
    found = [rounding_error(net, judged, judged.output(net)) for net in (calm, chaotic)]
    assert found[0] < 1e-5
    assert found[1] > 1e-3
    assert NetworkCheck(1, 0.1, 0.1, found[0]).exportable
    assert not NetworkCheck(1, 0.1, 0.1, found[1]).exportable


def test_an_inverse_map_learns_from_swapped_runs_of_a_forward_teacher() -> None:
    trials = four_trials()
    forward, inverse = Teacher(trials, plays=3), Teacher([t.swapped() for t in trials], plays=3)
    pairs = [teacher.runs(4, 0.5, np.random.default_rng(3)) for teacher in (forward, inverse)]
    for one, other in zip(*pairs, strict=True):
        np.testing.assert_array_equal(one.command, other.angle)
        np.testing.assert_array_equal(one.angle, other.command)


@pytest.mark.parametrize("inverted", [False, True])
def test_centring_takes_out_the_offset_of_a_trial_and_nothing_else(inverted: bool) -> None:
    trials = [trial.swapped() if inverted else trial for trial in four_trials()]
    teacher = Teacher(trials, 4, "play_kernel")
    for forward in four_trials():
        shifted = replace(forward, angle=forward.angle + 2.0)
        pair = [teacher.centred(t.swapped() if inverted else t) for t in (forward, shifted)]
        one, other = ((t.swapped() if inverted else t) for t in pair)
        np.testing.assert_allclose(one.angle, other.angle, rtol=0, atol=1e-9)
        np.testing.assert_array_equal(one.command, forward.command)
        assert np.ptp(one.angle - forward.angle) < 1e-9
        assert abs(np.mean(one.angle - forward.angle)) < 1.0


def test_a_teacher_knows_the_lag_in_front_of_the_hysteresis() -> None:
    lagged, gain = [], 1 - np.exp(-DT / 0.04)
    for trial in four_trials():
        travel, v = [], float(trial.command[0])
        for u in trial.command.tolist():
            v += gain * (u - v)
            travel.append(v)
        lagged.append(replace(trial, angle=np.interp(travel, [0.0, 6.0], [30.0, 90.0])))
    assert Teacher(lagged, 4, "play_kernel").lag_s == 0.04
    assert Teacher([trial.swapped() for trial in lagged], 4, "play_kernel").lag_s == 0.0


@pytest.mark.parametrize("model", ["pi", "play_kernel"])
def test_every_teacher_answers_as_the_trials_did(model: Literal["pi", "play_kernel"]) -> None:
    """Asked for a motion that was recorded, within the error that it owns up to and an offset for each trial."""
    trials = four_trials()
    teacher = Teacher(trials, 4, model)
    for trial in trials:
        error = teacher.answer(trial.command, float(trial.angle[0])) - trial.angle
        assert np.std(error) < 3 * teacher.rmse_deg + 0.2
