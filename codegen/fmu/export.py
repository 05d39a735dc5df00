"""Export of a simulator as an FMU with C sources and compiled binaries."""

from __future__ import annotations

import io
import platform
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from importlib.metadata import version as version_of
from pathlib import Path
from types import MappingProxyType
from typing import Literal, get_args

from hystmpc.models.scheduled import input_states
from hystmpc.models.simulator import Simulator
from hystmpc.trials.errors import ExportError, did_you_mean
from hystmpc.trials.files import write_atomically
from hystmpc.trials.json_text import text_hash
from hystmpc.trials.types import Vec

from ..amalgam import ONE_FILE, amalgam
from ..compiler import compiler, shared_library, zig
from ..literals import number
from .description import Described, DescribedInput, build_description, model_description
from .device import DeviceInPlane, DeviceText, text_in_plane, text_of

FmuVersion = Literal["2.0", "3.0"]

_HEADERS: Mapping[str, tuple[str, ...]] = {
    "2.0": ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    "3.0": ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
_SOURCE = "fmu.c"
_ENGINE = ("program.c", "inverse.c")
_SECTION, _PIECE = (re.compile(rf"^{mark}(\w+){mark}\n", re.MULTILINE) for mark in "@%")
_OLDEST = (1980, 1, 1, 0, 0, 0)  # of a zip file: equal devices give equal bytes


@dataclass(frozen=True)
class Platform:
    """Platform (operating system and processor) for which a binary can be compiled.

    Attributes:
        system: name of the operating system in Python.
        tuple3: name in FMI 3.0; the key in `PLATFORMS` is that in FMI 2.0.
        target: of ziglang, with an old C library, so that the binary also runs on older systems.
        ending: file extension of a shared library.
    """

    system: str
    tuple3: str
    target: str
    ending: str

    def path(self, identifier: str, version: str) -> str:
        """Path of the binary inside the FMU."""
        folder = self.tuple3 if version == "3.0" else _NAMES_2[self.tuple3]
        return f"binaries/{folder}/{identifier}.{self.ending}"


_NAMES_2 = MappingProxyType({"x86_64-linux": "linux64", "x86_64-windows": "win64", "x86_64-darwin": "darwin64"})
PLATFORMS: Mapping[str, Platform] = MappingProxyType(
    {
        "linux64": Platform("Linux", "x86_64-linux", "x86_64-linux-gnu.2.17", "so"),
        "win64": Platform("Windows", "x86_64-windows", "x86_64-windows-gnu", "dll"),
        "darwin64": Platform("Darwin", "x86_64-darwin", "x86_64-macos", "dylib"),
    }
)
"""Machines by the names that FMI 2.0 has for them."""


@dataclass(frozen=True)
class FmuExport:
    """Simulator exported as an FMU.

    Attributes:
        described: device data in modelDescription.xml.
        files: content by path inside the FMU.
        platforms: for which there is a binary; none where no compiler was found.
        functions: of <math.h> that the step calls.
        left_out: parts of the plant that the FMU does not contain, such as the noise of its sensor.
    """

    described: Described
    files: Mapping[str, bytes]
    platforms: tuple[str, ...]
    functions: tuple[str, ...]
    left_out: tuple[str, ...] = ()

    def write(self, path: Path | str) -> Path:
        """Write the FMU file completely or not at all."""
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in self.files.items():
                entry = zipfile.ZipInfo(name, _OLDEST)
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
                archive.writestr(entry, content)
        return write_atomically(path, packed.getvalue())


def export_fmu(
    simulator: Simulator,
    rest: tuple[float, Vec],
    *,
    name: str = "device",
    version: FmuVersion = "2.0",
    platforms: Sequence[str] | None = None,
    rest_command: float | None = None,
) -> FmuExport:
    """Export a simulator as a co-simulation FMU: command in, output out, one step per sample.

    It starts at `rest` and agrees with the Python simulator up to rounding. The command is held over a step. Measured
    inputs are further input variables, which keep their values of the start until they are set.

    Args:
        simulator: with its effects, at the sample time of the FMU; a `SimulatedPlant` has it as `simulator`.
        rest: output and state (S,) at the start, `SimulatedPlant.rest`.
        name: of the model, for the importing tool.
        platforms: platforms of the binaries, of `PLATFORMS`; that of this machine where left out, if it has a compiler.
        rest_command: command before the first one is set; the simulator's own where left out.

    Raises:
        ExportError: where the simulator is an inverse map or has a sensor, a platform is unknown, or a compiler fails.
    """
    _check(version)
    held = simulator.rests_at if rest_command is None else rest_command
    text = text_of(simulator, rest, held)
    described = Described(
        name=name,
        identifier=_identifier(name),
        chain=" + ".join(operator.name for operator in simulator.chain.operators),
        sample_s=simulator.dt_s,
        command_unit=simulator.command_unit,
        output_unit=simulator.angle_unit,
        limits=(simulator.command_limits.lower, simulator.command_limits.upper),
        rest_command=held,
        tool=f"hystmpc {version_of('hystmpc')}",
        inputs=_inputs(simulator, rest[1]),
    )
    token = _token((described, text.tables, rest[0], rest[1].tolist(), version))
    return _exported(replace(described, token=token), text, version, platforms)


def export_fmu_in_plane(
    device: DeviceInPlane,
    *,
    name: str = "device",
    version: FmuVersion = "2.0",
    platforms: Sequence[str] | None = None,
) -> FmuExport:
    """Export a device of two axes as a co-simulation FMU: all commands in, both angles out; see `export_fmu`.

    Raises:
        ExportError: as `export_fmu`, for either axis.
    """
    _check(version)
    model, text = device.model, text_in_plane(device)
    parts = [*device.drive, *(operator for axis in model.axes for operator in axis.chain.operators)]
    low, high = (tuple(getattr(one, end) for one in model.command_limits) for end in ("lower", "upper"))
    described = Described(
        name=name,
        identifier=_identifier(name),
        chain="two axes: " + " + ".join(dict.fromkeys(operator.name for operator in parts)),
        sample_s=model.dt_s,
        command_unit=model.axes[0].command_unit,
        output_unit=model.axes[0].angle_unit,
        limits=(low, high),
        rest_command=tuple(model.rest_commands),
        tool=f"hystmpc {version_of('hystmpc')}",
    )
    token = _token((described, text.rest, text.tables, version))
    return _exported(replace(described, token=token), text, version, platforms)


def _exported(
    described: Described, text: DeviceText, version: FmuVersion, platforms: Sequence[str] | None
) -> FmuExport:
    sources = _sources(described, text, version)
    made = _binaries(described.identifier, sources, version, platforms)
    files = {
        "modelDescription.xml": model_description(described, version, _SOURCE),
        **({"sources/buildDescription.xml": build_description(described, _SOURCE)} if version == "3.0" else {}),
        **{f"sources/{file}": content for file, content in sources.items()},
    }
    return FmuExport(
        described,
        {**{path: content.encode() for path, content in files.items()}, **made},
        tuple(key for key, platform in PLATFORMS.items() if platform.path(described.identifier, version) in made),
        text.functions,
    )


def _inputs(simulator: Simulator, state: Vec) -> tuple[DescribedInput, ...]:
    """Measured inputs of a simulator, with their values in a state (S,)."""
    places = input_states(simulator.chain.operators)
    known = simulator.chain.inputs
    return tuple(DescribedInput(one.name, one.lower, one.upper, float(state[places[one.name][0]])) for one in known)


def _check(version: str) -> None:
    if version not in get_args(FmuVersion):
        raise ExportError(f"export-fmu: got FMI {version}, expected 2.0 or 3.0")


def _identifier(name: str) -> str:
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")[:60]
    return plain if re.match("[A-Za-z]", plain) else f"device_{plain}".rstrip("_")


def _token(device: tuple[object, ...]) -> str:
    """Instantiation token of the device; an FMU with another token refuses its states."""
    digits = text_hash(repr(device))
    return "{" + "-".join((digits[:8], digits[8:12], digits[12:16], digits[16:20], digits[20:32])) + "}"


def _sources(described: Described, text: DeviceText, version: str) -> Mapping[str, str]:
    major = version[0]
    head = [
        f"/* {described.chain}, {described.sample_s:g} s.",
        f" * Written by {described.tool}; any change is lost at the next export. */",
        *([f"#define FMI3_FUNCTION_PREFIX {described.identifier}_"] if version == "3.0" else []),
        ONE_FILE,
        amalgam((*_ENGINE, *text.engine)),
        f'#define HYSTMPC_TOKEN "{described.token}"',
        f"#define HYSTMPC_SAMPLE_S {number(described.sample_s)}",
        text.rest,
        "",
        text.tables,
    ]
    parts = ["\n".join(head), _device(text.part, bool(described.inputs)), _packaged(f"fmi{major}.c")]
    return {_SOURCE: "\n".join(parts), **{header: _packaged(header) for header in _HEADERS[version]}}


def _device(part: str, inputs: bool) -> str:
    """Text of device.c, completed by the sections of a part, each behind a line `@NAME@`.

    In the places `%NAME%` of a part are pieces of inputs.c, or nothing without measured inputs.
    """
    _, *sections = _SECTION.split(_packaged(f"{part}.c"))
    text = _packaged("device.c")
    for name, section in zip(sections[::2], sections[1::2], strict=True):
        text = text.replace(f"@{name}@\n", section)
    _, *pieces = _PIECE.split(_packaged("inputs.c"))
    for name, piece in zip(pieces[::2], pieces[1::2], strict=True):
        text = text.replace(f"%{name}%\n", piece if inputs else "")
    return text


def _packaged(name: str) -> str:
    return resources.files("hystmpc.codegen.fmu").joinpath("c", name).read_text(encoding="utf-8")


def _binaries(
    identifier: str, sources: Mapping[str, str], version: FmuVersion, platforms: Sequence[str] | None
) -> Mapping[str, bytes]:
    for name in platforms or ():
        if name not in PLATFORMS:
            raise ExportError(f"export-fmu: got platform {name}, {did_you_mean(name, PLATFORMS)}")
    usual = platform.machine().lower() in ("x86_64", "amd64")  # the standards have no common name for others
    host = [name for name, known in PLATFORMS.items() if usual and known.system == platform.system()]
    wanted, binaries, missing = host if platforms is None else platforms, {}, []
    for name in wanted:
        command = (compiler() if name in host else None) or zig("-target", PLATFORMS[name].target)
        if command is None:
            missing.append(name)
            continue
        flags = ["-O2", "-fvisibility=hidden", "-DFMI3_OVERRIDE_FUNCTION_PREFIX", "-s"]
        flags += [] if name == "win64" else ["-fPIC"]
        path = PLATFORMS[name].path(identifier, version)
        binaries[path] = shared_library(command, flags, sources, _SOURCE)
    if missing and platforms is not None:
        raise ExportError(
            f"export-fmu: no compiler for {', '.join(missing)}: install ziglang (pip install ziglang), or a C compiler"
        )
    return binaries
