"""Blocks of chains with wrong numbers: refused in one line, and what is let through stays in its memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.core.chain import ChainCode, PreparedChain, StageProgram
from hystmpc.core.library import engine
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.stages import chain_code, operator_program

from ..models.zoo import CHAINS, EXAMPLES, RATE_PI, WITH_EFFECTS
from ..sanitized import said_under_sanitizers
from .test_vectors import two_axes

PROGRAM = Path(__file__).with_name("fuzzed_chains.c")
NEEDED = ("check", "program", "chain", "slopes", "rest", "settle", "inverse", "follow", "drive", "moves")
FILES = [f"{name}.c" for name in NEEDED]
BLOCKS = 3000
HEAD = 20
STATES, INPUTS, PARAMETERS, OUTPUTS, KEPT, ROWS, SLOPES, GROUPS, REGISTERS, SINGLE = range(1, 11)
ONCE, AHEAD, THROUGH = range(11, 14)
CODE: list[ChainCode] = [chain_code([*c.before, c.core, *c.after]) for c in (*CHAINS.values(), WITH_EFFECTS)]


def place_of(table: np.ndarray, what: str) -> int:
    """Where a part of a table begins."""
    lengths = 5 * table[ONCE:HEAD]
    code = HEAD + int(table[KEPT])
    slopes = code + int(lengths.sum())
    first = slopes + 3 * int(table[SLOPES])
    group = first + int(table[STATES] + table[OUTPUTS]) + 1
    places = {"keeps": HEAD, "once": code, "ahead": code + int(lengths[0]), "slopes": slopes, "first": first}
    return (places | {"through": code + int(lengths[:2].sum()), "group": group})[what]


def with_number(change: Callable[[np.ndarray], None], operator: Operator = RATE_PI) -> ChainCode:
    """The operator's chain with something changed in its table."""
    stage = operator_program(operator)
    table = stage.table.copy()
    change(table)
    return ChainCode([operator_program(Lag(0.1)), replace(stage, table=table)])


def put(what: str | int, further: int, value: int) -> Callable[[np.ndarray], None]:
    """A number at a place of a table."""

    def change(table: np.ndarray) -> None:
        table[further + (what if isinstance(what, int) else place_of(table, what))] = value

    return change


def onto_its_argument(table: np.ndarray) -> None:
    at = place_of(table, "through")
    table[at + 3] = table[at + 1]


def onto_the_state_before(table: np.ndarray) -> None:
    at = place_of(table, "ahead")
    table[at + 1] = table[KEPT] + table[STATES]
    table[at + 2] = table[KEPT]


WRONG: dict[str, tuple[Callable[[np.ndarray], None], str]] = {
    "a table of another form": (put(0, 0, 19), "counts from zero"),
    "fewer than no states": (put(STATES, 0, -1), "counts from zero"),
    "a million plays": (put(STATES, 0, 1 << 20), "counts from zero"),
    "more code than numbers": (put(THROUGH, 0, 100_000), "parts within the block"),
    "more rows than used": (put(ROWS, 0, 5000), "as many rows and registers"),
    "fewer registers than parameters": (put(REGISTERS, 0, 2), "as many rows and registers"),
    "fewer registers than states": (put(SINGLE, 0, 2), "as many rows and registers"),
    "an operation that is not there": (put("once", 0, 30), "operations of the list"),
    "a register that is not there": (put("once", 2, 1000), "rows and registers that are there"),
    "a row that is not there": (put("through", 4, -1), "rows and registers that are there"),
    "a kept value that is not there": (put("keeps", 0, 1000), "rows and registers that are there"),
    "a result onto a kept value": (put("through", 1, 0), "results apart from arguments"),
    "a result onto its argument": (onto_its_argument, "results apart from arguments"),
    "a whole row onto the one a sample before": (onto_the_state_before, "results apart from arguments"),
    "a slope by what is not there": (put("slopes", 0, 3), "slopes by what is there"),
    "a slope by a state that is not there": (put("slopes", 1, 77), "slopes by what is there"),
    "slopes that do not ascend": (put("first", 1, 10_000), "slopes by what is there"),
    "a state that is not there": (put("group", 1, 5), "every state in one group"),
    "a group of more than all states": (put("group", 0, 6), "every state in one group"),
    "states in no group": (put(GROUPS, 0, 0), "every state in one group"),
}


@pytest.mark.parametrize(("change", "line"), WRONG.values(), ids=WRONG)
def test_a_wrong_number_is_refused_in_one_line(change: Callable[[np.ndarray], None], line: str) -> None:
    with pytest.raises(ValueError, match=rf"^chain: got a stage 1 \(step\) without .*{line}[^\n]*$"):
        with_number(change)


WIRES: dict[str, tuple[Sequence[tuple[Sequence[int], Sequence[int]]], Sequence[int]]] = {
    "read before it is there": ([((2,), (1,)), ((1,), (2,))], [2]),
    "written twice": ([((0,), (1,)), ((0,), (1,))], [1]),
    "a command is written": ([((1,), (0,)), ((0,), (2,))], [2]),
    "shown and not there": ([((0,), (1,)), ((1,), (2,))], [3]),
    "shown and negative": ([((0,), (1,)), ((1,), (2,))], [-1]),
    "onto what it reads": ([((0,), (1,)), ((2,), (2,))], [2]),
}


@pytest.mark.parametrize(("wires", "shown"), WIRES.values(), ids=WIRES)
def test_signals_are_there_before_they_are_read(
    wires: Sequence[tuple[Sequence[int], Sequence[int]]], shown: Sequence[int]
) -> None:
    with pytest.raises(ValueError, match="without signals that are written once, before they are read"):
        ChainCode([operator_program(Lag(0.1)), operator_program(Delay(0.1, 4))], wires, shown)


def test_a_state_at_rest_is_that_of_its_operator() -> None:
    lag = operator_program(Lag(0.1))
    stage: StageProgram = replace(operator_program(RATE_PI), rest=lag.rest, rest_constants=lag.rest_constants)
    with pytest.raises(ValueError, match=r"got a stage 0 \(at rest\) without a state at rest of the same operator"):
        ChainCode([stage])


@given(code=st.sampled_from(CODE), at=st.integers(0), length=st.integers(0))
def test_a_block_that_ends_too_early_is_refused(code: ChainCode, at: int, length: int) -> None:
    """And one with fewer constants; nothing behind the end is read: an exact copy, under the sanitizers below."""
    check, size = engine().chain_check, at % code.code.size
    assert check(code.code, code.code.size, code.constants.size) == 0
    assert check(code.code[:size].copy(), size, code.constants.size) != 0
    if code.constants.size:
        assert check(code.code, code.code.size, length % code.constants.size) != 0


@pytest.mark.parametrize("at", [1, 2, 3], ids=["states", "parameters", "kept values"])
@pytest.mark.parametrize("more", [-1, 1])
def test_what_a_block_says_of_all_its_stages_is_their_sum(at: int, more: int) -> None:
    for code in CODE:
        numbers = code.code.copy()
        numbers[at] += more
        assert engine().chain_check(numbers, numbers.size, code.constants.size) != 0


def test_one_axis_is_asked_for_where_the_engine_reads_one() -> None:
    chain, p = two_axes()
    with pytest.raises(ValueError, match="got 3 inputs and 2 outputs, expected one of each"):
        PreparedChain(chain, p, 0.01)
    with pytest.raises(ValueError, match="got 3 inputs and 2 outputs, expected one of each"):
        chain.settle(np.zeros((chain.kept, 1)), 0, np.zeros(1), np.zeros(1), p, np.zeros((p.size, 0)))
    with pytest.raises(ValueError, match="got 3 parameters, expected"):
        PreparedChain(CODE[0], np.zeros(3), 0.01)


def test_a_derivative_may_begin_later_than_that_of_a_later_stage() -> None:
    """Directions add up: by the state of the second lag, and by a command that moves from sample 5 or 270 on."""
    code, samples = chain_code([Lag(0.08), Lag(0.1)]), 300
    kept, first = code.prepare(np.array([[0.08], [0.1]]), 0.04), np.array([0, 300], dtype=np.intc)
    u, seeds, x = np.sin(0.1 * np.arange(samples)), np.zeros((2, 3)), np.zeros((2, 1))
    for begin in (5, 270):
        du, m = np.zeros((samples, 3)), np.zeros((2, 1, 3))
        du[begin:, [0, 2]], m[1, 0, 1:] = 1.0, 0.7
        code.differentiate(kept, first, u, np.full((samples, 3), 9.0), np.ones((2, 3)), x, m)  # memory that is not zero
        _, dy = code.differentiate(kept, first, u, du, seeds, x, m)
        np.testing.assert_allclose(dy[:, 2], dy[:, 0] + dy[:, 1], rtol=0, atol=1e-14)


def write_seeds(path: Path) -> None:
    """Chains of the zoo, whole."""
    with path.open("wb") as file:
        for code in [*CODE, *(chain_code([operator]) for operator in EXAMPLES), two_axes()[0]]:
            if code.code.size < 3000:  # long ones take most of the time and are no different
                file.write(np.array([code.code.size, code.constants.size], dtype=np.intc).tobytes())
                file.write(code.code.tobytes() + code.constants.tobytes())


def test_what_the_check_lets_through_stays_in_its_memory(tmp_path: Path) -> None:
    write_seeds(tmp_path / "seeds")
    said = said_under_sanitizers(PROGRAM, FILES, [tmp_path / "seeds", 1, BLOCKS], tmp_path)
    tried, passed = (int(word) for word in said.split() if word.isdigit())
    assert tried == BLOCKS
    assert passed > BLOCKS // 50
