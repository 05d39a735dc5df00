"""Normal numbers of the engine are those of NumPy's counter-based generator, to the last bit."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.core.library import engine

WORD = 2**64
TAIL = 3.6541528853610088  # where the lowest layer of the ziggurat ends


def ours(seed: int, step: int, count: int) -> np.ndarray:
    words, numbers = np.array([seed % WORD, seed // WORD, step], dtype=np.uint64), np.empty(count)
    engine().normal_numbers(words.ctypes.data, count, numbers)
    return numbers


def numpys(seed: int, step: int, count: int) -> np.ndarray:
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, step, 0])).standard_normal(count)


@given(seed=st.integers(0, WORD**2 - 1), step=st.integers(0, 2**63 - 1), count=st.integers(0, 2000))
def test_any_seed_and_step_give_numpys_numbers(seed: int, step: int, count: int) -> None:
    np.testing.assert_array_equal(ours(seed, step, count), numpys(seed, step, count))


def test_a_million_numbers_in_every_layer_and_in_the_tail_are_numpys() -> None:
    numbers = ours(2026, 3, 1_000_000)
    np.testing.assert_array_equal(numbers, numpys(2026, 3, 1_000_000))
    assert 150 < np.sum(np.abs(numbers) > TAIL) < 400  # 258 are expected


def test_a_sequence_begins_the_same_whatever_its_length() -> None:
    np.testing.assert_array_equal(ours(5, 6, 1000)[:37], ours(5, 6, 37))
