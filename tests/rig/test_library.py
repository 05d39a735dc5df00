"""The library of a controller in C: compiled by this process, and compared with the Python before anything moves."""

from __future__ import annotations

import itertools
import math
import stat
from pathlib import Path
from typing import Any

import pytest

from hystmpc.codegen import export_controller
from hystmpc.codegen.compiler import EXPECTED, compiler
from hystmpc.codegen.library import LoadedController, controller_library
from hystmpc.ctrl.planner.settings import TipSettings, assemble
from hystmpc.rig.compiled.controller import compiled_controller
from hystmpc.trials.errors import ConfigError, ExportError

from .test_backends import PLAIN


@pytest.fixture(scope="module", autouse=True)
def _compiles() -> None:
    if compiler() is None:
        pytest.skip(f"no C compiler: {EXPECTED}")


@pytest.mark.slow
def test_a_process_compiles_a_source_once_and_loads_nothing_that_another_has_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("hystmpc.codegen.library._made", {})
    export = export_controller(PLAIN)
    made = controller_library(export)
    assert stat.S_IMODE(made.parent.stat().st_mode) == 0o700
    monkeypatch.setenv("CC", "false")
    assert controller_library(export) == made
    with pytest.raises(ExportError):
        controller_library(export_controller({**PLAIN, "model": "builtin:backlash"}))
    monkeypatch.setattr("hystmpc.codegen.library._made", {})  # as another process
    with pytest.raises(ExportError):
        controller_library(export)


def assembled() -> tuple[Any, TipSettings]:
    settings = TipSettings.parse(PLAIN)
    return assemble(settings, Path()), settings


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["gain", "offset", "a nan", "after some steps", "source"])
def test_a_library_that_answers_otherwise_is_refused_before_anything_moves(
    fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the compiler made of the source: its first commands are those of Python, or it is not used."""
    assembly, settings = assembled()
    step, count = LoadedController.step, itertools.count()

    def broken(self: LoadedController, angle_deg: float, reference: Any) -> Any:
        answer, k = step(self, angle_deg, reference), next(count)
        if fault == "gain":
            answer.u *= 1.0001
        elif fault == "offset":
            answer.u += 2e-6
        elif fault == "a nan":
            answer.u = math.nan if k == 3 else answer.u
        elif fault == "after some steps":
            answer.u += 1e-3 * (k > 12)
        else:
            answer.source = 4 if k == 2 else answer.source
        return answer

    monkeypatch.setattr(LoadedController, "step", broken)
    with pytest.raises(ConfigError, match=r"realtime\.backend c: in step \d+ of its check it sends") as refused:
        compiled_controller(assembly.controller, settings)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) <= 300


@pytest.mark.slow
def test_a_check_looks_at_samples_without_a_usable_angle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Flags that take a compiler's word that no number is missing would be seen there alone."""
    assembly, settings = assembled()
    seen: list[float] = []
    step = LoadedController.step

    def watched(self: LoadedController, angle_deg: float, reference: Any) -> Any:
        seen.append(angle_deg)
        return step(self, angle_deg, reference)

    monkeypatch.setattr(LoadedController, "step", watched)
    compiled_controller(assembly.controller, settings)
    assert sum(map(math.isnan, seen)) >= 2
    assert len(seen) >= 20
