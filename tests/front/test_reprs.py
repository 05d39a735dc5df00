"""What a prompt shows of the public results: one short line each, with numbers, never an array whole."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hystmpc
from hystmpc.trials.brief import LONGEST, in_brief
from hystmpc.trials.trial import Trial

from ..ctrl.test_tip_controller import controller_for

RETURNED = {  # by the public functions that take longer
    "hystmpc.bench.commission": "Commissioned",
    "hystmpc.gap.diagnosis": "Diagnosis",
    "hystmpc.bench.rounds": "Investigated",
    "hystmpc.models.contract.export": "EquivalenceReport",
    "hystmpc.sim.results": "StudyResult",
    "hystmpc.sim.tuning.objective": "Tuning",
}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """One of each that takes no longer than moments."""
    folder = tmp_path_factory.mktemp("reprs")
    t = 0.04 * np.arange(1500)
    command = 3.0 + 2.9 * np.sin(0.5 * t)
    model = hystmpc.load_model("builtin:backlash")
    angle = np.asarray(model.run(command, 30.0))  # type: ignore[attr-defined]  # a chain
    trials = [Trial(t, command, angle + 0.1 * np.sin(9 * t), source=str(folder / f"{k}{'x' * 90}.csv")) for k in "abc"]
    tip = controller_for()
    tip.reset(30.0)
    reach = tip.set_target(400.0)
    answer = tip.step(30.0)
    evaluation = hystmpc.evaluate(model, trials)
    return {
        "trial": trials[0],
        "check": hystmpc.check(trials[0]),
        "model": model,
        "simulator": hystmpc.load_model("builtin:pi").simulator,
        "evaluation": evaluation,
        "one run": evaluation[0],
        "mean": evaluation.mean,
        "none": hystmpc.Evaluation(()),
        "limits": hystmpc.Limits(0.0, 6.0, 10.0),
        "controller": hystmpc.build_controller("pid", model),
        "tip": tip,
        "reach": reach,
        "command": answer,
        "state": tip.state(),
        "plan": tip.plan(),
        "snapshot": tip.snapshot(),
        "control": tip.snapshot().control,
        "fit": hystmpc.fit("backlash", trials[:1], steps=2),
    }


def test_every_public_result_is_a_short_line(results: dict[str, Any]) -> None:
    for name, result in results.items():
        line = repr(result)
        assert "\n" not in line, name
        assert len(line) <= LONGEST, (name, len(line))
        assert "object at 0x" not in line, name
        assert "array([" not in line, name
        assert line.startswith(type(result).__name__), name


def test_the_lines_have_the_numbers_that_matter(results: dict[str, Any]) -> None:
    rmse = results["evaluation"].mean.rmse_deg
    assert f"3 trials: RMSE {rmse:.4g} deg" in repr(results["evaluation"])
    assert "linearised_mpc" in repr(results["tip"])
    assert "30 deg" in repr(results["tip"])
    assert "no trials" in repr(results["none"])
    assert str(results["evaluation"]) == repr(results["evaluation"])


def test_every_class_of_the_face_has_a_line_of_its_own() -> None:
    for name in hystmpc.__all__:
        thing = getattr(hystmpc, name)
        if isinstance(thing, type) and not issubclass(thing, Exception):
            assert thing.__repr__ is not object.__repr__, name
    for module, name in RETURNED.items():
        found = vars(getattr(import_module(module), name))["__repr__"]
        assert not hasattr(found, "__wrapped__"), name  # one that `dataclass` makes writes every field whole


@pytest.mark.parametrize("text", ["", "x" * 5000, "two\nlines", "a\tb  c", str(Path("p" * 400))])
def test_whatever_is_said_is_one_line_of_bounded_length(text: str) -> None:
    line = in_brief(text, text)
    assert len(line) <= LONGEST
    assert "\n" not in line
