"""modelDescription.xml and buildDescription.xml of an FMU, in both versions of the standard."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

TIME, COMMAND = 0, 1
"""Value references, as in c/device.c: the commands follow each other, and the outputs follow them."""

AXES = "xy"
Numbers = float | tuple[float, ...]
"""Of the command of one axis, or of each of n commands."""

# Factor and exponents of the SI base units; a unit that is not here is written without them.
_BASE_UNITS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "s": {"s": "1"},
        "m": {"m": "1"},
        "mm": {"m": "1", "factor": "0.001"},
        "um": {"m": "1", "factor": "1e-06"},
        "deg": {"rad": "1", "factor": "0.017453292519943295"},
        "rad": {"rad": "1"},
        "Pa": {"kg": "1", "m": "-1", "s": "-2"},
        "kPa": {"kg": "1", "m": "-1", "s": "-2", "factor": "1000"},
        "bar": {"kg": "1", "m": "-1", "s": "-2", "factor": "100000"},
        "N": {"kg": "1", "m": "1", "s": "-2"},
        "V": {"kg": "1", "m": "2", "s": "-3", "A": "-1"},
        "A": {"A": "1"},
    }
)
_EXPERIMENT_S = 10.0


@dataclass(frozen=True)
class DescribedInput:
    """Measured input on which a device depends: its name, the range of the identification, and its value at the start.

    Beyond that range the nearest value counts.
    """

    name: str
    lower: float
    upper: float
    start: float


@dataclass(frozen=True)
class Described:
    """Device data for the XML descriptions of an FMU.

    Attributes:
        name, identifier: for people, and for C and file names.
        chain: its operators in the order of the signal.
        limits: least and greatest command; of two axes of each command.
        rest_command: command before the first one is set; of two axes each.
        tool: program that wrote the FMU.
        token: instantiation token, equal in binary and description.
        inputs: measured inputs, whose value references follow those of the outputs.
    """

    name: str
    identifier: str
    chain: str
    sample_s: float
    command_unit: str
    output_unit: str
    limits: tuple[Numbers, Numbers]
    rest_command: Numbers
    tool: str
    token: str = ""
    inputs: tuple[DescribedInput, ...] = ()

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of the input variables: `command`; of two axes those of the log, of more than two commands numbered."""
        if not isinstance(self.rest_command, tuple):
            return ("command",)
        count = len(self.rest_command)
        return (
            tuple(f"command_{axis}" for axis in AXES)
            if count == 2
            else tuple(f"command[{k + 1}]" for k in range(count))
        )

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the output variables: `angle` if the unit is deg; of two axes those of the log."""
        if not isinstance(self.rest_command, tuple):
            return ("angle" if self.output_unit == "deg" else "output",)
        return tuple(f"angle_{axis}_deg" if self.output_unit == "deg" else f"output_{axis}" for axis in AXES)

    @property
    def signals(self) -> str:
        """Inputs and outputs with their units, in words."""
        inputs, outputs = ", ".join(self.commands), ", ".join(self.outputs)
        return f"{inputs} [{self.command_unit}] to {outputs} [{self.output_unit}]"

    @property
    def words(self) -> str:
        """One-line description of the device."""
        return f"{self.chain}; {self.signals}, a step every {self.sample_s:g} s; without the noise of a sensor"


def model_description(described: Described, version: str, source: str) -> str:
    """Return the text of modelDescription.xml."""
    root = Element("fmiModelDescription", fmiVersion=version, modelName=described.name)
    root.set("guid" if version == "2.0" else "instantiationToken", described.token)
    root.set("description", described.words)
    root.set("generationTool", described.tool)
    root.set("variableNamingConvention", "flat")
    two = version == "2.0"
    kind = SubElement(root, "CoSimulation", modelIdentifier=described.identifier)
    kind.set("canHandleVariableCommunicationStepSize", "false")
    for name in ("canGetAndSetFMU", "canSerializeFMU"):
        kind.set(f"{name}{'state' if two else 'State'}", "true")
    if two:
        root.set("numberOfEventIndicators", "0")
        SubElement(SubElement(kind, "SourceFiles"), "File", name=source)
    else:  # the FMU's sources are listed in buildDescription.xml
        kind.set("fixedInternalStepSize", repr(described.sample_s))
    _add_units(root, described)
    categories = SubElement(root, "LogCategories")
    for name in ("logStatusDiscard", "logStatusError"):
        SubElement(categories, "Category", name=name)
    stop = max(1, round(_EXPERIMENT_S / described.sample_s)) * described.sample_s
    SubElement(root, "DefaultExperiment", startTime="0", stopTime=repr(stop), stepSize=repr(described.sample_s))
    variables = SubElement(root, "ModelVariables")
    for shared, real in _variables(described):
        if two:
            SubElement(SubElement(variables, "ScalarVariable", shared), "Real", real)
        else:
            SubElement(variables, "Float64", {**shared, **real})
    _add_structure(root, described, two)
    return _text(root)


def build_description(described: Described, source: str) -> str:
    """Return the text of sources/buildDescription.xml, for a C99 shared library."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    build = SubElement(root, "BuildConfiguration", modelIdentifier=described.identifier)
    files = SubElement(build, "SourceFileSet", language="C99")
    SubElement(files, "SourceFile", name=source)
    SubElement(files, "PreprocessorDefinition", name="FMI3_OVERRIDE_FUNCTION_PREFIX", value="")
    return _text(root)


def _variables(described: Described) -> list[tuple[dict[str, str], dict[str, str]]]:
    low, high = (np.atleast_1d(ends).tolist() for ends in described.limits)
    rest, true = np.atleast_1d(described.rest_command).tolist(), "true value at the end of each step"
    rows: list[tuple[str, str, str, str, dict[str, str]]] = [("time", "independent", "", "s", {})]
    for name, least, most, start in zip(described.commands, low, high, rest, strict=True):
        held = {"min": repr(least), "max": repr(most), "start": repr(start)}
        rows.append((name, "input", "held over each step", described.command_unit, held))
    rows += [(name, "output", true, described.output_unit, {}) for name in described.outputs]
    for one in described.inputs:
        text = f"measured input, held over each step; identified from {one.lower:g} to {one.upper:g}"
        rows.append((one.name, "input", text, "", {"start": repr(one.start)}))
    variables = []
    for reference, (name, causality, text, unit, more) in enumerate(rows, TIME):
        shared = {"name": name, "valueReference": str(reference), "causality": causality, "variability": "continuous"}
        shared |= {"description": text} if text else {}
        shared |= {"initial": "calculated"} if causality == "output" else {}
        variables.append((shared, {**({"unit": unit} if unit else {}), **more}))
    return variables


def _add_structure(root: Element, described: Described, two: bool) -> None:
    first = COMMAND + len(described.commands)
    references = range(first, first + len(described.outputs))
    structure = SubElement(root, "ModelStructure")
    for group in ("Output", "InitialUnknown"):
        place = SubElement(structure, f"{group}s") if two else structure
        for reference in references:
            if two:  # the index counts variables from one
                SubElement(place, "Unknown", index=str(reference + 1), dependencies="")
            else:
                SubElement(place, group, valueReference=str(reference), dependencies="")


def _add_units(root: Element, described: Described) -> None:
    units = SubElement(root, "UnitDefinitions")
    for name in dict.fromkeys(("s", described.command_unit, described.output_unit)):
        unit = SubElement(units, "Unit", name=name)
        if name in _BASE_UNITS:
            SubElement(unit, "BaseUnit", dict(_BASE_UNITS[name]))


def _text(root: Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
