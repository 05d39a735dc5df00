"""Export of a controller as one C99 file and its header: the engine's text and one table of numbers."""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.core import build
from hystmpc.core.library import engine
from hystmpc.core.structs import Struct, constants
from hystmpc.ctrl.planner.settings import TipSettings
from hystmpc.models.networks.route import NetworkRoute
from hystmpc.trials.errors import ExportError
from hystmpc.trials.files import write_atomically

from .amalgam import ONE_FILE, amalgam
from .literals import EXACT, INEXACT, functions_called, literal
from .numbers import LINE, Numbers
from .problem import ExportedProblem, exported_problem
from .straight import straight

ENGINE = (
    "program",
    "chain",
    "slopes",
    "rest",
    "inverse",
    "follow",
    "network",
    "moves",
    "drive",
    "predictor",
    "preview",
    "at_rest",
    "basis",
    "learning",
    "model",
    "estimator",
    "observer",
    "frames",
    "qp",
    "law",
    "normals",
    "sampling",
    "random_plans",
    "planner",
    "predictive",
    "feedback",
    "controller",
)
"""The engine's files `core/*.c` that are laid end to end."""
OF_TWO_AXES = ("cross_friction", "axes")
"""Those behind them of a controller of two axes."""

LANES, BLOCK = 8, 32
"""Units of a panel of a network's weights; numbers of a row of a block, which decides how much room a step takes."""

_UNUSED = """#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-function" /* a controller needs a part of its engine */
#endif
"""
_RENAMED = {"hystmpc_memory_bytes": "hystmpc_bytes_of_memory"}
_RENAMED_OF_TWO_AXES = {**_RENAMED, "hystmpc_command": "hystmpc_axis_command"}
"""Names of the engine that the header needs, and their names within the file."""
_LONGEST_S = 10.0


@dataclass(frozen=True)
class ControllerExport:
    """Controller as C99 source.

    Attributes:
        header, source: text of hystmpc.h and hystmpc.c.
        memory_bytes: of the struct that holds the controller, its room for a call included.
        remembered_bytes: the first part of it, which is the controller's state.
        functions: of <math.h> that are called; those without an exact result are `inexact`.
        sample_s: time between two steps [s].
        reference_samples: samples of the reference that a step uses.
        problem: that the source states, `hystmpc_problem` of core/controller.h; of two axes `hystmpc_axes` of
            core/axes.h.
        axes, commands: numbers of angles and of commands.
    """

    header: str
    source: str
    memory_bytes: int
    remembered_bytes: int
    functions: tuple[str, ...]
    sample_s: float
    reference_samples: int
    problem: Struct
    axes: int = 1
    commands: int = 1

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
    source: Path | str | Mapping[str, Any] | TipSettings,
    *,
    single: bool = False,
    lanes: int = LANES,
    folder: Path | None = None,
) -> ControllerExport:
    """Export the controller of `TipController.from_config(source)` as C99.

    Its commands are those of the Python controller, which steps by the same engine. Supported is all that the engine
    has; not a model or a law written in Python, nor the solver OSQP. Settings with a model of two axes give functions
    that take arrays of both axes.

    Args:
        source: a `tip.yaml`, a mapping or settings.
        single: use float instead of double.
        lanes: units of a panel of a network's weights; 1 for a compiler without the vectors of GNU C.
        folder: base of relative file names in a mapping.

    Raises:
        ExportError: where a part of the controller has no C; says what was got and what is supported.
        ConfigError, ModelError, ControllerError: as `TipController.from_config`.
    """
    if lanes not in (1, 4, 8):
        raise ExportError(f"export-c: got {lanes} lanes, expected 1, 4 or 8")
    stated = exported_problem(source, folder)
    about = (
        f"/* {stated.words}\n * Written by hystmpc {version('hystmpc')}; any change is lost at the next export. */\n"
    )
    networks = any(isinstance(part, NetworkRoute) for part in _parts(stated.struct))
    text = about + _source(stated, single, lanes if networks else 1)
    remembered, whole = _bytes(stated, text)
    return ControllerExport(
        about + _header(stated, single, remembered, whole),
        f"{text}\n{_template(f'{_part(stated)}.c')}",
        whole,
        remembered,
        tuple(name for name in (*EXACT, *INEXACT) if name in _functions(stated.struct)),
        stated.dt_s,
        stated.samples,
        stated.struct,
        len(stated.axes),
        stated.commands,
    )


def _part(stated: ExportedProblem) -> str:
    """Name of the templates: of the header's functions, of the functions, and `_bytes` of the program that measures."""
    return "one_axis" if len(stated.axes) == 1 else "two_axes"


def _source(stated: ExportedProblem, single: bool, lanes: int) -> str:
    """Text of hystmpc.c before the functions of its header: the engine and the numbers."""
    numbers, two = Numbers(single, lanes), len(stated.axes) > 1
    rests = [f"&{numbers.put(rest)}" if rest is not None else "NULL" for rest in stated.rests]
    numbers.put(stated.struct, "exported_problem")
    renamed = _RENAMED_OF_TWO_AXES if two else _RENAMED
    macros = {
        "HYSTMPC_SINGLE": int(single),
        "HYSTMPC_LANES": lanes,
        "HYSTMPC_BLOCK": BLOCK,
        "HYSTMPC_STRAIGHT": 1,
        **renamed,
    }
    return "\n".join(
        [
            *(f"#define {name} {value}" for name, value in macros.items()),
            ONE_FILE + _UNUSED,
            amalgam(f"{name}.c" for name in (*ENGINE, *(OF_TWO_AXES if two else ()))),
            "\n".join(f"#undef {name}" for name in renamed) + "\n\n/* Numbers of this controller. */\n",
            LINE,
            numbers.text,
            straight(numbers.chains),
            *(_facts_of_two_axes(stated, rests) if two else _facts(stated, rests[0])),
        ]
    )


def _facts(stated: ExportedProblem, rest: str) -> tuple[str, ...]:
    entries = _input_entries(stated.inputs)
    return (
        f"static const hystmpc_rest_rule *const exported_rest = {rest};",
        f"static const int exported_inputs[][2] = {entries}; /* input, entry of the state */\n",
    )


def _facts_of_two_axes(stated: ExportedProblem, rests: Sequence[str]) -> tuple[str, ...]:
    states = ", ".join(map(str, [*stated.states(), 0, 0][: len(rests)]))
    return (
        f"static const hystmpc_rest_rule *const exported_rest[HYSTMPC_AXES] = {{{', '.join(rests)}}};",
        f"static const int exported_states[HYSTMPC_AXES] = {{{states}}};\n",
    )


def _input_entries(inputs: Mapping[str, tuple[int, ...]]) -> str:
    rows = [f"{{{k}, {entry}}}" for k, entries in enumerate(inputs.values()) for entry in entries]
    return f"{{{', '.join([*rows, '{-1, -1}'])}}}"


def _template(name: str) -> str:
    return resources.files("hystmpc.codegen").joinpath("c", name).read_text(encoding="utf-8")


def _header(stated: ExportedProblem, single: bool, remembered: int, whole: int) -> str:
    folder, two = resources.files("hystmpc.core"), len(stated.axes) > 1
    headers = [folder.joinpath(f"{name}.h").read_text(encoding="utf-8") for name in ("controller", "observer")]
    wanted = ("HYSTMPC_MPC", "HYSTMPC_OK"), ("HYSTMPC_STARTED",)
    said = [_enumeration(text, first) for text, names in zip(headers, wanted, strict=True) for first in names]
    if not two:
        command = _about("typedef struct", "} hystmpc_command;", headers[0])
        said.append(command.replace("    real ", "    hystmpc_real "))
    use, functions = _template(f"{_part(stated)}.h").split("\n\n", 1)
    text = _template("hystmpc.h").replace("@USE@", use).replace("@FUNCTIONS@\n", functions)
    text = text.replace("@SIZES@\n", "\n".join([*_sizes(stated, single, remembered, whole), *_precision(single)]))
    text = text.replace("@REAL@", "float" if single else "double")
    return text.replace("@ENGINE@", "\n\n".join(said))


def _sizes(stated: ExportedProblem, single: bool, remembered: int, whole: int) -> list[str]:
    """Macros of the header: numbers of this controller."""
    fields, two = stated.struct.fields, len(stated.axes) > 1
    sizes: dict[str, Any] = {"SAMPLE_S": literal(stated.dt_s, False)}
    sizes |= {"AXES": len(stated.axes), "COMMANDS": stated.commands} if two else {}
    for name, ends in (("LOWEST", fields["lower"]), ("HIGHEST", fields["upper"])):
        listed = ", ".join(literal(float(end), two and single) for end in np.atleast_1d(ends))
        sizes[name] = f"{{{listed}}}" if two else listed
    sizes |= {"REFERENCE": stated.samples, "REMEMBERED": remembered, "BYTES": whole}
    sizes |= {f"INPUT_{re.sub(r'[^A-Z0-9]', '_', name.upper())}": k for k, name in enumerate(stated.inputs)}
    return [f"#define HYSTMPC_{name} {value}" for name, value in sizes.items()]


def _precision(single: bool) -> list[str]:
    return ["#ifndef HYSTMPC_SINGLE", f"#define HYSTMPC_SINGLE {int(single)}", "#endif", ""]


def _enumeration(text: str, first: str) -> str:
    """The enumeration of a header that begins with a name, and the comment before it."""
    match = re.search(rf"(/\*(?:(?!\*/).)*\*/\n)?enum \{{\s+{first}\b[^}}]*\}};", text, re.DOTALL)
    assert match is not None, first
    return match[0]


def _about(begin: str, end: str, text: str) -> str:
    """The declaration that ends so, from its last beginning on, and the comment before it."""
    stop = text.index(end) + len(end)
    start = text.rindex(begin, 0, stop)
    return text[text.rindex("/*", 0, start) : stop]


def _bytes(stated: ExportedProblem, source: str) -> tuple[int, int]:
    """Bytes that are remembered, and of the whole struct: as a compiler says, else as many as are enough."""
    if known := _measured(source, f"{_part(stated)}_bytes.c"):
        remembered, room = known
    else:
        remembered, room = _enough(stated)
    remembered = -(-remembered // 8) * 8
    return remembered, remembered + -(-room // 8) * 8


def _enough(stated: ExportedProblem) -> tuple[int, int]:
    """Bytes of memory, and of room that is enough in either precision."""
    core, address, two = engine("plain"), stated.struct.address, len(stated.axes) > 1
    remembered = core.axes_bytes(address) if two else core.memory_bytes(address)
    room, numbers = core.axes_room_bytes(address) if two else core.room_bytes(address), sum(stated.states())
    for axis, rest in zip(stated.axes, stated.rests, strict=True):
        if rest is not None:
            room = max(room, core.at_rest_bytes(rest.address, axis.fields["model"].fields["predictor"].address))
    if two:
        horizon = stated.axes[0].fields["law"].fields["horizon"]
        numbers += 2 * stated.samples + (2 + stated.commands) * horizon
    return remembered, room + (8 * numbers + 4 * 64 if numbers else 0)


def _measured(source: str, program: str) -> tuple[int, int] | None:
    """Bytes of memory and of room in this precision; None without a compiler.

    Without the functions of the header a compiler that optimises leaves out what only they would call.
    """
    try:
        command = build.compiler()
    except RuntimeError:
        return None
    if command is None:
        return None
    with tempfile.TemporaryDirectory(prefix="hystmpc-c-") as folder:
        (Path(folder) / "measure.c").write_text(f"{source}\n{_template(program)}", encoding="utf-8")
        try:
            build.run(command, ["-std=c99", "-O1", "-o", "measure", "measure.c", "-lm"], Path(folder))
            done = subprocess.run([Path(folder) / "measure"], capture_output=True, timeout=_LONGEST_S, check=True)
        except (RuntimeError, OSError, subprocess.SubprocessError):
            return None
    remembered, room = done.stdout.split()
    return int(remembered), int(room)


def _parts(part: Any) -> Iterator[Any]:
    """A struct and all that it points to."""
    yield part
    for value in part.fields.values() if isinstance(part, Struct) else ():
        yield from _parts(value)


def _functions(problem: Struct) -> set[str]:
    """Functions of <math.h> that a step of this controller may call."""
    called, kinds = {"fabs", "sqrt", "rint"}, constants()
    for part in _parts(problem):
        if isinstance(part, NetworkRoute):
            called |= {"fmaf"} | ({"exp"} if part.weights.cell == "gated" else set())
        if not isinstance(part, Struct):
            continue
        if part.fields.get("chain") is not None:
            called.update(functions_called(part.fields["chain"].tolist(), at_rest=True))
        if part.name == "hystmpc_sampling":
            called |= {"exp", "log1p"}
        if part.name == "hystmpc_sensing" and part.fields["sensor"] == kinds["HYSTMPC_FRAMES"]:
            called |= {"exp", "ceil"}
    return called
