"""No identification returns a model that a straight line would beat, nor one of signals that are read wrongly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import hystmpc
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest, Identified, identified
from hystmpc.trials.errors import FitError, LogError
from hystmpc.trials.trial import Trial

from ..trials.random_logs import Device, answer, wandering

DT = 0.04
RANDOM = np.random.default_rng(1)
COMMAND = wandering(RANDOM, 60.0, DT)
GOOD = Trial(DT * np.arange(COMMAND.size), COMMAND, answer(COMMAND, DT, Device(lag_s=0.1, play=0.3, noise=0.1), RANDOM))


def late(seconds: float) -> Trial:
    """The recording with an angle whose clock is late."""
    return replace(GOOD, angle=np.interp(GOOD.t - seconds, GOOD.t, GOOD.angle))


def with_codes() -> Trial:
    """The recording with three values missing."""
    angle = GOOD.angle.copy()
    angle[[100, 500, 900]] = -9999.0
    return replace(GOOD, angle=angle)


@pytest.mark.parametrize(
    ("trial", "error", "text"),
    [
        (late(3.0), FitError, "s later than the command was given"),
        (late(-3.0), LogError, "s earlier than the command was given"),
        (replace(GOOD, angle=GOOD.angle % 40), LogError, "wraps_at: 40"),
        (with_codes(), LogError, r"missing: \[-9999\]"),
        (replace(GOOD, t=GOOD.t / 86400), LogError, "time_unit: d"),
    ],
)
def test_a_fit_says_what_the_check_says(trial: Trial, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text) as raised:
        hystmpc.fit("backlash", trial)
    assert len(str(raised.value)) <= 300
    assert "turn the sign" not in str(raised.value)


def worse(found: Identified, by: float) -> Callable[..., Identified]:
    """An identification that ends with a model shifted by `by` deg."""
    assert found.simulator is not None
    core = found.simulator.chain.core
    shifted = replace(core, c_lo=core.c_lo + by, c_up=core.c_up + by)
    return lambda *_: replace(
        found, simulator=replace(found.simulator, chain=replace(found.simulator.chain, core=shifted))
    )


def test_a_model_that_a_line_would_beat_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    kind, request = kind_named("backlash"), FitRequest()
    found = identified(kind, [GOOD], request)
    monkeypatch.setattr(type(kind), "fit", worse(found, 4.0))
    with pytest.raises(FitError, match=r"errs by \S+ deg over these trials, a straight line by \S+ deg") as raised:
        identified(kind, [GOOD], request)
    assert len(str(raised.value)) <= 300
    assert identified(kind, [GOOD], replace(request, steps=3)).simulator is not None  # asked to stop early


def test_a_kind_of_model_of_the_laboratory_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hystmpc.models.kinds.catalogue._others", dict)
    with pytest.raises(FitError, match=r"no kind of model 'hb1', a part of the laboratory: pip install 'hystmpc\[pa"):
        kind_named("hb1")
    with pytest.raises(FitError, match=r"no kind of model 'pj', .*pi"):
        kind_named("pj")
