"""A kind behind a drive learns from the travel; a network of what operators leave is kept where it helps alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from hystmpc.models.contract.export import model_bytes
from hystmpc.models.contract.load import OnnxModel
from hystmpc.models.evaluate import evaluate
from hystmpc.models.kinds import networks
from hystmpc.models.kinds.catalogue import all_kinds, chosen_kind, kind_named
from hystmpc.models.kinds.connected import DrivenKind, ResidualKind, behind
from hystmpc.models.kinds.kind import FitRequest, Identified
from hystmpc.models.kinds.operator_kinds import AutoKind
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.simulator import ChainModel
from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial

from .test_auto import PAIR, THREE, identified, motions, recorded, trials_of


def request(kind: str, **changes: object) -> FitRequest:
    return replace(FitRequest(training=kind_named(kind).trainings[0]), **changes)  # type: ignore[arg-type]


def identified_before(
    patch: pytest.MonkeyPatch, before: tuple[Operator, ...], motion: tuple[int, ...], wave_deg: float = 0.0
) -> None:
    """`auto` answers with the device that it has identified from the same trials, without the wave, in `test_auto`."""
    expected, answer = wavy(trials_of(before, motion), wave_deg), identified(before, motion)

    def fit(self: AutoKind, trials: Sequence[Trial], asked: FitRequest, progress: object = None) -> Identified:
        assert asked.training in self.trainings
        assert asked.validation == ()
        for trial, same in zip(trials, expected, strict=True):
            np.testing.assert_array_equal(trial.angle, same.angle)
        return answer

    patch.setattr(AutoKind, "fit", fit)


@pytest.mark.parametrize("name", [kind.name for kind in all_kinds() if kind.readable])
def test_operators_have_a_drive_of_their_own(name: str) -> None:
    with pytest.raises(FitError, match="expected a network or a regression"):
        chosen_kind(name, drive="auto")


def test_combinations_that_mean_nothing_are_refused() -> None:
    for arguments, words in (
        (("auto", "auto", "lstm"), "expected one of them"),
        (("backlash", None, "lstm"), "trained with `auto` only"),
        (("auto", None, "lstn"), "lstm"),
        (("auto", None, "hb1"), "no network 'hb1'"),
    ):
        with pytest.raises(FitError, match=words):
            chosen_kind(*arguments)
    with pytest.raises(FitError, match="the simulator has no drive"):
        chosen_kind("play_kernel", drive="builtin:backlash")
    swapped = [trial.swapped() for trial in recorded()]
    with pytest.raises(FitError, match="behind a drive has no inverse map"):
        chosen_kind("play_kernel", drive="auto").fit(swapped, request("play_kernel"))


@pytest.mark.slow
def test_an_identified_drive_halves_the_error_of_a_rate_independent_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    """Under a lag and a delay, on a motion that was left out; the file is one model."""
    trials = trials_of((Delay(0.09, 8), Lag(0.15)), (*THREE, 4))
    identified_before(monkeypatch, (Delay(0.09, 8), Lag(0.15)), THREE)
    plain, driven = kind_named("play_kernel"), DrivenKind(kind_named("play_kernel"))
    asked = request("play_kernel", training="rate_independent")
    errors = []
    for kind in (plain, driven):
        found = kind.fit(trials[:-1], asked)
        model = OnnxModel(model_bytes(found.bundle), kind.title)
        errors.append(evaluate(model, trials[-1]).errors.rmse_deg)
    assert found.parts is not None
    assert "delay + lag" in found.report
    assert model.metadata.noise is not None
    assert errors[1] < 0.5 * errors[0]


def wavy(trials: list[Trial], amplitude_deg: float) -> list[Trial]:
    """The same with an angle that goes up and down along the stroke, of which no operator of the device knows."""
    return [replace(t, angle=t.angle + amplitude_deg * np.sin(t.command)) for t in trials]


def small(patch: pytest.MonkeyPatch) -> None:
    """A network of one layer of 16 in the place of the training, which takes a minute."""
    trainings = networks.GRU.settings
    network = trainings[networks.RESIDUAL].network.model_copy(update={"hidden": 16, "layers": 1})
    tried = trainings[networks.RESIDUAL].model_copy(update={"network": network})
    patch.setattr(networks.GRU, "settings", {**trainings, networks.RESIDUAL: tried})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("amplitude_deg", "steps", "kept"),
    [(0.0, 30, False), (5.0, 60, True)],
    ids=["nothing left", "a wave left"],
)
def test_a_network_of_what_is_left_is_kept_where_it_helps_alone(
    amplitude_deg: float, steps: int, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("torch", reason="torch is an extra")
    small(monkeypatch)
    identified_before(monkeypatch, (Lag(0.15),), PAIR, amplitude_deg)
    trials = wavy(trials_of((Lag(0.15),), PAIR), amplitude_deg)
    kind, first = ResidualKind("gru"), list[Identified]()
    fit = kind._auto.fit
    monkeypatch.setattr(kind._auto, "fit", lambda *given: first.append(fit(*given)) or first[0])
    found = kind.fit(trials, FitRequest(steps=steps))
    assert [connection.way for connection in found.bundle.metadata.connections] == (["series", "parallel"] * kept)
    assert ("not kept" in found.report) != kept
    assert found.parts is not None
    if kept:
        model = OnnxModel(model_bytes(found.bundle))
        held_out = recorded(Lag(0.15), commands=motions(3)[:2])
        assert first[0].simulator is not None
        errors = [
            np.mean([evaluate(one, trial).errors.rmse_deg for trial in wavy(held_out, amplitude_deg)])
            for one in (model, ChainModel(first[0].simulator))
        ]
        assert errors[0] < errors[1]  # of the operators alone


@pytest.mark.slow
def test_ctrl_c_during_the_network_keeps_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch", reason="torch is an extra")

    def stop(done: int, rmse: float) -> None:
        if done > 100:  # of `auto`, which is done by then
            raise KeyboardInterrupt

    small(monkeypatch)
    identified_before(monkeypatch, (Lag(0.15),), PAIR)
    found = ResidualKind("gru").fit(trials_of((Lag(0.15),), PAIR), FitRequest(steps=60), stop)
    assert found.interrupted
    assert found.simulator is not None
    assert "gru not kept: interrupted" in found.report


@pytest.mark.slow
def test_the_travel_starts_where_the_command_does() -> None:
    from hystmpc.models.inverse.drive import Drive

    from .tiny_kinds import DEVICE

    trial = recorded()[0]
    moved = behind(Drive(DEVICE.chain.before, DEVICE.metadata()), trial)
    assert moved.command[0] == pytest.approx(trial.command[0])
    np.testing.assert_array_equal(moved.angle, trial.angle)
    assert np.ptp(moved.command) <= np.ptp(trial.command) + 1e-9
