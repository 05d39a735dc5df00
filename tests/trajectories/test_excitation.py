"""The papers' commands, at points worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.trajectories import excitation as ex
from hystmpc.trajectories import sample
from hystmpc.trajectories.excitation import DecayingSine, RampHold, RampHoldDraw
from hystmpc.trials.errors import TrajectoryError
from hystmpc_lab import paper_commands

S2_HZ = [f for group in paper_commands.S2_FREQUENCIES_HZ.values() for f in group]
OFFSETS = list(ex.S2_OFFSETS)


@pytest.mark.parametrize("f", paper_commands.S1_TRAIN_HZ)
def test_s1_training_at_quarter_periods(f: float) -> None:
    zero, raised = ex.s1_zero_baseline(f), ex.s1_raised_baseline(f)
    quarter, half = 0.25 / f, 0.5 / f
    assert zero(quarter) == pytest.approx(1.5 * math.exp(-0.15 * quarter))  # sin = 0
    assert zero(half) == pytest.approx(3.0 * math.exp(-0.15 * half))  # sin = 1
    assert zero(2 * half) == pytest.approx(0.0, abs=1e-12)  # sin = -1: zero baseline
    assert raised(quarter) == pytest.approx(1.5)
    assert raised(half) == pytest.approx(1.5 * math.exp(-0.15 * half) + 1.5)
    assert raised(2 * half) == pytest.approx(1.5 - 1.5 * math.exp(-0.15 * 2 * half))


def test_s1_training_set_has_the_papers_size_and_range() -> None:
    groups = [make(f) for make in (ex.s1_zero_baseline, ex.s1_raised_baseline) for f in paper_commands.S1_TRAIN_HZ]
    assert sum(sample(group, 250.0)[0].size for group in groups) == pytest.approx(26798, abs=10)
    for group in groups:
        assert sample(group, 250.0)[1].min() >= 0
        assert sample(group, 250.0)[1].max() <= 3


def test_s1_test_a() -> None:
    assert paper_commands.s1_test_a()(0.5 / 0.7) == pytest.approx(3.0 * math.exp(-0.12 * 0.5 / 0.7))


def test_s1_test_b_phase_is_of_the_product() -> None:
    # At t = 1 s the phase is 2 pi (0.7 - 0.1) 1 - pi/2 = 0.7 pi; at 2 s 2 pi (0.7 - 0.2) 2 - pi/2: a minimum.
    signal = paper_commands.s1_test_b()
    assert signal(1.0) == pytest.approx(0.9 * math.exp(-0.1) * (math.sin(0.7 * math.pi) + 1) + 1.2)
    assert signal(2.0) == pytest.approx(1.2)
    assert signal(0.0) == pytest.approx(1.2)


def test_s1_test_b_ends_where_the_chirp_stands_still() -> None:
    signal = paper_commands.s1_test_b()
    phase = 2 * math.pi * (0.7 - 0.1 * signal.duration_s) * signal.duration_s
    later = 2 * math.pi * (0.7 - 0.1 * (signal.duration_s + 1e-4)) * (signal.duration_s + 1e-4)
    assert phase > later
    assert phase == pytest.approx(later, abs=1e-6)


def test_s1_test_c_ascends_unless_the_printed_sign_is_asked_for() -> None:
    # At t = 2 s the phase is 2 pi (0.3 + 0.3) 2 - pi/2 = 1.9 pi.
    shape = 0.6 * (math.sin(1.9 * math.pi) + 1)
    assert paper_commands.s1_test_c()(2.0) == pytest.approx(shape * math.exp(0.1))
    assert paper_commands.s1_test_c(decay_per_s=0.05)(2.0) == pytest.approx(shape * math.exp(-0.1))


def test_s1_test_d_is_seeded_and_in_range() -> None:
    signal = paper_commands.S1_ARBITRARY(3)
    assert signal == paper_commands.S1_ARBITRARY(3)
    assert signal != paper_commands.S1_ARBITRARY(4)
    values = sample(signal, 100.0)[1]
    assert 0 <= values.min() <= values.max() <= 3


@pytest.mark.parametrize("f", S2_HZ)
@pytest.mark.parametrize("offset", OFFSETS)
def test_s2_sinusoids(f: float, offset: ex.Offset) -> None:
    signal = ex.s2_sinusoid(f, offset)
    assert signal(0.0) == 0
    assert signal.duration_s == pytest.approx(7 / f)
    _, u = sample(signal, 1000.0)
    assert u.min() >= -1e-12
    assert u.max() <= 6 + 1e-12

    def swing(cycle: int) -> float:
        """Distance of the half-period point from the cycle's own start, decay taken out by the law below."""
        start, middle = cycle / f, (cycle + 0.5) / f
        a, b = ex.S2_OFFSETS[offset]
        low = 3 * 7 ** (-cycle / 6) * (a - 1) + 3 * b
        high = 3 * 7 ** (-(cycle + 0.5) / 6) * (a + 1) + 3 * b
        assert signal(start) == pytest.approx(low, abs=1e-9)
        assert signal(middle) == pytest.approx(high, abs=1e-9)
        return high - low

    # After six cycles the amplitude is one seventh, whatever the frequency and offset.
    assert swing(6) / swing(0) == pytest.approx(1 / 7, rel=1e-9)


def test_s2_offsets_fix_what_their_names_say() -> None:
    f, cycles = 0.2, np.arange(7)
    lows, highs = cycles / f, (cycles + 0.5) / f
    np.testing.assert_allclose(ex.s2_sinusoid(f, "0BL")(lows), 0.0, atol=1e-12)
    np.testing.assert_allclose(ex.s2_sinusoid(f, "MidBL")((cycles + 0.25) / f), 3.0, atol=1e-12)
    np.testing.assert_allclose(ex.s2_sinusoid(f, "EndBL")(highs), 6.0, atol=1e-12)


def test_s2_decay_as_tabled() -> None:
    for f, tau, duration in ((0.1, 0.0324, 70), (0.5, 0.162, 14)):
        signal = ex.s2_sinusoid(f, "0BL")
        assert signal.decay_per_s == pytest.approx(tau, abs=5e-4)
        assert signal.duration_s == pytest.approx(duration)


def test_s2_has_21_sinusoids() -> None:
    assert len(set(S2_HZ)) * len(OFFSETS) == 21


@given(seed=st.integers(0, 2**32), split=st.sampled_from(["train", "test"]))
def test_s2_point_to_point_draws(seed: int, split: ex.Split) -> None:
    signal = ex.s2_point_to_point(seed, split)
    jumps = np.abs(np.diff((0.0, *signal.targets)))
    assert len(signal.targets) == len(signal.holds_s) == 10
    assert 0 <= min(signal.targets) <= max(signal.targets) <= 6
    assert 0.5 <= min(signal.rates) <= max(signal.rates) <= 6
    assert 1 <= min(signal.holds_s) <= max(signal.holds_s) <= (5 if split == "train" else 10)
    assert split == "test" or (jumps.min() > 0.5 and jumps.max() < 3)
    assert signal.duration_s == pytest.approx(float(np.sum(jumps / signal.rates) + np.sum(signal.holds_s)))
    assert signal == ex.s2_point_to_point(seed, split)


def test_s2_test_draws_use_the_freedom_they_have() -> None:
    signals = [ex.s2_point_to_point(seed, "test") for seed in range(20)]
    assert max(max(s.holds_s) for s in signals) > 9
    assert max(np.abs(np.diff((0.0, *s.targets))).max() for s in signals) > 4


def test_ramps_have_their_rates_and_holds_hold() -> None:
    signal = RampHold(0.0, [2.0, 2.0, 1.0], [4.0, 1.0, 0.5], [1.0, 0.5, 1.0])
    assert signal.duration_s == pytest.approx(0.5 + 1.0 + 0.5 + 2.0 + 1.0)
    np.testing.assert_allclose(signal([0.25, 0.5, 1.2, 1.9, 3.0, 4.5]), [1.0, 2.0, 2.0, 2.0, 1.5, 1.0])
    assert np.ptp(signal(np.linspace(0.6, 1.9, 50))) == 0


def test_initialisation_flexes_once_to_the_full_travel() -> None:
    signal = ex.s2_initialisation()
    np.testing.assert_allclose(signal([0.0, 2.5, 5.0, 10.0]), [0.0, 3.0, 6.0, 0.0], atol=1e-12)


def test_unknown_names_are_answered_with_the_nearest() -> None:
    with pytest.raises(TrajectoryError, match="did you mean 'MidBL'"):
        ex.s2_sinusoid(0.1, "midBL")  # type: ignore[arg-type]
    with pytest.raises(TrajectoryError, match="did you mean 'train'"):
        ex.s2_point_to_point(0, "trian")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: DecayingSine(0.0, 1.0, 0.1, 1.0), "amplitude: .*got 0.0"),
        (lambda: DecayingSine(1.0, 1.0, math.nan, 1.0), "decay_per_s: .*got nan"),
        (lambda: ex.s2_sinusoid(0.0, "0BL"), "frequency_hz: got 0.0"),
        (lambda: RampHold(0, [1], [1, 2], [1]), "1 targets, 2 rates and 1 holds"),
        (lambda: RampHold(0, [1], [0], [1]), r"rates\.0: .*got 0"),
        (lambda: RampHold(0, [0], [1], [0]), "motion of no duration"),
        (lambda: RampHoldDraw(0, (0, 1), (1, 2), (1, 2)), "moves: .*got 0"),
        (lambda: RampHoldDraw(1, (1, 0), (1, 2), (1, 2)), r"targets: expected lower <= upper, got \[?\(?1"),
        (lambda: RampHoldDraw(1, (0, 1), (1, 2), (-1, 2)), r"holds_s\.0: .*got -1"),
        (lambda: RampHoldDraw(1, (0, 1), (1, 2), (1, 2), steps=(2, 3))(0), "wider step window"),
    ],
)
def test_impossible_commands_are_refused(make: object, said: str) -> None:
    with pytest.raises(TrajectoryError, match=said):
        make()  # type: ignore[operator]
