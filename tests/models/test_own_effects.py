"""An effect from outside the package is one of the library: in files and candidates; a wrong one is refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pytest

import hystmpc
from hystmpc.models import EFFECTS, Candidate, Effect, Freedom, Number, Scale, add_effect, effect_operator
from hystmpc.models.effects import catalogue
from hystmpc.models.effects.catalogue import candidates, diagnosable
from hystmpc.models.operators.operator import Memoryless
from hystmpc.trials.errors import ConfigError, ModelError

SCALE = Scale(0.0, 6.0, 20.0, 90.0, 20.0, 60.0, 0.04)


@dataclass(frozen=True)
class Kink(Memoryless):
    """A second slope beyond a point."""

    rise: Annotated[float, Number("1", -1.0, 1.0, 0.0, "change of the slope")]
    at: Annotated[float, Number("in", -1e3, 1e3, 1.0, "where it changes")]
    name: ClassVar[str] = "test_kink"

    def curve(self, u: Any, p: Any) -> Any:
        """Straight, with another slope from `at` on."""
        return u + p[0] * (u - p[1]) * (u > p[1])


def forms(s: Scale) -> Sequence[Candidate]:
    free = (Freedom("rise", -0.5, 0.5, 0.05), Freedom("at", s.low, s.high, 0.1 * s.span))
    return [Candidate("test_kink", "command", "command", 20, (Kink(0.0, 1.0),), free, ((0.1, s.low + 0.5 * s.span),))]


EFFECT = Effect(
    operator=Kink,
    equation="y = u + rise (u - at)+",
    apart="From a curved gain: a corner.",
    neutral={"rise": 0.0},
    forms=forms,
    shown=({"rise": 0.3, "at": 3.0},),
)


@pytest.fixture
def added(monkeypatch: pytest.MonkeyPatch) -> Effect:
    monkeypatch.setattr(catalogue, "_added", {})
    return add_effect(EFFECT)


def test_it_stands_behind_those_that_ship(added: Effect) -> None:
    assert list(EFFECTS)[-1] == diagnosable()[-1] == added.name
    assert added.name in {candidate.effect for candidate in candidates(SCALE, ())}


def test_without_it_the_library_is_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(catalogue, "_added", {})
    assert "test_kink" not in EFFECTS
    with pytest.raises(ModelError, match="no effect 'test_kink'"):
        effect_operator("test_kink", {"rise": 0.1, "at": 1.0})


def test_a_simulator_file_holds_it(added: Effect, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = hystmpc.load_model("builtin:backlash").simulator
    kink = effect_operator(added.name, {"rise": 0.3, "at": 2.0})
    file = replace(plain, chain=replace(plain.chain, before=(kink,))).save(tmp_path / "kinked.yaml")
    assert hystmpc.load_model(file).simulator.chain.before == (kink,)
    monkeypatch.setattr(catalogue, "_added", {})
    with pytest.raises(ModelError, match="no operator 'test_kink'"):
        hystmpc.load_model(file)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"neutral": {"rise": 0.5}}, "with its neutral values"),
        ({"neutral": {"risen": 0.0}}, "neutral names 'risen'"),
        ({"forms": lambda s: [replace(forms(s)[0], effect="kink")]}, "its effect is 'kink'"),
        ({"forms": lambda s: [replace(forms(s)[0], free=(Freedom("slope", 0, 1, 1),))]}, "free names 'slope'"),
        ({"forms": lambda s: [replace(forms(s)[0], free=(Freedom("at", 0, 1, 1),))]}, "expected one of rise"),
        ({"forms": lambda s: [replace(forms(s)[0], starts=((0.1,),))]}, "of 2 numbers each"),
        ({"operator": EFFECTS["lag"].operator}, "an operator of the library has this name"),
    ],
)
def test_one_that_contradicts_itself_is_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        add_effect(replace(EFFECT, **wrong))


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("tests_no_such_module:EFFECT", "no module"),
        (f"{__name__}:SCALE", "no Effect object 'SCALE'"),
        (f"{__name__}:EFFECT", ""),
    ],
)
def test_an_installed_package_may_offer_one(value: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = EntryPoint("kink", value, catalogue.GROUP)
    monkeypatch.setattr(
        "hystmpc.trials.from_outside.entry_points", lambda group: EntryPoints([entry]).select(group=group)
    )
    catalogue._installed.cache_clear()
    try:
        if message:
            with pytest.raises(ConfigError, match=message):
                list(EFFECTS)
        else:
            assert EFFECTS["test_kink"].operator.name == "test_kink"
    finally:
        catalogue._installed.cache_clear()
