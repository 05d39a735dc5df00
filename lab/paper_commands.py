"""Commands of the papers beyond those of the recordings: frequencies, and the test signals of S1."""

from __future__ import annotations

from hystmpc.trajectories.excitation import S1_GROUP_S, DecayingSine, RampHoldDraw, s1_zero_baseline

S1_TRAIN_HZ = (0.2, 0.4, 0.6, 0.8)
# Not printed: the falling chirp of test (b) stands still at 3.5 s, the rising one of (c) has made its 3 loops then.
S1_CHIRP_S = 3.5
# Our stand-in for the unprinted "arbitrarily varying signal with plateaus" of test (d).
S1_ARBITRARY = RampHoldDraw(moves=8, targets=(0.0, 3.0), rates=(0.5, 3.0), holds_s=(0.5, 2.0), steps=(0.3, 3.0))
# The seven frequencies are inferred from file names and counts of files.
S2_FREQUENCIES_HZ = {"train": (0.1, 0.2, 0.4, 0.5), "validation": (0.3,), "test": (0.15, 0.45)}


def s1_test_a(duration_s: float = S1_GROUP_S) -> DecayingSine:
    """Command of S1 test (a): eq. (5) with f = 0.7, tau = 0.12."""
    return s1_zero_baseline(0.7, 0.12, duration_s)


def s1_test_b(duration_s: float = S1_CHIRP_S) -> DecayingSine:
    """Command of S1 test (b), eq. (10): p(t) = A e^(-tau t) ( sin(2 pi (f + c t) t - pi/2) + 1 ) + B [bar].

    A = 0.9, B = 1.2, f = 0.7, tau = 0.1, c = -0.1.
    """
    return DecayingSine(
        amplitude=0.9, frequency_hz=0.7, decay_per_s=0.1, duration_s=duration_s, baseline=1.2, chirp_hz_per_s=-0.1
    )


def s1_test_c(decay_per_s: float = -0.05, duration_s: float = S1_CHIRP_S) -> DecayingSine:
    """Command of S1 test (c), eq. (11): p(t) = A e^(-tau t) ( sin(2 pi (f + c t) t - pi/2) + 1 ) [bar].

    A = 0.6, f = 0.3, c = 0.15. S1 prints tau = 0.05 and calls the signal ascending, which it is with the sign
    turned; `decay_per_s=0.05` gives the printed one.
    """
    return DecayingSine(
        amplitude=0.6, frequency_hz=0.3, decay_per_s=decay_per_s, duration_s=duration_s, chirp_hz_per_s=0.15
    )
