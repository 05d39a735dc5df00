"""Export of a controller as one C99 file and its header: the engine's text and one table of numbers."""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hystmpc.core import build
from hystmpc.core.library import engine
from hystmpc.core.structs import Struct, constants
from hystmpc.ctrl.command import limits_of_model, modelled_limits
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.ctrl.planner.settings import TipSettings, read_settings
from hystmpc.ctrl.problem import problem_of, written_in
from hystmpc.models.load import load_model, model_path
from hystmpc.models.model import Predictor
from hystmpc.models.networks.route import NetworkRoute
from hystmpc.models.prediction.build import controller_model
from hystmpc.trials.errors import ExportError
from hystmpc.trials.files import write_atomically

from .amalgam import ONE_FILE, amalgam
from .literals import EXACT, INEXACT, functions_called, literal
from .numbers import LINE, Numbers
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

LANES, BLOCK = 8, 32
"""Units of a panel of a network's weights; numbers of a row of a block, which decides how much room a step takes."""

_UNUSED = """#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-function" /* a controller needs a part of its engine */
#endif
"""
_RENAMED = "hystmpc_memory_bytes", "hystmpc_bytes_of_memory"
"""A function of the engine whose name the header needs, and its name within the file."""
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
        reference_samples: reference angles that a step uses.
        problem: that the source states, `hystmpc_problem` of core/controller.h.
    """

    header: str
    source: str
    memory_bytes: int
    remembered_bytes: int
    functions: tuple[str, ...]
    sample_s: float
    reference_samples: int
    problem: Struct

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
    has; not a model or a law written in Python, nor the solver OSQP.

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
    settings, home = read_settings(source)
    problem, predictor, words = _problem(settings, home if folder is None else folder)
    about = f"/* {words}\n * Written by hystmpc {version('hystmpc')}; any change is lost at the next export. */\n"
    networks = any(isinstance(part, NetworkRoute) for part in _parts(problem))
    inputs = predictor.input_states if problem.fields.get("model") is not None else {}
    text = about + _source(problem, predictor.rest_part, single, lanes if networks else 1, inputs)
    remembered, whole = _bytes(problem, predictor, text)
    return ControllerExport(
        about + _header(problem, single, remembered, whole, inputs),
        f"{text}\n{_template('front.c')}",
        whole,
        remembered,
        tuple(name for name in (*EXACT, *INEXACT) if name in _functions(problem)),
        problem.fields["dt_s"],
        _samples(problem),
        problem,
    )


def _problem(settings: TipSettings, folder: Path) -> tuple[Struct, Predictor, str]:
    """The problem of the settings' controller, the model's predictor, and a line on both."""
    controller = settings.controller.resolved()
    if hasattr(controller, "law"):
        raise ExportError(
            f"export-c: got the law {type(controller).__name__} written in Python, expected one of hystmpc"
        )
    if isinstance(controller, LinearisedMpcSettings) and controller.solver != "active_set":
        raise ExportError(f"export-c: got controller.solver {controller.solver}, supported is active_set: an exact one")
    model = load_model(model_path(settings.model, folder), start="conditioned")
    inverse = None if settings.inverse is None else model_path(settings.inverse, folder)
    known, facts = controller_model(model, inverse, settings.actuator_lag_s), model.metadata
    predictor, inverted = known.predictive if controller.predicts else known.feedforward
    limits = modelled_limits(settings.limits, limits_of_model(facts))
    problem = problem_of(controller, predictor, inverted, limits)
    if written := written_in(problem):
        raise ExportError(
            f"export-c: got a model of kind {facts.kind} with {written} that is computed by Python, "
            "supported are operators, lstm and gru, and what connects them"
        )
    least, most, dt = problem.fields["lower"], problem.fields["upper"], problem.fields["dt_s"]
    rate = problem.fields["reach"] / dt
    words = f"{settings.model}: {settings.controller.kind} on {facts.kind}, every {dt:g} s"
    return problem, predictor, f"{words}, {least:g} to {most:g} at {rate:g} per s [{facts.command_unit}]"


def _samples(problem: Struct) -> int:
    return int(engine().reference_samples(problem.address))


def _source(
    problem: Struct, rest: Struct | None, single: bool, lanes: int, inputs: Mapping[str, tuple[int, ...]]
) -> str:
    """Text of hystmpc.c before the functions of its header: the engine and the numbers."""
    numbers = Numbers(single, lanes)
    model = problem.fields.get("model")
    at_rest = f"&{numbers.put(rest)}" if model is not None and rest is not None else "NULL"
    numbers.put(problem, "exported_problem")
    old, new = _RENAMED
    macros = {
        "HYSTMPC_SINGLE": int(single),
        "HYSTMPC_LANES": lanes,
        "HYSTMPC_BLOCK": BLOCK,
        "HYSTMPC_STRAIGHT": 1,
        old: new,
    }
    return "\n".join(
        [
            *(f"#define {name} {value}" for name, value in macros.items()),
            ONE_FILE + _UNUSED,
            amalgam(f"{name}.c" for name in ENGINE),
            f"#undef {old}\n\n/* Numbers of this controller. */\n",
            LINE,
            numbers.text,
            straight(numbers.chains),
            f"static const hystmpc_rest_rule *const exported_rest = {at_rest};",
            f"static const int exported_inputs[][2] = {_input_entries(inputs)}; /* input, entry of the state */\n",
        ]
    )


def _input_entries(inputs: Mapping[str, tuple[int, ...]]) -> str:
    rows = [f"{{{k}, {entry}}}" for k, entries in enumerate(inputs.values()) for entry in entries]
    return f"{{{', '.join([*rows, '{-1, -1}'])}}}"


def _template(name: str) -> str:
    return resources.files("hystmpc.codegen").joinpath("c", name).read_text(encoding="utf-8")


def _header(problem: Struct, single: bool, remembered: int, whole: int, inputs: Mapping[str, tuple[int, ...]]) -> str:
    fields, folder = problem.fields, resources.files("hystmpc.core")
    headers = [folder.joinpath(f"{name}.h").read_text(encoding="utf-8") for name in ("controller", "observer")]
    wanted = ("HYSTMPC_MPC", "HYSTMPC_OK"), ("HYSTMPC_STARTED",)
    said = [_enumeration(text, first) for text, names in zip(headers, wanted, strict=True) for first in names]
    command = _about("typedef struct", "} hystmpc_command;", headers[0]).replace("    real ", "    hystmpc_real ")
    sizes = {
        "SAMPLE_S": literal(fields["dt_s"], False),
        "LOWEST": literal(fields["lower"], False),
        "HIGHEST": literal(fields["upper"], False),
        "REFERENCE": _samples(problem),
        "REMEMBERED": remembered,
        "BYTES": whole,
    }
    sizes |= {f"INPUT_{re.sub(r'[^A-Z0-9]', '_', name.upper())}": k for k, name in enumerate(inputs)}
    lines = [f"#define HYSTMPC_{name} {value}" for name, value in sizes.items()]
    lines += ["#ifndef HYSTMPC_SINGLE", f"#define HYSTMPC_SINGLE {int(single)}", "#endif", ""]
    text = _template("hystmpc.h").replace("@SIZES@\n", "\n".join(lines))
    text = text.replace("@REAL@", "float" if single else "double")
    return text.replace("@ENGINE@", "\n\n".join([*said, command]))


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


def _bytes(problem: Struct, predictor: Predictor, source: str) -> tuple[int, int]:
    """Bytes that are remembered, and of the whole struct: as a compiler says, else as many as are enough."""
    if known := _measured(source):
        remembered, room = known
    else:
        core, address = engine("plain"), problem.address
        remembered, room, model = core.memory_bytes(address), core.room_bytes(address), problem.fields.get("model")
        if model is not None and predictor.rest_part is not None:
            part = model.fields["predictor"]
            at_rest = core.at_rest_bytes(predictor.rest_part.address, part.address)
            room = max(room, at_rest) + 8 * part.fields["states"] + 2 * 64
    remembered = -(-remembered // 8) * 8
    return remembered, remembered + -(-room // 8) * 8


def _measured(source: str) -> tuple[int, int] | None:
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
        (Path(folder) / "measure.c").write_text(f"{source}\n{_template('measure.c')}", encoding="utf-8")
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
