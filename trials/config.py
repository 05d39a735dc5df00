"""Configuration files: YAML, validated by pydantic; an unknown key is refused with the nearest known name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Self, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from .errors import ConfigError, did_you_mean, shown
from .from_outside import MEMORY, given_by
from .yaml_ import Location, MisplacedError, YamlError, format_yaml, parse_yaml, place_in

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
NotNegativeInt = Annotated[int, Field(ge=0)]
Port = Annotated[int, Field(ge=0, le=65535)]
FolderName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=80)]
"""A name that becomes a folder of a run."""
LARGEST_FILE = 4_000_000  # bytes of a configuration


class _MisreadError(MisplacedError):
    """Text or a truth value where a number is expected."""


class Settings(BaseModel):
    """Base of every configuration block: frozen, no unknown keys, units in the key names.

    A number has to be given as a number: text and truth values, which pydantic would convert, are refused.

    Raises:
        ConfigError: through `parse`; pydantic's ValidationError if built directly.
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, validate_default=True
    )

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if isinstance(data, dict):
            for key in data:
                if key not in cls.model_fields:
                    raise MisplacedError(f"unknown key {key!r}, {did_you_mean(str(key), cls.model_fields)}", (key,))
        return data

    @model_validator(mode="before")
    @classmethod
    def _numbers_are_numbers(cls, data: Any) -> Any:
        if isinstance(data, dict):
            for key, field in cls.model_fields.items():
                misread = _misread_number(data[key], field.annotation) if key in data else None
                if misread is not None:
                    raise _MisreadError(f"expected a valid number, got {shown(misread[1])}", (key, *misread[0]))
        return data

    @classmethod
    def parse(cls, data: Any, where: str | Callable[[Location], str] = MEMORY) -> Self:
        """Validate plain data.

        Args:
            data: mappings, lists and scalars.
            where: the source's name, or a function that tells it for the keys and indices of an entry; left out, they
                are the program's own, and may name classes of it.

        Raises:
            ConfigError: one line with the first offending key, what was got and what was expected.
        """
        try:
            with given_by(where):
                return cls.model_validate(data)
        except ValidationError as error:
            first = error.errors()[0]
            cause = first.get("ctx", {}).get("error")
            inner = getattr(cause, "at", ())
            entry = (*first["loc"], *inner) if isinstance(cause, _MisreadError) else first["loc"]
            path = ".".join(str(p) for p in entry) or "top level"
            more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
            text = str(first["msg"]).removeprefix("Value error, ")
            got = "" if isinstance(first["input"], dict) else f", got {shown(first['input'])}"
            place = where if isinstance(where, str) else where((*first["loc"], *inner))
            raise ConfigError(" ".join(f"{place}: {path}: {text}{got}{more}".split())) from None


def _misread_number(value: Any, annotation: Any) -> tuple[tuple[Any, ...], Any] | None:
    """First text or Boolean in `value` at a place where `annotation` allows only numbers.

    pydantic turns `true` into 1.0 and `"010"` into 10.0. Blocks (pydantic models) look after their own fields.

    Args:
        value: plain data.
        annotation: of the field.

    Returns:
        Keys and indices from `value` to the entry, and the entry; None where there is none.
    """
    members = tuple(_members(annotation))
    if isinstance(value, str | bool):
        kinds = set(members) - {NoneType}
        return ((), value) if kinds and kinds <= {int, float} else None
    for member in members:
        for key, item, inner in _items(value, get_origin(member), get_args(member)):
            if (misread := _misread_number(item, inner)) is not None:
                return (key, *misread[0]), misread[1]
    return None


def _members(annotation: Any) -> Iterator[Any]:
    """What a value may be: the members of unions, without constraints."""
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from _members(get_args(annotation)[0])
    elif origin in (Union, UnionType):
        for member in get_args(annotation):
            yield from _members(member)
    else:
        yield annotation


def _items(value: Any, origin: Any, of: tuple[Any, ...]) -> Iterator[tuple[Any, Any, Any]]:
    """Key or index, entry and annotation of everything in a container."""
    if not isinstance(origin, type) or not of:
        return
    if isinstance(value, Mapping) and issubclass(origin, Mapping) and len(of) == 2:
        yield from ((key, item, of[1]) for key, item in value.items())
    elif isinstance(value, list | tuple):
        if origin is tuple and of[-1] is not Ellipsis:
            yield from ((k, item, inner) for k, (item, inner) in enumerate(zip(value, of, strict=False)))
        elif issubclass(origin, Sequence):
            yield from ((k, item, of[0]) for k, item in enumerate(value))


S = TypeVar("S", bound=Settings)


def read_yaml(path: Path | str) -> Any:
    """Read plain data from a YAML file; see `yaml_` for what is refused that YAML 1.1 would read otherwise.

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
    """Read `path`, apply `a.b=3` overrides and validate as `kind`.

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
    """Set `a.b=3` in nested mappings, in place.

    Raises:
        ConfigError: on a malformed change, or a key of a value that is no mapping.
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
    """Return plain data as YAML in the order given."""
    return format_yaml(data)
