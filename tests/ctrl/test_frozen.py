"""`replace` of states that change in every step."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.ctrl.command import replace


@dataclasses.dataclass(frozen=True)
class State:
    """A state as those of controllers and monitors are."""

    failures: int = 0
    stopped: bool = False
    cause: str = ""


CHANGES = st.fixed_dictionaries({}, optional={"failures": st.integers(), "stopped": st.booleans(), "cause": st.text()})


@given(first=CHANGES, second=CHANGES)
def test_it_is_that_of_the_standard_library(first: dict[str, Any], second: dict[str, Any]) -> None:
    old = State(**first)
    before = dict(vars(old))
    new = replace(old, **second)
    assert type(new) is State
    assert vars(new) == vars(dataclasses.replace(old, **second))
    assert vars(old) == before


def test_a_field_that_does_not_exist_is_refused() -> None:
    with pytest.raises(TypeError, match="failure"):
        replace(State(), failure=1)  # type: ignore[call-arg]


def test_the_answer_is_frozen_too() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        replace(State(), failures=1).failures = 2  # type: ignore[misc]
