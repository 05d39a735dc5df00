"""A tree of structs as C text: constant tables and structs in the order of need, each once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, final

import numpy as np

from hystmpc.core.structs import Field, Struct, fields_of
from hystmpc.models.networks.packed import NetworkWeights, network_facts, network_numbers
from hystmpc.models.networks.route import NetworkRoute
from hystmpc.trials.errors import ExportError

from .literals import literal
from .straight import shortened

_WIDTH = 116  # characters of a line
_SUFFIX: Mapping[str, str] = {"uint32_t": "U", "int64_t": "LL", "uint64_t": "ULL"}

LINE = """#ifdef __GNUC__
#define EXPORTED_LINE __attribute__((aligned(64))) /* where a vector may lie */
#else
#define EXPORTED_LINE
#endif
"""
"""Macro for tables of a network, in front of the text."""


@final
class Numbers:
    """Constant tables and structs as C text.

    Args:
        single: whether the engine's `real` is float, else double.
        lanes: units of a panel for which the weights of networks are packed, the export's HYSTMPC_LANES.

    Attributes:
        chains: whole numbers of every chain that was put, by the name of its array, which holds them `shortened`.
    """

    def __init__(self, single: bool, lanes: int) -> None:
        self._single, self._lanes = single, lanes
        self._texts: list[str] = []
        self._names: dict[tuple[str, str], str] = {}
        self.chains: dict[str, list[int]] = {}

    @property
    def text(self) -> str:
        """Text of all that was put."""
        return "\n".join([*self._texts, ""])

    def put(self, struct: Struct, name: str = "") -> str:
        """Add a struct and all that it points to; returns the name of its variable.

        Args:
            name: of the variable; numbered where left out.

        Raises:
            ExportError: if a part of it is written in Python.
        """
        return self._variable("s", struct.name, "", self._fields(struct), name)

    def _variable(self, letter: str, kind: str, after: str, value: str, name: str = "") -> str:
        """Name of the variable of this value, which is made once."""
        key = f"{kind}{after}", value
        if key not in self._names:
            self._names[key] = name or f"{letter}{len(self._names)}"
            self._texts.append(f"static const {kind} {self._names[key]}{after} = {value};")
        return self._names[key]

    def _fields(self, struct: Struct) -> str:
        """Initialiser of a struct; what is null is left out."""
        known = {field.name: field for field in fields_of(struct.name)}
        given = {name: self._value(known[name], value) for name, value in struct.fields.items()}
        return _braces(f".{name} = {text}" for name, text in given.items() if text)

    def _value(self, field: Field, value: Any) -> str:
        if field.arguments is not None:
            raise ExportError(f"export-c: got a part written in Python ({field.name}), expected one of the package")
        if isinstance(value, Struct):
            return f"&{self.put(value)}" if field.stars else self._fields(value)
        if isinstance(value, NetworkRoute):
            return f"&{self._network(value.weights)}.head"
        if isinstance(value, np.ndarray):
            return self._array(field, value)
        return self._number(field.kind, value)

    def _array(self, field: Field, values: Any) -> str:
        if not values.size:
            return ""
        if field.name == "chain":
            return self._chain(values.tolist())
        text = _braces(self._number(field.kind, value) for value in values.ravel().tolist())
        if field.stars:
            return self._variable("a", field.kind, "[]", text)
        return text if values.ndim == 1 else _nested(values.shape, text)

    def _chain(self, words: list[int]) -> str:
        """Name of a chain, without the instructions that are C; two of the same name are the same in full."""
        for name, other in self.chains.items():
            if words == other:
                return name
        name = f"c{len(self.chains)}"
        self.chains[name] = words
        self._texts.append(f"static const int {name}[] = {_braces(map(str, shortened(words)))};")
        return name

    def _number(self, kind: str, value: float) -> str:
        if kind in ("real", "hystmpc_real", "double", "float"):
            return literal(value, single=kind == "float" or (self._single and kind != "double"))
        return f"(-{-value - 1} - 1)" if value < -(2**31 - 1) else f"{value}{_SUFFIX.get(kind, '')}"

    def _network(self, weights: NetworkWeights) -> str:
        """A network and its numbers behind it, as core/network.h describes them."""
        numbers = network_numbers(weights, self._lanes)
        kinds = {field.name: field.kind for field in fields_of("hystmpc_network")}
        head = [f".{name} = {self._number(kinds[name], value)}" for name, value in network_facts(weights).items()]
        floats = _braces(literal(value, single=True) for value in numbers.tolist())
        kind = f"struct {{ hystmpc_network head; float numbers[{numbers.size}]; }}"
        return self._variable("n", kind, " EXPORTED_LINE", f"{{{_braces(head)},\n {floats}}}")


def _braces(texts: Iterable[str]) -> str:
    """Texts in braces, in lines of some width."""
    lines, line = [], "{"
    for text in texts:
        if len(line) + len(text) > _WIDTH:
            lines.append(line.rstrip())
            line = " "
        line += f"{text}, "
    lines.append(line.removesuffix(", ") + "}")
    return "\n".join(lines)


def _nested(shape: tuple[int, ...], text: str) -> str:
    raise ExportError(f"export-c: got a table of shape {shape} in a struct, expected one row: {text[:40]}")
