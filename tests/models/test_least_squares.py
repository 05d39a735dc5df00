"""Laws of least squares in boxes: a linear problem takes one step, and no bound ends a descent that it allows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from hystmpc.models.identify.least_squares import minimise_in_boxes
from hystmpc.trials.types import Mat, Vec

SEEDS = st.integers(0, 10_000)


def products_of(residuals: Vec, jacobian: Mat) -> Mat:
    """Products of the columns of (J, r)."""
    both = np.column_stack([jacobian, residuals])
    return np.asarray(both.T @ both)


class Counted:
    """Products of a function of the unknowns, with the points at which they were asked for."""

    def __init__(self, residuals: object, jacobian: object) -> None:
        self._residuals, self._jacobian, self.points = residuals, jacobian, list[Vec]()

    def __call__(self, q: Vec) -> Mat:
        self.points.append(q)
        return products_of(self._residuals(q), self._jacobian(q))  # type: ignore[operator]


@given(SEEDS, st.integers(1, 40), st.floats(0.0, 4.0))
def test_a_linear_problem_takes_one_step_whatever_bounds_it_touches(seed: int, size: int, decades: float) -> None:
    """Also where directions are nearly flat: here over up to eight decades of curvature."""
    random = np.random.default_rng(seed)
    matrix = random.standard_normal((size + 20, size)) * np.geomspace(1.0, 10.0**-decades, size)
    target = random.standard_normal(size + 20)
    bounds = random.uniform(-1.0, 0.0, size), random.uniform(0.0, 1.0, size)
    problem = Counted(lambda q: matrix @ q - target, lambda q: matrix)
    found = minimise_in_boxes(problem, np.zeros(size), bounds, np.full(size, np.inf), 10, 1e-9)
    exact = lsq_linear(matrix, target, bounds, method="bvls", tol=1e-14)
    assert float(np.sum((matrix @ found - target) ** 2)) == pytest.approx(2.0 * exact.cost, rel=1e-6)
    assert len(problem.points) <= 3
    assert all(np.all((bounds[0] < q) & (q < bounds[1])) for q in problem.points)


@given(SEEDS)
def test_rounding_errors_stay_rounding_errors(seed: int) -> None:
    """A problem that is changed in its last digits has the same solution in all but its last digits."""
    random = np.random.default_rng(seed)
    matrix, target = random.standard_normal((60, 30)), random.standard_normal(60)
    bounds, units = (np.full(30, -0.02), np.full(30, 0.03)), np.full(30, np.inf)
    ends = [
        minimise_in_boxes(
            lambda q, factor=factor: products_of(factor * (matrix @ q - target), factor * matrix),  # type: ignore[misc]
            np.zeros(30),
            bounds,
            units,
            10,
            1e-9,
        )
        for factor in (1.0, 1.0 + 1e-13)
    ]
    np.testing.assert_allclose(*ends, rtol=0.0, atol=1e-11)


@given(SEEDS)
def test_no_step_is_longer_than_the_box_and_no_point_outside_the_bounds(seed: int) -> None:
    """The first step is below the units; bounds are not touched, since derivatives there are one-sided."""
    random = np.random.default_rng(seed)
    lower, upper = np.array([-1.5, -1.0]), np.array([random.uniform(0.1, 2.0), 3.0])
    units = np.array([0.3, 0.4])
    valley = Counted(
        lambda q: np.array([10.0 * (q[1] - q[0] ** 2), 1.0 - q[0]]),
        lambda q: np.array([[-20.0 * q[0], 10.0], [-1.0, 0.0]]),
    )
    end = minimise_in_boxes(valley, np.array([-1.2, 1.0]), (lower, upper), units, 200, 1e-12)
    assert np.all(np.abs(valley.points[1] - valley.points[0]) <= units)
    assert all(np.all((lower < q) & (q < upper)) for q in valley.points)
    best = min(upper[0], 1.0)  # of the valley's two unknowns the first; the second is its square
    np.testing.assert_allclose(end, [best, best**2], atol=1e-3)


def test_a_point_that_is_not_finite_is_left() -> None:
    """A free run may diverge; the step is tried again in a smaller box."""
    root = Counted(
        lambda q: np.array([q[0] - 1.0 if q[0] < 2.0 else np.nan]), lambda q: np.array([[0.2 if q[0] < 0.5 else 1.0]])
    )
    end = minimise_in_boxes(root, np.zeros(1), (np.array([-9.0]), np.array([9.0])), np.full(1, 40.0), 50, 1e-12)
    assert any(q[0] > 2.0 for q in root.points)
    assert end[0] == pytest.approx(1.0, abs=1e-6)


def test_a_start_that_is_not_finite_is_returned() -> None:
    nowhere = Counted(lambda q: np.array([np.nan]), lambda q: np.ones((1, 1)))
    end = minimise_in_boxes(nowhere, np.zeros(1), (-np.ones(1), np.ones(1)), np.ones(1), 50, 1e-12)
    assert end[0] == 0.0
    assert len(nowhere.points) == 1


def test_an_unknown_that_is_linear_only_near_the_start_is_still_improved() -> None:
    """The error falls up to 0.1 and rises ten times as steeply behind it, where a linear step goes."""

    kinked = Counted(
        lambda q: np.array([1.0 - 5.0 * min(q[0], 0.1) + 50.0 * max(q[0] - 0.1, 0.0)]),
        lambda q: np.array([[-5.0 if q[0] < 0.1 else 50.0]]),
    )
    ends = np.array([-9.0]), np.array([9.0])
    end = minimise_in_boxes(kinked, np.zeros(1), ends, np.full(1, np.inf), 40, 1e-6)
    assert end[0] == pytest.approx(0.1, abs=0.02)


@given(SEEDS, st.integers(2, 8))
def test_a_search_goes_on_along_a_kink(seed: int, size: int) -> None:
    """A linearisation on either side leads across the kink, where the error rises; its least value lies along it."""
    random = np.random.default_rng(seed)
    normal = random.standard_normal(size)
    normal /= np.linalg.norm(normal)
    along = random.standard_normal(size)
    target = 3.0 * (along - (along @ normal) * normal)  # on the kink
    problem = Counted(
        lambda q: np.array([1.0 + 8.0 * abs(normal @ q), *(q - target)]),
        lambda q: np.vstack([8.0 * (1.0 if normal @ q >= 0.0 else -1.0) * normal, np.eye(size)]),
    )
    ends = np.full(size, -40.0), np.full(size, 40.0)
    end = minimise_in_boxes(problem, 1e-6 * normal, ends, np.full(size, 1.0), 100, 1e-12)
    assert float(problem(end)[-1, -1]) < 1.0 + 0.02 * float(target @ target)  # 1 at the target
