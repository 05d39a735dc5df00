"""Networks of any size in the exported C."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hystmpc.codegen import export_controller
from hystmpc.trials.errors import ExportError

from .compiled import FAST, NETWORK, STRICT, Library, compilers, library, run_sanitized, tried
from .loops import compare
from .networks import Way, connected_network, gated_network, small_network
from .test_commands import PLAIN, SAME, tip

# One, two and three layers, of fewer units than a vector, of more, of a whole vector; two of 32 with every part below.
SLOW_SIZES = [("gru", 5, 1), ("lstm", 33, 2), ("gru", 16, 3)]
EVERY_KIND = pytest.mark.parametrize("kind", ["lstm", "gru"])


@pytest.mark.parametrize(
    "size",
    [("lstm", 5, 1), *(pytest.param(size, marks=pytest.mark.slow) for size in SLOW_SIZES)],
    ids=str,
)
def test_commands_are_those_of_python_for_any_size(size: tuple[str, int, int], tmp_path: Path) -> None:
    settings = tip(small_network(*size, tmp_path), **PLAIN)
    found = compare(settings, library(settings, tmp_path), 200, seed=2)
    assert found.greatest <= SAME
    assert found.same_sources
    assert float(np.ptp(found.c)) > 1.0


@pytest.mark.slow
def test_commands_of_a_gru_are_those_of_python_with_every_part(tmp_path: Path) -> None:
    settings = tip(small_network("gru", 32, 2, tmp_path), 0.08)
    found = compare(settings, library(settings, tmp_path, options=FAST), 750, 0.08)
    assert found.greatest <= SAME
    assert found.same_sources


@pytest.mark.slow
@EVERY_KIND
def test_without_fused_instructions_commands_stay_close(kind: str, tmp_path: Path) -> None:
    """The products are then rounded by way of double."""
    settings = tip(small_network(kind, 20, 1, tmp_path), **PLAIN)
    found = compare(settings, library(settings, tmp_path, options=("-O1",)), 100, seed=2)
    assert found.greatest <= 1e-4


@pytest.mark.slow
def test_a_network_runs_clean_under_sanitizers(tmp_path: Path) -> None:
    """An LSTM; a GRU runs under them where any function is called in any order, see test_fuzz."""
    run_sanitized(export_controller(tip(small_network("lstm", 5, 1, tmp_path), 0.08)), tmp_path, 330)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "single"), [("lstm", False), ("gru", True)])
def test_every_compiler_takes_a_network_without_a_warning(kind: str, single: bool, tmp_path: Path) -> None:
    """What an optimiser finds is looked for where a GRU with every part is compiled as a lab does, above."""
    export_controller(tip(small_network(kind, 20, 2, tmp_path)), single=single).write(tmp_path)
    for command in compilers():
        assert tried([*command, *STRICT, *NETWORK, "-c", "hystmpc.c"], tmp_path) == ""


def test_the_weights_take_the_room_that_they_need(tmp_path: Path) -> None:
    """Four gates of 8 units each: bias, input and outputs of the layer itself, and of the layer below; the head."""
    source = export_controller(tip(small_network("lstm", 5, 2, tmp_path), **PLAIN)).source
    assert "#define HYSTMPC_LANES 8" in source
    assert f"struct {{ hystmpc_network head; float numbers[{32 * (2 + 8) + 32 * (1 + 2 * 8) + 8 + 1}]; }}" in source


def test_a_controller_without_a_network_needs_no_vectors() -> None:
    assert "#define HYSTMPC_LANES 1" in export_controller(tip("builtin:pi")).source


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [1, 4])
def test_commands_do_not_depend_on_how_weights_are_packed(lanes: int, tmp_path: Path) -> None:
    settings = tip(small_network("gru", 12, 1, tmp_path), **PLAIN)
    made = Library(export_controller(settings, lanes=lanes), tmp_path)
    assert compare(settings, made, 100, seed=2).greatest <= SAME


@pytest.mark.slow
@pytest.mark.parametrize("sensor", ["continuous", "intermittent"])
def test_commands_are_those_of_python_for_a_gated_lstm(sensor: str, tmp_path: Path) -> None:
    settings = tip(gated_network(tmp_path), estimator={"sensor": sensor})
    found = compare(settings, library(settings, tmp_path), 200, seed=2)
    assert found.greatest <= SAME
    assert found.same_sources


@pytest.mark.slow
@pytest.mark.parametrize("ways", [("series",), ("parallel",), ("series", "parallel")], ids="-".join)
def test_commands_are_those_of_python_for_connected_networks(ways: tuple[Way, ...], tmp_path: Path) -> None:
    settings = tip(connected_network(ways, tmp_path), **PLAIN)
    found = compare(settings, library(settings, tmp_path), 200, 0.08, seed=2)
    assert found.greatest <= SAME
    assert found.same_sources


def test_a_network_without_c_is_refused_in_a_line(tmp_path: Path) -> None:
    line = "export-c: got a model of kind hb1 with .* computed by Python, supported are"
    with pytest.raises(ExportError, match=line):
        export_controller(tip(small_network("lstm", 5, 1, tmp_path, "hb1")))
