"""Structs that Python fills are those that the C compiler sees."""

import copy
import ctypes
import pickle
import re
import subprocess

import numpy as np
import pytest

from hystmpc.core.build import compiler, sources
from hystmpc.core.library import FOLDER
from hystmpc.core.structs import Declarations, constants, fields_of, layout, struct

TEXTS = {file.name: file.read_text(encoding="utf-8") for file in sources(FOLDER) if file.suffix == ".h"}
DECLARES = re.compile(r"^(typedef struct|enum|#define \w+ \d)", re.MULTILINE)
DECLARING = [name for name, text in TEXTS.items() if DECLARES.search(text)]
STRUCTS = sorted(name for header in DECLARING for name in re.findall(r"\n\} (\w+);", TEXTS[header]))


def test_bytes_and_offsets_are_the_compilers(tmp_path):
    lines = [f'#include "{header}"' for header in DECLARING]
    lines += ["#include <stddef.h>", "#include <stdio.h>", "int main(void) {"]
    for name in STRUCTS:
        lines.append(f'printf("{name} %zu\\n", sizeof({name}));')
        lines += [f'printf("{name}.{field.name} %zu\\n", offsetof({name}, {field.name}));' for field in fields_of(name)]
    lines += [f'printf("{name} %lld\\n", (long long){name});' for name in constants()]
    (tmp_path / "sizes.c").write_text("\n".join([*lines, "return 0; }"]), encoding="utf-8")
    program = tmp_path / "sizes"
    subprocess.run([*compiler(), "-std=c99", "-I", FOLDER, "-o", program, tmp_path / "sizes.c"], check=True)
    said = subprocess.run([program], capture_output=True, text=True, check=True).stdout
    numbers = {name: int(value) for name, value in (line.split() for line in said.splitlines())}
    for name in STRUCTS:
        kind = layout(name)
        assert ctypes.sizeof(kind) == numbers[name], name
        for field in fields_of(name):
            assert getattr(kind, field.name).offset == numbers[f"{name}.{field.name}"], (name, field)
    assert {name: numbers[name] for name in constants()} == constants()
    assert len(STRUCTS) > 20


def test_a_struct_holds_what_it_is_given():
    inner = struct("hystmpc_law", horizon=3, moves=3, lower=-1.0, tracking=[1, 2, 3], starts=[0, 1, 2])
    outer = struct("hystmpc_sampling", samples=4, seed=[2**64 - 1, 7], fitted=inner, sigmas=None)
    view = layout("hystmpc_sampling").from_address(outer.address)
    law = layout("hystmpc_law").from_address(view.fitted)
    assert list(view.seed) == [2**64 - 1, 7]
    assert view.sigmas is None
    assert (law.horizon, law.lower, law.upper) == (3, -1.0, 0.0)
    assert (ctypes.c_double * 3).from_address(law.tracking)[:] == [1.0, 2.0, 3.0]
    assert (ctypes.c_int * 3).from_address(law.starts)[:] == [0, 1, 2]


def test_arrays_are_copied_and_read_only():
    given = np.arange(6.0).reshape(3, 2).T
    law = struct("hystmpc_law", tracking=given)
    given[:] = -1.0
    kept = law.fields["tracking"]
    assert kept.tolist() == [[0.0, 2.0, 4.0], [1.0, 3.0, 5.0]]
    assert kept.flags.c_contiguous
    with pytest.raises(ValueError, match="read-only"):
        kept[0] = 1.0


def test_a_struct_by_value():
    basis = struct("hystmpc_basis", creeps=[0.5, 0.25], span=3.0)
    learner = struct("hystmpc_learner", basis=basis, delay=2)
    view = layout("hystmpc_learner").from_address(learner.address)
    assert (list(view.basis.creeps), view.basis.span, view.delay) == ([0.5, 0.25], 3.0, 2)


def answers_seven(x, rows, samples, plans, angles):
    return 7 if (x, rows, samples, plans, angles) == (None, 2, 3, None, None) else 0


def test_functions_can_be_called_in_copies_too():
    predictor = struct("hystmpc_predictor", kind=5, outside=struct("hystmpc_outside", run=answers_seven))
    for one in (predictor, copy.deepcopy(predictor), pickle.loads(pickle.dumps(predictor))):
        view = layout("hystmpc_predictor").from_address(one.address)
        outside = layout("hystmpc_outside").from_address(view.outside)
        assert outside.run(None, 2, 3, None, None) == 7
        assert not outside.advance


def test_copies_have_memory_of_their_own():
    first = struct("hystmpc_law", horizon=2, tracking=[1.0, 2.0])
    other = copy.deepcopy(first)
    assert other.address != first.address
    assert other.fields["tracking"].ctypes.data != first.fields["tracking"].ctypes.data
    assert other.fields["tracking"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"horizont": 3}, "hystmpc_law has no field horizont"),
        ({"horizon": 2**40}, "hystmpc_law.horizon: got 1099511627776"),
        ({"horizon": "x"}, "hystmpc_law.horizon"),
        ({"tracking": object()}, "hystmpc_law.tracking"),
    ],
)
def test_what_does_not_fit_is_refused(fields, said):
    with pytest.raises(ValueError, match=said):
        struct("hystmpc_law", **fields)


def test_structs_and_lengths_are_checked():
    law = struct("hystmpc_law")
    with pytest.raises(ValueError, match="got a hystmpc_law, expected a hystmpc_sampling"):
        struct("hystmpc_planner", sampling=law)
    with pytest.raises(ValueError, match=r"seed: got shape \(3,\), expected \(2,\)"):
        struct("hystmpc_sampling", seed=[1, 2, 3])
    with pytest.raises(KeyError):
        struct("hystmpc_nothing")


def test_another_text():
    text = "#define MOST 3\nenum { A = MOST + 1, B };\ntypedef struct { volatile int64_t n, *p; float x[B][2]; } some;"
    declared = Declarations(text)
    assert declared.constants == {"MOST": 3, "A": 4, "B": 5}
    assert ctypes.sizeof(declared.layout("some")) == 8 + 8 + 40
