"""Configuration files: strict YAML, validated by pydantic; an unknown key is refused with the nearest known name.

PyYAML follows YAML 1.1, in which `010` is 8, `1:30` is 90 and `on` is true. Here a plain scalar is a number only in the
form of JSON (`12`, `-0.5`, `1e-3`; also `+1`, `.5`, `2.`, `.inf`, `.nan`), and a truth value only as `true` or `false`.
Everything else is text, including dates and octal, hexadecimal and sexagesimal numbers; `Settings` refuses text in
place of a number.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar, cast

import yaml
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
    model_validator,
)
from pydantic_core.core_schema import CoreSchema, no_info_before_validator_function

from .errors import ConfigError, did_you_mean, shown
from .from_outside import MEMORY, given_by

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
NotNegativeInt = Annotated[int, Field(ge=0)]
Port = Annotated[int, Field(ge=0, le=65535)]
FolderName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=80)]
"""Name that also serves as the name of a folder of a run."""
LARGEST_FILE = 4_000_000  # bytes of a configuration


DEEPEST = 100  # levels of blocks within blocks
MOST_ENTRIES = 500_000  # keys, values and blocks; an alias counts with its whole content
LONGEST_INTEGER = 100  # digits

_TAG = "tag:yaml.org,2002:"
_BOOLEANS = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INTEGER = re.compile(r"[-+]?(?:0|[1-9][0-9]*)\Z")
_NUMBER = re.compile(
    r"(?:[-+]?(?:(?:0|[1-9][0-9]*)(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))\Z"
)
_FIRST_OF_NUMBER = [*"-+.0123456789"]


class YamlError(ValueError):
    """One-line error on a text that is not strict YAML.

    Attributes:
        line, column: position, from 1; None if unknown.
    """

    def __init__(self, problem: str, line: int | None = None, column: int | None = None) -> None:
        super().__init__(" ".join(problem.split()))
        self.line: int | None = line
        self.column: int | None = column


def _refusal(problem: str, mark: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=mark)


class _StrictLoader(yaml.SafeLoader):
    """Strict YAML loader (see the module) that checks its bounds before any object is built."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = self._entries = 0
        self._sizes: dict[int, int] = {}  # entries of each anchored node, itself included

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node and its content within the bounds of depth and size."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]  # the stubs leave it open
        before = self._entries
        if self._depth >= DEEPEST:
            raise _refusal(f"nested deeper than {DEEPEST} levels", event.start_mark)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        if not isinstance(event, yaml.AliasEvent):
            self._entries += 1
            if event.anchor is not None:
                self._sizes[id(node)] = self._entries - before
        elif id(node) in self._sizes:
            self._entries += self._sizes[id(node)]
        else:
            raise _refusal(f"alias *{event.anchor} inside its own block", event.start_mark)
        if self._entries > MOST_ENTRIES:
            problem = f"more than {MOST_ENTRIES} entries, each alias counted with all that it stands for"
            raise _refusal(problem, event.start_mark)
        return node

    def compose_mapping_node(self, anchor: Any) -> Any:
        """Compose a block and refuse a repeated key, before `<<` merges others into it."""
        node = super().compose_mapping_node(anchor)
        lines: dict[tuple[str, str], int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            name = key.tag, key.value
            if name in lines:
                problem = f"key {key.value!r} stands twice in one block, first on line {lines[name]}"
                raise _refusal(problem, key.start_mark)
            lines[name] = key.start_mark.line + 1
        return node

    def truth_value(self, node: Any) -> bool:
        """Construct a truth value from `true` or `false`."""
        text = self.construct_scalar(node)
        if text not in _BOOLEANS:
            raise _refusal(f"got {text!r}, expected true or false", node.start_mark)
        return _BOOLEANS[text]

    def integer(self, node: Any) -> int:
        """Construct a decimal integer of bounded length."""
        text = self.construct_scalar(node)
        if not _INTEGER.match(text):
            raise _refusal(f"got {text[:40]!r}, expected a decimal integer", node.start_mark)
        if len(text) > LONGEST_INTEGER:
            problem = f"got an integer of {len(text)} characters, expected at most {LONGEST_INTEGER}"
            raise _refusal(problem, node.start_mark)
        return int(text)

    def number(self, node: Any) -> float:
        """Construct a decimal number, an infinity or not-a-number."""
        text = self.construct_scalar(node)
        if not _NUMBER.match(text):
            raise _refusal(f"got {text[:40]!r}, expected a decimal number", node.start_mark)
        return float(re.sub(r"\.(?=[iInN])", "", text))


_StrictLoader.yaml_implicit_resolvers = {}
for _name, _pattern, _first in (
    ("bool", re.compile(f"(?:{'|'.join(_BOOLEANS)})\\Z"), [*"tTfF"]),
    ("int", _INTEGER, _FIRST_OF_NUMBER),
    ("float", _NUMBER, _FIRST_OF_NUMBER),
    ("null", re.compile(r"(?:~|null|Null|NULL|)\Z"), [*"~nN", ""]),
    ("merge", re.compile(r"<<\Z"), ["<"]),
):
    _StrictLoader.add_implicit_resolver(f"{_TAG}{_name}", _pattern, _first)
_StrictLoader.yaml_constructors = {
    f"{_TAG}bool": _StrictLoader.truth_value,
    f"{_TAG}int": _StrictLoader.integer,
    f"{_TAG}float": _StrictLoader.number,
    f"{_TAG}null": _StrictLoader.construct_yaml_null,
    f"{_TAG}str": _StrictLoader.construct_yaml_str,
    f"{_TAG}seq": _StrictLoader.construct_yaml_seq,
    f"{_TAG}map": _StrictLoader.construct_yaml_map,
    None: _StrictLoader.construct_undefined,  # any other tag is refused
}


def parse_yaml(text: str) -> Any:
    """Parse strict YAML into plain data: mappings, lists, texts, numbers, truth values and None.

    Raises:
        YamlError: if the text is not YAML, repeats a key in one block, has an unknown tag, an alias inside its own
            block or a too long integer, or is deeper or larger than the bounds above.
    """
    return _read(text, _StrictLoader.get_single_data)


def _read(text: str, get: Any) -> Any:
    try:
        loader = _StrictLoader(text)
        try:
            return get(loader)
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        mark, problem = error.problem_mark, str(error.problem)
        place = (mark.line + 1, mark.column + 1) if mark is not None else (None, None)
        raise YamlError(f"{error.context}, {problem}" if problem.startswith("but ") else problem, *place) from None
    except yaml.YAMLError as error:
        raise YamlError(str(error)) from None


class _Dumper(yaml.SafeDumper):
    """YAML writer that quotes every text that `parse_yaml` or YAML 1.1 would read as another type."""


def _text(dumper: Any, text: str) -> Any:
    """Represent a text, with double quotes if it has a Unicode line break."""
    style = '"' if re.search("[\x85\u2028\u2029]", text) else None
    return dumper.represent_scalar(f"{_TAG}str", text, style=style)


_Dumper.add_representer(str, _text)
_Dumper.add_implicit_resolver(f"{_TAG}float", _NUMBER, _FIRST_OF_NUMBER)


Location = Sequence[str | int]


class MisplacedError(ValueError):
    """Error of a validator that knows the offending entry within its block.

    Args:
        at: keys and indices from the validated block to the entry.
    """

    def __init__(self, message: str, at: Location = ()) -> None:
        super().__init__(message)
        self.at: tuple[str | int, ...] = tuple(at)


def line_of(text: str, at: Location) -> int | None:
    """Line, from 1, of the entry at keys and indices `at`, or of the innermost existing block around it.

    Entries of `at` that are no key of the file are ignored. None if the text is no YAML or nothing of `at` exists.
    """
    try:
        node: yaml.Node | None = _read(text, _StrictLoader.get_single_node)
    except YamlError:
        return None
    line = None
    for part in at:
        entry = _entry(node, part)
        if entry is not None:
            line, node = entry
    return line


def place_in(path: Path | str, overrides: Sequence[str] = ()) -> Callable[[Location], str]:
    """Function that names the place of an entry: `file.yaml, line 3`, or the override that set it."""

    def place(at: Location) -> str:
        parts = [str(part) for part in at]
        for text in reversed(overrides):
            changed = text.partition("=")[0].split(".")
            if parts[: len(changed)] == changed:
                return f"{path}, --set {text}"
        try:
            line = line_of(Path(path).read_text(encoding="utf-8"), at)
        except (OSError, UnicodeDecodeError):
            line = None
        return str(path) if line is None else f"{path}, line {line}"

    return place


def _entry(node: yaml.Node | None, part: str | int) -> tuple[int, yaml.Node] | None:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value == str(part):
                return key.start_mark.line + 1, value
    if isinstance(node, yaml.SequenceNode) and isinstance(part, int) and 0 <= part < len(node.value):
        item = node.value[part]
        return item.start_mark.line + 1, item
    return None


def _number_only(value: Any) -> Any:
    """Refuse text and truth values, which pydantic would convert to a number."""
    if isinstance(value, str | bool):
        raise ValueError("expected a valid number")
    return value


def _checked_numbers(schema: Any) -> Any:
    """Schema of pydantic in which `_number_only` stands before every number."""
    if isinstance(schema, list | tuple):
        return type(schema)(map(_checked_numbers, schema))
    if not isinstance(schema, dict):
        return schema
    inner = {key: part if key in _NO_SCHEMA else _checked_numbers(part) for key, part in schema.items()}
    number = schema.get("type") in ("int", "float")
    return no_info_before_validator_function(_number_only, cast(CoreSchema, inner)) if number else inner


_NO_SCHEMA = ("default", "metadata", "ref", "schema_ref", "expected", "serialization")


class Settings(BaseModel):
    """Base of every configuration block: frozen, no unknown keys, units in the key names.

    Text and truth values in place of a number are refused; pydantic alone would convert them.

    Raises:
        ConfigError: through `parse`; pydantic's ValidationError if built directly.
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True
    )

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if isinstance(data, dict) and cls.model_config.get("extra") == "forbid":
            for key in data:
                if key not in cls.model_fields:
                    raise MisplacedError(f"unknown key {key!r}, {did_you_mean(str(key), cls.model_fields)}", (key,))
        return data

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Schema in which text and truth values are no numbers."""
        made: CoreSchema = _checked_numbers(handler(source))
        return made

    @classmethod
    def parse(cls, data: Any, where: str | Callable[[Location], str] = MEMORY) -> Self:
        """Validate plain data.

        Args:
            where: name of the source, or a function from keys and indices of an entry to its place; `MEMORY` stands for
                data of the program itself, which may name its classes.

        Raises:
            ConfigError: one line with the first offending key, the actual and the expected value.
        """
        try:
            with given_by(where):
                return cls.model_validate(data)
        except ValidationError as error:
            first = error.errors()[0]
            cause = first.get("ctx", {}).get("error")
            inner = getattr(cause, "at", ())
            path = ".".join(str(p) for p in first["loc"]) or "top level"
            more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
            plain = "expected a list, such as [1, 2]" if first["type"] == "tuple_type" else str(first["msg"])
            text = plain.removeprefix("Value error, ")
            got = "" if isinstance(first["input"], dict) else f", got {shown(first['input'])}"
            place = where if isinstance(where, str) else where((*first["loc"], *inner))
            raise ConfigError(" ".join(f"{place}: {path}: {text}{got}{more}".split())) from None


def _two_numbers(value: Any) -> Any:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError("expected a list [x, y], a number for each axis")
    return value


OfBothAxes = BeforeValidator(_two_numbers)
"""Of a field of two axes, in `Annotated[tuple[float, float], OfBothAxes]`: what is no pair is refused as such."""

S = TypeVar("S", bound=Settings)


def read_yaml(path: Path | str) -> Any:
    """Read plain data from a file of strict YAML.

    Raises:
        ConfigError: if the file cannot be read, is larger than `LARGEST_FILE` or is not strict YAML; names file, line
            and column.
    """
    try:
        with Path(path).open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
        if len(content) > LARGEST_FILE:
            raise ConfigError(f"{path}: larger than {LARGEST_FILE} bytes, expected a configuration")
        return parse_yaml(content.decode("utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"{path}: cannot be read ({reason}), expected a YAML file") from None
    except YamlError as error:
        place = "" if error.line is None else f", line {error.line} column {error.column}"
        raise ConfigError(f"{path}{place}: not usable YAML ({error})") from None


def load_settings(kind: type[S], path: Path | str, overrides: Iterable[str] = ()) -> S:
    """Read a YAML file, apply overrides such as `a.b=3` and validate it as `kind`.

    Raises:
        ConfigError: on an unreadable file, a malformed override, an unknown key or a value out of bounds; names file
            and line, or the override, of the first offending key.
    """
    data, changes = read_yaml(path), tuple(overrides)
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: got {type(data).__name__}, expected a mapping of settings")
    for text in changes:
        override(data, text)
    return kind.parse(data, place_in(path, changes))


def override(data: dict[str, Any], text: str) -> None:
    """Apply an override such as `a.b=3` to nested mappings, in place.

    Raises:
        ConfigError: on a malformed override, or a key of a value that is no mapping.
    """
    key, separator, value = text.partition("=")
    if not separator or not key:
        raise ConfigError(f"--set {text}: expected KEY.KEY=VALUE")
    *parents, leaf = key.split(".")
    node = data
    for name in parents:
        node = node.setdefault(name, {})
        if not isinstance(node, dict):
            raise ConfigError(f"--set {text}: {name!r} is a value, expected a mapping")
    try:
        node[leaf] = parse_yaml(value)
    except YamlError as error:
        raise ConfigError(f"--set {shown(text)[1:-1]}: not a YAML value ({error})") from None


def dump_yaml(data: Any) -> str:
    """Write plain data as YAML in the given order; `parse_yaml` and YAML 1.1 read back the same data."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True)
