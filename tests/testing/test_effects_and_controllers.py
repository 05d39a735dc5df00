"""The contracts of effects and controllers: kept by all of the package and by the templates, and not by broken ones."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pytest

from hystmpc.ctrl.command import CommandLimits, ControlInput, Source, Stopwatch
from hystmpc.ctrl.config import CONTROLLERS, PythonControllerSettings, parse_controller
from hystmpc.ctrl.feedback import InverseControllerSettings
from hystmpc.ctrl.law import Law, LawSettings, Proposal
from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.models.effects.effect import Effect
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.operators.operator import Memoryless, Number, Symbol
from hystmpc.sim.config import load_simulation
from hystmpc.testing import ControllerContract, EffectContract
from hystmpc.testing.templates import write_template
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.from_outside import ALLOWED

LAWS = [name for name in dir(ControllerContract) if name.startswith("test_")]
EFFECT_LAWS = [name for name in dir(EffectContract) if name.startswith("test_")]
WITHOUT_FORMS = ("trial_shift", "periodic_disturbance", "sensor", "dahl_drag", "directional_gain")
MOVING = ("drift", "periodic_disturbance", "sensor")
JUMPS = {"sensor": 1.0, "rate_dependence": 0.3}  # it rounds; in a hold its derivative is that of a slow motion


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A working folder with the templates of all kinds; modules imported from it are forgotten behind it."""
    before = set(sys.modules)
    monkeypatch.setenv(ALLOWED, "all")
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path / "controller"), str(tmp_path / "effect")])
    for kind in ("controller", "effect"):
        write_template(kind, tmp_path / kind)
    yield tmp_path
    for name in set(sys.modules) - before:
        if name in ("control_law", "screw_error"):
            del sys.modules[name]


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_every_controller_keeps_the_contract(kind: str) -> None:
    class Own(ControllerContract):
        def settings(self) -> LawSettings:
            return CONTROLLERS[kind].parse({"kind": kind})

    contract = Own()
    for law in LAWS:
        getattr(contract, law)()


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_keeps_the_contract(name: str) -> None:
    class Own(EffectContract):
        effect = EFFECTS[name]
        moves_at_rest = name in MOVING
        jumps = JUMPS.get(name, EffectContract.jumps)

    for law in EFFECT_LAWS:
        if law != "test_its_forms_can_be_fitted" or name not in WITHOUT_FORMS:
            getattr(Own(), law)()


@dataclass(frozen=True)
class Crooked(Memoryless):
    """A gain in fine steps: the derivative of a step is zero, and that of the whole is not."""

    gain: Annotated[float, Number("1", 0.1, 10.0, 1.0, "slope")]
    name: ClassVar[str] = "crooked"

    def curve(self, u: Symbol, p: Symbol) -> Symbol:
        import casadi as ca

        return p[0] * ca.floor(1e6 * u) / 1e6


GOOD = replace(EFFECTS["slack"], shown=({"slack": 1.0},))
CROOKED = Effect(
    operator=Crooked, equation="y = u", apart="none", neutral={"gain": 1.0}, shown=({"gain": 2.0},), sides=("command",)
)


@pytest.mark.parametrize(
    ("law", "effect"),
    [
        ("test_with_its_neutral_values_it_changes_nothing", replace(GOOD, neutral={"slack": 2.0, "toe": 0.0})),
        ("test_as_shown_it_is_seen", replace(GOOD, shown=({"slack": 0.0},))),
        ("test_every_parameter_says_what_it_is", replace(GOOD, neutral={"slak": 0.0})),
        ("test_its_forms_can_be_fitted", replace(GOOD, forms=lambda scale: ())),
        ("test_its_forms_can_be_fitted", replace(GOOD, sides=("output",))),
        ("test_at_rest_nothing_moves", EFFECTS["drift"]),
        ("test_its_derivatives_are_those_of_its_equation", CROOKED),
    ],
)
def test_an_effect_that_breaks_a_law_is_found(law: str, effect: Effect) -> None:
    contract = EffectContract()
    contract.effect = effect
    with pytest.raises(AssertionError):
        getattr(contract, law)()


class Broken(Law[None]):
    """The inverse, with a fault."""

    horizon, source = 1, Source.CONTROLLER

    def __init__(self, inverse: Inverse, fault: str) -> None:
        self._inverse, self._fault, self._count = inverse, fault, 0

    def init(self, y: float, u: float) -> None:
        del y, u

    def propose(self, memory: None, given: ControlInput, watch: Stopwatch) -> Proposal[None]:
        del watch
        self._count += 1
        if self._fault == "raises":
            raise RuntimeError("a law's own")
        off = {"offset": 0.5, "hunts": 0.3 * (-1) ** self._count, "remembers": 1e-3 * self._count}
        u = self._inverse.command(given.state, float(given.reference[0]), given.u_last)
        return Proposal(u + off[self._fault], memory)


class BrokenSettings(InverseControllerSettings):
    """Of a law with a fault."""

    fault: str = "raises"

    def law(self, predictor: Predictor, inverse: Inverse, limits: CommandLimits) -> Law[Any]:
        del predictor, limits
        return Broken(inverse, self.fault)


@pytest.mark.parametrize(
    ("law", "fault"),
    [
        ("test_it_settles_on_a_target_without_its_fallbacks", "raises"),
        ("test_it_settles_on_a_target_without_its_fallbacks", "offset"),
        ("test_it_comes_to_rest", "hunts"),
        ("test_the_same_state_gives_the_same_command", "remembers"),
    ],
)
def test_a_controller_that_breaks_a_law_is_found(law: str, fault: str) -> None:
    class Own(ControllerContract):
        def settings(self) -> LawSettings:
            return BrokenSettings.parse({"fault": fault})

    with pytest.raises(AssertionError):
        getattr(Own(), law)()


@pytest.mark.parametrize("fault", ["raises", "offset", "hunts", "remembers"])
def test_no_fault_of_a_law_brings_it_beyond_the_limits(fault: str) -> None:
    class Own(ControllerContract):
        def settings(self) -> LawSettings:
            return BrokenSettings.parse({"fault": fault})

    Own().test_nothing_brings_it_beyond_the_limits()


def test_a_controller_from_outside_stands_in_a_study(lab: Path) -> None:
    study = load_simulation(lab / "controller" / "simulate.yaml")
    own = study.controllers["own"]
    assert isinstance(own, PythonControllerSettings)
    assert type(own.resolved()).__name__ == "ControlLawSettings"
    assert own.resolved().ki_per_deg_s == 0.02  # type: ignore[attr-defined]  # the template's
    assert type(study).parse(study.model_dump(mode="json")) == study


def test_a_sensor_tells_a_controller_from_outside_too(lab: Path) -> None:
    path = lab / "controller" / "simulate.yaml"
    study = load_simulation(path, ["sensor.kind=intermittent", "controllers.pid={kind: inverse}"])
    assert study.controllers["own"].resolved().estimator.sensor == "intermittent"


@pytest.mark.parametrize(
    ("block", "expected"),
    [
        ({"python": "control_law:Missing"}, "no class derived from LawSettings 'Missing' in .*ControlLawSettings"),
        ({"python": "control_law:Memory"}, "no class derived from LawSettings 'Memory'"),
        ({"python": "control_law:ControlLawSettings", "ki": 1}, "unknown key 'ki', available: .*ki_per_deg_s"),
        ({"python": "control_law:ControlLawSettings", "ki_per_deg_s": -1}, "ki_per_deg_s.*got -1"),
        ({"python": "no_such_module:X"}, "no module 'no_such_module' is installed or in the working folder"),
        ({"kind": "lqg"}, "unknown kind 'lqg', available: "),
        ({}, "got neither kind nor python"),
    ],
)
def test_a_controller_that_does_not_fit_is_refused_in_one_line(block: dict[str, Any], expected: str, lab: Path) -> None:
    with pytest.raises(ConfigError, match=expected) as refused:
        parse_controller(block, "own")
    assert "\n" not in str(refused.value)


def test_a_controller_of_an_installed_package_is_a_kind(lab: Path) -> None:
    done = _installed(
        lab / "controller",
        "[hystmpc.controllers]\nintegral = control_law:ControlLawSettings\n",
        "from hystmpc.ctrl import parse_controller; print(parse_controller({'kind': 'integral'}).resolved().kind)",
    )
    assert done.stdout.strip() == "control_law", done.stderr


@pytest.mark.slow
def test_an_installed_effect_is_listed_and_named_by_a_diagnosis(lab: Path) -> None:
    points = "[hystmpc.effects]\na = screw_error:EFFECT\n"
    code = (
        "from hystmpc.gap.self_test import self_test\n"
        "from hystmpc.models.effects.catalogue import EFFECTS\n"
        "assert 'screw_error' in EFFECTS\n"
        "print(self_test(cases=['screw_error'])[0].named)"
    )
    done = _installed(lab / "effect", points, code)
    assert done.stdout.split(",")[0].strip() == "screw_error", done.stderr


def test_an_installed_effect_that_cannot_be_used_is_refused_in_one_line(lab: Path) -> None:
    done = _installed(lab / "effect", "[hystmpc.effects]\na = screw_error:EFECT\n", "", "effects")
    assert done.returncode == 2
    assert "effect screw_error:EFECT: no Effect object 'EFECT'" in done.stderr
    assert "did you mean 'EFFECT'" in done.stderr


def _installed(folder: Path, points: str, code: str, *command: str) -> subprocess.CompletedProcess[str]:
    """A process of its own that finds the folder's modules as an installed package with these entry points."""
    facts = folder / "lab-0.1.dist-info"
    facts.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: lab\nVersion: 0.1\n")
    (facts / "entry_points.txt").write_text(points)
    path = os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    program = str(Path(sys.executable).with_name("hystmpc"))
    run = [program, *command] if command else [sys.executable, "-c", code]
    return subprocess.run(
        run, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path}, timeout=300, check=False
    )
