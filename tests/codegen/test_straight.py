"""A table as straight-line C computes what its instructions say, to the last bit."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.codegen.amalgam import amalgam
from hystmpc.codegen.literals import table
from hystmpc.codegen.straight import shortened, straight
from hystmpc.core.chain import ChainCode
from hystmpc.models.stages import CODES, chain_code, function_program

from ..core.test_programs import BY_ONE, BY_TWO, DT, PARAMETERS, step_of
from ..core.test_vectors import two_axes
from ..models.zoo import CHAINS, EXAMPLES, WITH_EFFECTS
from .compiled import FAST, STRICT, compile_c

FILES = ("program", "chain", "slopes", "inverse")
SAMPLES = 75  # more than a block of an export has
OPERATIONS = [*BY_TWO, *BY_ONE]


def drawn_chains() -> list[tuple[ChainCode, np.ndarray]]:
    """Two stages of drawn operations each, every operation at least once; and one of all operations."""
    rng, chains = np.random.default_rng(11), []
    for k in range(13):
        names = [[*rng.permutation(OPERATIONS)[:14].tolist(), OPERATIONS[(3 * k + j) % 29]] for j in range(3)]
        names = names[:2] if k else [OPERATIONS]
        stages = [step_of([(name, *rng.integers(0, 30, 2).tolist()) for name in part]) for part in names]
        chains.append(
            (ChainCode([function_program(step) for step in stages]), rng.normal(0, 1, PARAMETERS * len(names)))
        )
    return chains


def all_chains() -> list[tuple[ChainCode, np.ndarray]]:
    """Every operator alone, chains, drawn ones; two commands with an input that is measured."""
    known = [[operator] for operator in EXAMPLES]
    known += [[*c.before, c.core, *c.after] for c in (*CHAINS.values(), WITH_EFFECTS)]
    given = [(chain_code(part), np.array([v for one in part for v in one.values])) for part in known]
    return [*given, *drawn_chains(), two_axes()]


class Both:
    """One library in which the same chain is interpreted, or straight: as an export has it, without instructions."""

    def __init__(self, folder: Path, chains: Sequence[ChainCode], single: bool, options: Sequence[str]) -> None:
        arrays = {f"a{k}": code.code.tolist() for k, code in enumerate(chains)}
        texts = [table(name, "int", map(str, shortened(words))) for name, words in arrays.items()]
        listed = "const int *const straight_chains[] = {" + ", ".join(arrays) + "};\n"
        macros = {"HYSTMPC_SINGLE": int(single), "HYSTMPC_BLOCK": 32, "HYSTMPC_STRAIGHT": 1}
        text = "\n".join(
            [
                *(f"#define {name} {value}" for name, value in macros.items()),
                amalgam(f"{name}.c" for name in FILES),
                *texts,
                straight(arrays),
                "extern const int *const straight_chains[];",
                listed,
            ]
        )
        (folder / "straight.c").write_text(text, encoding="utf-8")
        flags = ["-ffp-contract=off", "-fPIC", "-shared", "-o", "straight.so"]
        compile_c([*STRICT, *options, *flags, "straight.c", "-lm"], folder)
        self._library = ctypes.CDLL(str(folder / "straight.so"))
        self._chains = (ctypes.c_void_p * len(chains)).in_dll(self._library, "straight_chains")
        self._real: Any = ctypes.c_float if single else ctypes.c_double
        self.number = np.float32 if single else np.float64
        for name in ("chain_linearise_bytes", "chain_single_bytes", "chain_bytes"):
            getattr(self._library, f"hystmpc_{name}").restype = ctypes.c_long
        for name in ("chain_step", "chain_command_for"):
            getattr(self._library, f"hystmpc_{name}").restype = self._real

    def call(self, name: str, *words: Any) -> Any:
        """A function of the engine; whole numbers, numbers and arrays as they are."""
        made = [
            word.ctypes.data_as(ctypes.c_void_p)
            if isinstance(word, np.ndarray)
            else self._real(word)
            if isinstance(word, float)
            else word
            for word in words
        ]
        return getattr(self._library, f"hystmpc_{name}")(*made)

    def results(self, k: int, code: ChainCode, kept: np.ndarray, straightly: bool) -> list[np.ndarray]:
        """What a controller asks of a chain: roll-outs, a Jacobian; of one axis also single steps and the inverse."""
        copied = code.code.copy()
        chain = ctypes.c_void_p(self._chains[k]) if straightly else copied.ctypes.data_as(ctypes.c_void_p)
        rng, free = np.random.default_rng(k), code.inputs - code.scheduled
        x = rng.normal(0, 2, code.states).astype(self.number)
        known = rng.normal(0, 2, (code.scheduled, SAMPLES)).astype(self.number)
        scheduled = known if code.scheduled else None
        answers: list[np.ndarray] = []
        for rows in (1, 3, 11):
            plans = rng.normal(2, 2, (rows, free, SAMPLES)).astype(self.number)
            if rows == 3:
                plans[1, :, 20:] = [np.inf, -np.inf, np.nan][k % 3]
            y = np.empty((rows, code.outputs, SAMPLES), self.number)
            room = np.zeros(self.call("chain_bytes", chain, rows, 0), np.uint8)
            self.call("chain_roll_out", chain, kept, x, rows, SAMPLES, plans, scheduled, y, room)
            answers.append(y)
        y = np.empty((code.outputs, SAMPLES), self.number)
        by = np.empty((code.outputs, SAMPLES, free, SAMPLES), self.number)
        room = np.zeros(self.call("chain_linearise_bytes", chain, SAMPLES), np.uint8)
        self.call("chain_linearise", chain, kept, x, plans[0], scheduled, SAMPLES, y, by, room)
        if (code.inputs, code.outputs) == (1, 1):
            room = np.zeros(self.call("chain_single_bytes", chain), np.uint8)
            sought = [
                self.call("chain_command_for", chain, kept, x, w, -3.0, 9.0, 1.0, room) for w in (-9.0, 0.5, 30.0)
            ]
            seen = [self.call("chain_step", chain, kept, x, float(u), room) for u in plans[0, 0, :9]]
            answers.append(np.array([*sought, *seen]))
        return [*answers, y, by, x]


@pytest.mark.parametrize(
    ("single", "options"),
    [*(pytest.param(*case, marks=pytest.mark.slow) for case in ((False, FAST), (True, ("-O1",)))), (False, ("-O0",))],
    ids=["vectors", "float", "double"],
)
def test_a_table_in_c_is_its_instructions_to_the_last_bit(single: bool, options: Sequence[str], tmp_path: Path) -> None:
    chains = all_chains()
    both = Both(tmp_path, [code for code, _ in chains], single, options)
    moved = 0
    for k, (code, parameters) in enumerate(chains):
        kept = code.prepare(parameters.reshape(-1, 1), DT).astype(both.number)
        here, there = (both.results(k, code, kept, straightly) for straightly in (True, False))
        for one, other in zip(here, there, strict=True):
            np.testing.assert_array_equal(one, other)
        moved += any(np.ptp(one[np.isfinite(one)]) > 0 for one in here if np.isfinite(one).any())
    assert moved == len(chains)


def test_every_operation_is_written() -> None:
    text = straight({f"a{k}": code.code.tolist() for k, (code, _) in enumerate(all_chains())})
    missing = [name for name in CODES if f"hystmpc_op_{name}(" not in text]
    assert missing == []
