"""Where the models that ship with the package lie, and what `builtin:NAME` means."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from hystmpc.trials.errors import ModelError, did_you_mean

BUILTIN = "builtin:"
_ENDINGS = (".yaml", ".onnx")


def library_names() -> tuple[str, ...]:
    """Names of the models that ship with the package, such as `tendon-catheter`."""
    return tuple(sorted(_shipped()))


def library_file(name: str) -> Path:
    """File of a model that ships with the package.

    Raises:
        ModelError: on an unknown name; says which there are.
    """
    shipped = _shipped()
    if name not in shipped:
        raise ModelError(f"no built-in model {name!r}, {did_you_mean(name, shipped)}")
    return shipped[name]


def model_path(text: str, folder: Path | str = ".") -> Path:
    """File that a configuration names: `builtin:NAME`, or a path that starts at `folder` where it is relative.

    Raises:
        ModelError: on an unknown built-in name.
    """
    if text.startswith(BUILTIN):
        return library_file(text.removeprefix(BUILTIN))
    return Path(folder) / text


def _shipped() -> dict[str, Path]:
    # A wheel is always unpacked, so that the folder of a resource is a real one.
    entries = (Path(str(entry)) for entry in files("hystmpc.models.library").iterdir())
    return {path.stem.replace("_", "-"): path for path in entries if path.suffix in _ENDINGS}
