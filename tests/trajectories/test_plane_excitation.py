"""Laws of the commands of both axes by which a device of two axes is identified."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.trajectories.excitation import LEFT_OUT, plane_identification_motions
from hystmpc.trials.errors import TrajectoryError

SIZE = st.floats(0.1, 20.0)


@given(strokes=st.tuples(SIZE, SIZE), rates=st.tuples(SIZE, SIZE), share=st.floats(0.1, 1.0), seed=st.integers(0, 99))
@settings(max_examples=20, deadline=None)
def test_commands_stay_within_strokes_and_below_the_rates_of_both_axes(
    strokes: tuple[float, float], rates: tuple[float, float], share: float, seed: int
) -> None:
    """Both axes move in every motion; the last one is that which is left out of an identification."""
    names = list[str]()
    for name, motion in plane_identification_motions(strokes, rates, np.random.default_rng(seed), share):
        names.append(name)
        t = np.linspace(0.0, motion.duration_s, 2000)
        u = motion(t)
        assert np.all(u >= -1e-9)
        assert np.all(u <= np.array(strokes) * (1 + 1e-9))
        speed = np.abs(np.diff(u, axis=0)).max(axis=0) / (t[1] - t[0])
        assert np.all(speed <= 0.85 * np.array(rates))
        assert motion.duration_s <= max(40.0 * share, 8.0)
    assert len(set(names)) == len(names) == 5
    assert names[-1] == LEFT_OUT


def test_directions_and_speeds_of_both_axes_cross() -> None:
    """In reversals at random all four pairs of signs occur, and each axis is the faster one at times."""
    random = np.random.default_rng(1)
    motions = dict(plane_identification_motions((6.0, 6.0), (8.0, 8.0), random))
    motion = motions["reversals_xy"]
    v = np.diff(motion(np.arange(0.0, motion.duration_s, 0.04)), axis=0)
    moving = v[np.all(np.abs(v) > 1e-9, axis=1)]
    assert len({tuple(row) for row in np.sign(moving).tolist()}) == 4
    faster = np.mean(np.abs(moving[:, 0]) > np.abs(moving[:, 1]))
    assert 0.25 < faster < 0.75


def test_a_stroke_that_is_none_is_refused() -> None:
    with pytest.raises(TrajectoryError, match="stroke"):
        list(plane_identification_motions((0.0, 6.0), (8.0, 8.0), np.random.default_rng(1)))
