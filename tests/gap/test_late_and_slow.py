"""Delays of nearly a second, and creep of many time constants at once, are named as what they are."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import fftconvolve

from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.gap.diagnosis import Diagnosis
from hystmpc.models.chain import Chain
from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.models.effects.effect import Scale
from hystmpc.models.operators.dynamics import Delay
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..models.zoo import BACKLASH
from .engine_examples import DT, moves, simulator_of, sine, trials_of

COMMANDS = [moves(1, 24.0, 4.0), moves(2, 24.0), sine(0.2, 24.0), moves(3, 24.0, 4.0), moves(4, 24.0, 2.0)]


def log_law(signal: Vec, onset_s: float) -> Vec:
    """Part that a log-law solid adds to a signal (T,): log10(1 + t / onset) for a unit step."""
    kernel = np.log10(1 + DT * np.arange(signal.size) / onset_s)
    return np.asarray(fftconvolve(np.diff(signal, prepend=signal[0]), kernel)[: signal.size])


def diagnosed(trials: list[Trial], *only: str) -> Diagnosis:
    return conclude(find_causes(trials, simulator_of(BACKLASH), only=only))[0]


@pytest.mark.parametrize("delay_s", [0.3, 0.8])
def test_a_delay_is_identified_up_to_a_second(delay_s: float) -> None:
    trials = trials_of(Chain(BACKLASH, before=(Delay.at_rate(delay_s, DT),)), COMMANDS)
    found = diagnosed(trials, "delay", "lag", "rate_dependence")
    assert [effect.name for effect in found.effects] == ["delay"]
    assert found.effects[0].parameters["delay_s"] == pytest.approx(delay_s, abs=0.01)


@pytest.mark.parametrize("share", [0.08, -0.08])
def test_creep_of_the_log_law_is_creep_alone(share: float) -> None:
    plain = trials_of(Chain(BACKLASH), COMMANDS)
    trials = [Trial(t.t, t.command, t.angle - share * log_law(t.angle, 0.4), source=t.source) for t in plain]
    found = diagnosed(trials, "creep", "rate_dependence", "lag", "drift", "slack")
    assert [effect.name for effect in found.effects] == ["creep"]
    assert found.gap.closed_share > 0.95


def test_two_terms_follow_the_log_law_far_closer_than_one() -> None:
    t = np.arange(DT, 60.0, DT)
    wanted, times = np.log10(1 + t / 0.4), np.geomspace(0.5, 180.0, 40)

    def left(terms: int) -> float:
        errors = []
        for k, tau in enumerate(times):
            for other in times[k + 1 :] if terms == 2 else (tau,):
                columns = np.column_stack([1 - np.exp(-t / each) for each in {tau, other}])
                errors.append(float(np.std(wanted - columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0])))
        return min(errors) / float(np.ptp(wanted))

    assert left(2) < 0.02 < 0.05 < left(1)
    forms = EFFECTS["creep"].forms(Scale(0.0, 6.0, 22.0, 85.0, 60.0, 240.0, DT))
    assert {len(form.operators[0].values) for form in forms} == {2, 4}
