"""The engine's files stand in one: no two names meet, in both precisions, with the numbers of the library."""

from __future__ import annotations

import ctypes
import re
import shutil
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.codegen.amalgam import ONE_FILE, amalgam
from hystmpc.core.library import FOLDER, bound, engine
from hystmpc.models.load import load_model
from hystmpc.models.networks.packed import lstm_weights, pack_network
from hystmpc.models.stages import chain_code

from ..models.lstm_examples import random_weights
from .compiled import compile_c, compilers, tried

ALL = sorted(path.name for path in FOLDER.glob("*.c") if path.name != "loop.c")
"""All but the loop of a run, which needs an operating system: no export has it."""
WARNINGS = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Wstrict-prototypes"]
STRICT = ["-std=c99", *WARNINGS, "-Werror", "-Wno-unused-function", "-Wno-psabi"]
SHARED = ["-std=c99", "-O1", "-ffp-contract=off", "-fPIC", "-shared", "-DHYSTMPC_LOCAL=static"]
CHAIN = ("program.c", "chain.c", "slopes.c", "rest.c", "settle.c", "inverse.c")
every_compiler = pytest.mark.parametrize(
    "compiler",
    [
        pytest.param(command, id=f"{Path(command[0]).name} {k}", marks=[pytest.mark.slow] if k else [])
        for k, command in enumerate(compilers())
    ],
)
both_precisions = pytest.mark.parametrize(
    "single", [pytest.param(0, id="double"), pytest.param(1, id="single", marks=pytest.mark.slow)]
)


def slow(*values: object) -> Any:
    """Cases that the fast suite leaves to others of the same law."""
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Place of the one file, as an export has it and as a library."""
    place = tmp_path_factory.mktemp("one")
    (place / "export.c").write_text(ONE_FILE + amalgam(ALL), encoding="utf-8")
    (place / "library.c").write_text(amalgam(ALL), encoding="utf-8")
    return place


def library(folder: Path, names: tuple[str, ...], *options: str) -> ctypes.CDLL:
    """Some of the engine's files as one, compiled with these options."""
    place = folder / re.sub(r"\W", "_", "".join(options))
    place.mkdir()
    (place / "one.c").write_text(amalgam(names), encoding="utf-8")
    compile_c([*SHARED, *options, "one.c", "-o", "one.so", "-lm"], place)
    return ctypes.CDLL(str(place / "one.so"))


def functions(folder: Path, header: str, names: tuple[str, ...], *options: str) -> Any:
    """The functions of a header, from some of the engine's files as one."""
    loaded = library(folder, names, *options)
    place = Path(loaded._name).parent
    shutil.copy(FOLDER / header, place)
    return bound(loaded, place)


@cache
def chain() -> tuple[Any, np.ndarray, np.ndarray]:
    """A chain's numbers: its code, kept values, and a state."""
    model = load_model("builtin:auto")
    operators = model.simulator.chain.operators
    code = chain_code(operators)
    return code, code.prepare(model.simulator.chain.values[:, None].copy(), 0.02), model.at_rest(10.0, 0.2)


@every_compiler
@both_precisions
def test_all_files_are_one_without_a_warning(folder: Path, compiler: list[str], single: int) -> None:
    for main in ("export.c", "library.c"):
        assert tried([*compiler, *STRICT, f"-DHYSTMPC_SINGLE={single}", "-c", main], folder) == ""


@both_precisions
@pytest.mark.parametrize("lanes", [slow(1), slow(4), 8, slow(16)])
def test_networks_of_every_width_compile_without_a_warning(folder: Path, lanes: int, single: int) -> None:
    (folder / "network.c").write_text(amalgam(["network.c"]), encoding="utf-8")
    macros = [f"-DHYSTMPC_LANES={lanes}", f"-DHYSTMPC_SINGLE={single}"]
    compile_c([*STRICT, "-O1", *macros, "-c", "network.c"], folder)


def test_a_compiler_without_vectors_is_refused_in_plain_words(folder: Path) -> None:
    for lanes, words in ((8, "this compiler has no vectors of GNU C"), (3, "has to be 1, 4, 8 or 16")):
        flags = ["-std=c99", "-U__GNUC__", f"-DHYSTMPC_LANES={lanes}", "-fsyntax-only", "library.c"]
        assert words in tried([*compilers()[0], *flags], folder)


@pytest.mark.parametrize("name", ALL)
def test_macros_end_with_their_file(name: str) -> None:
    text = (FOLDER / name).read_text(encoding="utf-8")
    made = set(re.findall(r"^\s*#\s*define (\w+)", text, re.MULTILINE))
    ended = set(re.findall(r"^#undef (\w+)", text, re.MULTILINE))
    assert {macro for macro in made if not macro.startswith("HYSTMPC_")} == ended


def test_a_header_stands_in_front_of_its_first_use_alone() -> None:
    text = amalgam(ALL)
    assert '#include "' not in text
    for header in FOLDER.glob("*.h"):
        guard = re.findall(r"^#define (HYSTMPC_\w+_H)$", header.read_text(encoding="utf-8"), re.MULTILINE)
        assert len(guard) == 1
        assert text.count(f"#define {guard[0]}\n") <= 1


@pytest.mark.parametrize(("block", "rows"), [slow(32, 1), slow(32, 10), (16, 5), slow(256, 10)])
def test_a_chain_has_the_same_numbers_with_every_size_of_a_block(folder: Path, block: int, rows: int) -> None:
    code, kept, x = chain()
    made = functions(folder, "chain.h", CHAIN, f"-DHYSTMPC_BLOCK={block}", f"-DROWS={rows}")
    rng = np.random.default_rng(block + rows)
    u = np.abs(np.cumsum(rng.standard_normal((rows, 300)) * 0.1, axis=1))
    found = []
    for use in (engine(), made):
        first = np.arange(0, rows * 300 + 1, 300).astype(np.intc)
        first[1:-1] += np.arange(rows - 1, dtype=np.intc) * 3  # runs of different lengths
        p = code.parameters
        y, dy = np.empty(rows * 300), np.empty((rows * 300, p))
        seeds, states = np.eye(p), np.repeat(x[:, None], rows, axis=1)
        memory = np.empty(use.chain_bytes(code.code, rows, p), np.uint8)
        m = np.zeros((code.states, rows, p))
        use.chain_differentiate(code.code, kept, rows, first, u, None, p, seeds, states, m, y, dy, memory)
        rolled = np.empty((rows, 300))
        memory = np.empty(use.chain_bytes(code.code, rows, 0), np.uint8)
        use.chain_roll_out(code.code, kept, x, rows, 300, u, None, rolled, memory)
        angles, jacobian = np.empty(40), np.empty((40, 40))
        memory = np.empty(use.chain_linearise_bytes(code.code, 40), np.uint8)
        use.chain_linearise(code.code, kept, x, u[0, :40].copy(), None, 40, angles, jacobian, memory)
        found.append((y, dy, rolled, angles, jacobian))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    "options", [slow(("1",)), ("4",), slow(("8",)), slow(("16",)), ("8", "-mavx2", "-mfma"), slow(("16", "-mfma"))]
)
def test_a_network_has_the_same_numbers_in_panels_of_every_width(folder: Path, options: tuple[str, ...]) -> None:
    lanes, *more = options
    if more and int(engine("plain").level()) < 3:
        pytest.skip("the processor has no vectors of level v3")
    made = functions(folder, "network.h", ("network.c",), f"-DHYSTMPC_LANES={lanes}", *more)
    weights = lstm_weights(random_weights(20, 2))
    rng, found = np.random.default_rng(5), []
    plans = rng.uniform(0.0, 6.0, (7, 9))
    for use in (engine("plain"), made):
        packed = pack_network(weights, use.network_lanes())
        address = packed.ctypes.data
        state = np.full(use.network_state(address), 0.25)
        work = np.empty(use.network_room(address, 10))
        rolled, angles, jacobian = np.empty((7, 9)), np.empty(9), np.zeros((9, 9))
        use.network_rollout(address, state, plans, 7, 9, rolled, work)
        use.network_linearise(address, state, plans[0].copy(), 9, angles, jacobian, work)
        found.append((rolled, angles, jacobian))
    assert made.network_lanes() == int(lanes)
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def test_single_precision_follows_double(folder: Path) -> None:
    code, kept, x = chain()
    loaded = library(folder, CHAIN, "-DHYSTMPC_SINGLE=1")
    loaded.hystmpc_chain_step.restype = ctypes.c_float
    loaded.hystmpc_chain_single_bytes.restype = ctypes.c_long
    room = np.empty(loaded.hystmpc_chain_single_bytes(code.code.ctypes.data_as(ctypes.c_void_p)), np.uint8)
    short, state = kept.astype(np.float32), x.astype(np.float32)
    following, worst = x, 0.0
    for u in 3.0 + 2.5 * np.sin(0.05 * np.arange(400)):
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (code.code, short, state)]
        angle = loaded.hystmpc_chain_step(*pointers, ctypes.c_float(u), room.ctypes.data_as(ctypes.c_void_p))
        exact, following = code.step(kept, following, float(u))
        worst = max(worst, abs(angle - exact))
    assert worst < 1e-3


def test_a_network_in_single_precision_reads_the_same_weights(folder: Path) -> None:
    loaded = library(folder, ("network.c",), "-DHYSTMPC_SINGLE=1", "-DHYSTMPC_LANES=4")
    weights, use = lstm_weights(random_weights(20, 2)), engine("plain")
    packed = pack_network(weights, 4)
    header = np.zeros(32, np.float32)
    header[:5] = packed[:40].view(np.float64)
    header[5:12] = packed[40:68].view(np.float32)
    short = np.concatenate([header.view(np.uint8), packed[128:]])
    state = np.full(use.network_state(packed.ctypes.data), 0.25)
    u, theta, work = np.array([2.0]), np.empty(1), np.empty(use.network_room(packed.ctypes.data, 1))
    half, angle, numbers = state.astype(np.float32), np.empty(1, np.float32), np.empty(2 * work.size, np.float32)
    if use.network_lanes() != 4:
        pytest.skip("panels of this processor are wider")
    use.network_sample(packed.ctypes.data, state, 1, u, theta, work)
    arrays = [half, 1, u.astype(np.float32), angle, numbers]
    given = [a if isinstance(a, int) else a.ctypes.data_as(ctypes.c_void_p) for a in (short, *arrays)]
    loaded.hystmpc_network_sample(*given)
    np.testing.assert_allclose(angle, theta, rtol=1e-6)
    np.testing.assert_allclose(half, state, rtol=0, atol=1e-6)
