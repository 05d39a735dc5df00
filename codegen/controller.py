"""Export of a predictive controller as one C99 file and its header."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.ctrl.planner.settings import TipSettings, read_settings
from hystmpc.trials.files import write_atomically

from .layout import structs
from .problem import ControllerProblem, problem_of
from .steps import (
    INEXACT,
    chain_rest_source,
    functions_used,
    inverted_source,
    model_source,
    network_rest_source,
    number,
)

PARTS = (
    "tables",
    "model",
    "network",
    "state",
    "observer",
    "planner",
    "predictive",
    "feedback",
    "controller",
)
"""The files `codegen/c/*.c`, in the order in which they are laid end to end behind those of the engine."""
_ENGINE: Mapping[str, tuple[str, ...]] = {
    "horizon": ("real.h", "linear.h", "qp.h", "law.h", "qp.c", "law.c"),
    "front": ("moves.h", "moves.c"),
    "back": ("moves.h", "moves.c"),
    "senses": ("estimator.h", "estimator.c"),
    "learns": ("learned_state.h", "basis.h", "learning.h", "basis.c", "learning.c"),
}
"""The engine's files `core/*` that a controller takes where its size of that name is not zero."""

# Thresholds for solved, dependent or equal, in double and in single precision; None where `problem` has the number.
_TOLERANCES: Mapping[str, tuple[float | None, float]] = {
    "miss": (1e-11, 1e-6),
    "narrow": (1e-13, 1e-6),
    "linear": (1e-6, 1e-4),
}
_CHANGES = 1000  # of the active set in one program
_MOST_SAMPLES = 1_000_000_000


@dataclass(frozen=True)
class ControllerExport:
    """Predictive controller as C99 source.

    Attributes:
        header, source: text of hystmpc.h and hystmpc.c.
        parts: the same source as separate files, each of which compiles alone, by name.
        memory_bytes: of the struct that holds the controller, its room for a step included.
        remembered_bytes: the part of it that is the controller's state.
        functions: of <math.h> that are called; those without an exact result are `inexact`.
        sample_s: time between two steps [s].
        reference_samples: reference angles that a step uses.
        structs: of the header, as ctypes.
    """

    header: str
    source: str
    parts: Mapping[str, str]
    memory_bytes: int
    remembered_bytes: int
    functions: tuple[str, ...]
    sample_s: float
    reference_samples: int
    structs: Mapping[str, type[ctypes.Structure]]

    @property
    def inexact(self) -> tuple[str, ...]:
        """Functions of <math.h> whose last digits depend on the C library."""
        return tuple(name for name in self.functions if name in INEXACT)

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Write hystmpc.h and hystmpc.c into a folder, which is created if missing."""
        folder.mkdir(parents=True, exist_ok=True)
        header = write_atomically(folder / "hystmpc.h", self.header)
        return header, write_atomically(folder / "hystmpc.c", self.source)


def export_controller(
    source: Path | str | Mapping[str, Any] | TipSettings, *, single: bool = False, folder: Path | None = None
) -> ControllerExport:
    """Export the predictive controller of `TipController.from_config(source)` as C99.

    Its commands are those of the Python controller, `GuardedController.step`, to rounding. Supported are models of
    operators, LSTM and GRU, the linearised controller, and a continuous sensor or none.

    Args:
        source: a `tip.yaml`, a mapping or settings.
        single: use float instead of double.
        folder: base of relative file names in a mapping.

    Raises:
        ExportError: where a part of the controller has no C; says what was got and what is supported.
        ConfigError, ModelError, ControllerError: as `TipController.from_config`.
    """
    settings, home = read_settings(source)
    problem = problem_of(settings, home if folder is None else folder)
    sizes, numbers = _sizes(problem, single), _numbers(problem, single)
    models = _models(problem)
    files = {"hystmpc.h": _template("hystmpc.h"), "internal.h": _template("internal.h"), **_engine_files(problem.sizes)}
    files |= {f"{name}.c": _template(f"{name}.c") for name in PARTS if name != "network" or problem.network is not None}
    made = {"hystmpc_problem.h": sizes, "hystmpc_numbers.h": numbers, "steps.c": f'#include "internal.h"\n\n{models}'}
    head = (
        f"/* {problem.words}\n * Written by hystmpc {version('hystmpc')}; any change is lost at the next export. */\n"
    )
    left = {**files, **made}
    header = head + _inlined(left.pop("hystmpc.h"), left)
    mains = ["internal.h", "steps.c", *(name for name in files if name.endswith(".c"))]
    source_text = "\n".join(
        [
            head + "#define HYSTMPC_ONE_FILE\n#define HYSTMPC_LOCAL static\n#define HYSTMPC_SHARED static",
            *(_inlined(left.pop(name), left) for name in mains),
        ]
    )
    real = ctypes.c_float if single else ctypes.c_double
    macros = {f"HYSTMPC_{name.upper()}": value for name, value in problem.sizes.items()}
    kinds = structs(header, macros, real)
    whole, work = (ctypes.sizeof(kinds[f"hystmpc_{name}"]) for name in ("controller", "work"))
    made |= {"hystmpc_problem.h": _guarded("PROBLEM", sizes), "hystmpc_numbers.h": _guarded("NUMBERS", numbers)}
    return ControllerExport(
        header,
        source_text,
        {**files, **made, "real.h": f'#include "hystmpc.h"\n\n{files["real.h"]}'},
        whole,
        whole - work,
        functions_used(source_text),
        float(np.asarray(problem.numbers["dt_s"])),
        problem.sizes["reference"],
        kinds,
    )


def _template(name: str) -> str:
    return resources.files("hystmpc.codegen").joinpath("c", name).read_text(encoding="utf-8")


def _engine_files(sizes: Mapping[str, int]) -> Mapping[str, str]:
    """Text of the engine's files that a controller of these sizes needs, by name."""
    names = dict.fromkeys(name for size, needed in _ENGINE.items() if sizes[size] for name in needed)
    folder = resources.files("hystmpc.core")
    texts = {name: folder.joinpath(name).read_text(encoding="utf-8") for name in names}
    return {name: _for_export(text) for name, text in texts.items()}


def _for_export(text: str) -> str:
    """Text of the engine without what its library alone needs."""
    return text.replace('#include "hystmpc_core.h"\n', "").replace("HYSTMPC_API", "HYSTMPC_LOCAL")


def _inlined(text: str, left: dict[str, str]) -> str:
    """Text with the text of a header in the place where it is included first, and nothing elsewhere.

    Args:
        left: files that have not been inlined yet, by name; those inlined here are taken out.
    """

    def included(match: re.Match[str]) -> str:
        return _inlined(left.pop(match[1], ""), left)

    return re.sub(r'^#include "(?!hystmpc\.h)(.+)"\n', included, text, flags=re.MULTILINE)


def _guarded(name: str, text: str) -> str:
    return f"#ifndef HYSTMPC_{name}_H\n#define HYSTMPC_{name}_H\n{text}#endif\n"


def _sizes(problem: ControllerProblem, single: bool) -> str:
    lines = [f"typedef {'float' if single else 'double'} hystmpc_real;", f"#define HYSTMPC_SINGLE {int(single)}"]
    public = {"sample_s": "dt_s", "lowest": "lower", "highest": "upper"}
    lines += [f"#define HYSTMPC_{name.upper()} {problem.numbers[key]!r}" for name, key in public.items()]
    lines += [f"#define HYSTMPC_{name.upper()} {value}" for name, value in sorted(problem.sizes.items())]
    return "\n".join([*lines, ""])


def _numbers(problem: ControllerProblem, single: bool) -> str:
    lines = [f"#define HYSTMPC_CHANGES {_CHANGES}", f"#define HYSTMPC_MOST_SAMPLES {_MOST_SAMPLES}"]
    values = {**problem.numbers, **{k: pair[single] for k, pair in _TOLERANCES.items() if pair[single] is not None}}
    lines += [f"#define HYSTMPC_{name.upper()} {_initialiser(value)}" for name, value in sorted(values.items())]
    return "\n".join([*lines, ""])


def _initialiser(value: Any) -> str:
    if isinstance(value, float):
        return number(value)
    array = np.asarray(value)
    if array.ndim:
        return "{" + ", ".join(_initialiser(part) for part in array) + "}"
    return str(int(array)) if array.dtype.kind == "i" else number(float(array))


def _models(problem: ControllerProblem) -> str:
    rest = problem.rest
    sources = [
        (inverted_source if name == "middle" else model_source)(name, step) for name, step in problem.steps.items()
    ]
    if problem.network is not None:
        sources.append(problem.network.source())
    rule = rest.offset, rest.by_angle, rest.by_command, rest.warmup
    at_rest = chain_rest_source(*rule) if problem.network is None else network_rest_source(*rule, rest.companion_held)
    return "\n".join([*sources, at_rest])
