"""No exception of any part leaves the loop: it is the cause of a safe stop, it is in the log, the device is at rest."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.rig.experiment.phases import Decision, Past, Phase, PhaseInput
from hystmpc.rig.recording.sample import Sample
from hystmpc.rig.transports.transport import Reading

from .bench_parts import DT, LIMITS, NS, ListSink, Rig, following, travel

STEP = LIMITS.rate * DT


class OddError(Exception):
    """Of a part under test."""


@dataclass
class Failing:
    """A part, one method of which raises at some of its calls."""

    part: Any
    method: str
    when: Callable[[int], bool]
    calls: int = 0
    raised: int = 0

    def __getattr__(self, name: str) -> Any:
        found = getattr(self.part, name)
        return self._called(found) if name == self.method else found

    def __setattr__(self, name: str, value: Any) -> None:
        if name in Failing.__dataclass_fields__:
            object.__setattr__(self, name, value)
        else:
            setattr(self.part, name, value)

    def _called(self, found: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: Any, **named: Any) -> Any:
            self.calls += 1
            if self.when(self.calls):
                self.raised += 1
                raise OddError(f"{self.method}\nfails")
            return found(*given, **named)

        return call


PARTS = [
    ("intake", "judge"),
    ("anchor", "judge"),
    ("anchor", "in_time"),
    ("anchor", "sent"),
    ("gate", "admissible"),
    ("gate", "sent"),
    ("clock", "now_ns"),
    ("clock", "boot_ns"),
    ("clock", "wall_ns"),
    ("clock", "wait_until"),
]
BORNE = [("transport", "read"), ("transport", "write"), ("transport", "greet"), ("sink", "put")]


def failing_rig(part: str, method: str, when: Callable[[int], bool], held: float = 0.0) -> tuple[Rig, Failing]:
    rig = Rig(following, held=held, watchdog=True)
    failing = Failing(getattr(rig, part), method, when)
    setattr(rig, part, failing)
    return rig, failing


@given(of=st.sampled_from(PARTS), at=st.integers(2, 120))
@settings(max_examples=120)
def test_what_a_part_raises_once_is_the_cause_of_a_safe_stop(of: tuple[str, str], at: int) -> None:
    """At any call, from the preparation of the first sample to the way back."""
    rig, failing = failing_rig(*of, lambda k: k == at)
    outcome = rig.run([travel()])
    if not failing.raised:  # it is called less often
        assert outcome.cause == ""
        return
    assert f"OddError: {of[1]} fails" in outcome.cause
    moved = [abs(b - a) for a, b in zip([0.0, *rig.transport.sent], rig.transport.sent, strict=False)]
    assert max(moved, default=0.0) <= STEP + 1e-9
    assert rig.transport.rest() == 0.0
    if rig.transport.sent:
        assert rig.transport.sent[-1] == 0.0
        assert rig.transport.stopped == 1
        assert any("OddError" in sample.status for sample in rig.sink.samples)


@given(of=st.sampled_from(BORNE), at=st.sets(st.integers(1, 150), max_size=3))
@settings(max_examples=60)
def test_a_wire_and_a_recording_may_fail_now_and_then(of: tuple[str, str], at: set[int]) -> None:
    rig, _ = failing_rig(*of, lambda k: k in at)
    assert rig.run([travel()]).cause == ""
    assert rig.transport.held == 0.0


@pytest.mark.parametrize("of", PARTS[:5], ids=str)
@pytest.mark.parametrize("since", [1, 40])
def test_a_part_that_raises_for_good_ends_the_run(of: tuple[str, str], since: int) -> None:
    """Angles that cannot be judged let the device be led home; without a gate or an anchor nothing is sent."""
    rig, failing = failing_rig(*of, lambda k: k >= since)
    outcome = rig.run([travel(hold_s=5.0)])
    assert "OddError" in outcome.cause
    assert outcome.samples < 200
    assert failing.raised
    if of == ("intake", "judge") and since > 1:
        assert rig.transport.sent[-1] == 0.0
        assert math.isfinite(outcome.safe_s)
    assert rig.transport.rest() == 0.0


ODD: list[dict[str, Any]] = [
    {"listens": np.array([True, False])},
    {"angle_deg": "30"},
    {"angle_deg": None},
    {"angle_deg": np.zeros(2)},
    {"held": None},
    {"held": "0"},
    {"held": np.zeros(3)},
    {"sequence": None},
    {"sequence": 1.5},
    {"sequence": np.zeros(2)},
    {"session": [1]},
    {"sent_ns": "now"},
    {"received_ns": None},
    {"received_ns": np.zeros(2)},
]


@pytest.mark.parametrize("odd", ODD, ids=lambda odd: "-".join(f"{k} {type(v).__name__}" for k, v in odd.items()))
@pytest.mark.parametrize("for_good", [False, True])
def test_a_reading_may_hold_anything(odd: dict[str, Any], for_good: bool) -> None:
    """In this process nobody has looked at it before; once, or in every sample from then on."""
    rig = Rig(following)
    read, count = rig.transport.read, 0

    def spoilt() -> Reading | None:
        nonlocal count
        found = read()
        if found is None:
            return None
        count += 1
        return replace(found, **odd) if count == 40 or (for_good and count > 40) else found

    rig.transport.read = spoilt  # type: ignore[method-assign]
    outcome = rig.run([travel(hold_s=5.0)])
    assert rig.transport.sent[-1] == 0.0
    assert math.isfinite(outcome.safe_s) or outcome.cause == ""
    if for_good:
        assert outcome.cause
        assert outcome.stop_s < 40 * DT + 1.5


@dataclass
class Saying(Phase):
    """A phase that answers with something odd."""

    says: Any
    name: str = "saying"
    steps: int = field(default=0)

    def begin(self, now: PhaseInput, past: Past) -> None:
        del now, past

    def step(self, now: PhaseInput) -> Any:
        self.steps += 1
        return Decision(now.held + 0.1, "saying") if self.steps < 10 else self.says


@pytest.mark.parametrize("says", [None, "up", Decision(None, "x"), Decision("3", ""), Decision(np.zeros(2), "x")])  # type: ignore[arg-type]
def test_a_phase_may_answer_anything(says: Any) -> None:
    rig = Rig(following)
    outcome = rig.run([Saying(says)])
    assert rig.transport.sent[-1] == 0.0
    assert outcome.cause


def test_the_sample_that_failed_is_in_the_log_and_counted() -> None:
    rig, _ = failing_rig("gate", "admissible", lambda k: k == 20)
    outcome = rig.run([travel()])
    assert outcome.faults["sample-failed"] == 1
    failed = [s for s in rig.sink.samples if "sample-failed" in s.faults]
    assert [s.status for s in failed] == ["OddError: admissible fails"]
    assert [s.sequence for s in rig.sink.samples] == list(range(rig.sink.samples[0].sequence, outcome.samples))
    assert outcome.stop_s == pytest.approx(failed[0].t_s + 2 * DT, abs=2 * DT)


def test_a_sink_that_always_raises_moves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: ListSink, sample: Sample) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(ListSink, "put", full)
    rig = Rig(following)
    outcome = rig.run([travel()])
    assert (outcome.cause, outcome.refused) == ("", outcome.samples)
    assert rig.clock.ns < 60 * NS


def test_a_command_that_may_have_left_is_asked_for() -> None:
    """The books say nothing of it: the next one is measured from what the device says, not from the one before."""
    rig, failing = failing_rig("gate", "sent", lambda k: k == 20)
    outcome = rig.run([travel()])
    assert failing.raised == 1
    failed = next(k for k, s in enumerate(rig.sink.samples) if "sample-failed" in s.faults)
    assert [s.source for s in rig.sink.samples[failed : failed + 2]] == ["wait", "wait"]
    assert "held-unknown" in rig.sink.samples[failed + 1].faults
    assert outcome.confirmed
