"""Loading of model files: simulators in YAML, exports in ONNX, and built-in models `builtin:NAME`."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from hystmpc.trials.errors import ModelError, did_you_mean

from .contract.metadata import Start
from .simulator import ChainModel, load_simulator

if TYPE_CHECKING:
    from .contract.load import OnnxModel

BUILTIN = "builtin:"
_ENDINGS = (".yaml", ".onnx")


def load_model(path: Path | str, start: Start = "initial") -> ChainModel | OnnxModel:
    """Open a model file; `.simulator` of the result is the readable form of an operator-based model.

    Args:
        path: a simulator (`.yaml`), an exported model (`.onnx`), or `builtin:NAME`.
        start: state at the start of a free run: `initial` of a fresh device, `conditioned` after its first flexure.

    Raises:
        ModelError: if the ending is another, the file is missing, foreign or corrupt, or a name unknown.
    """
    path = model_path(str(path))
    suffix = path.suffix.lower()
    if suffix in (".yaml", ".yml"):
        return ChainModel(load_simulator(path), start)
    if suffix == ".onnx":
        from .contract.load import load_onnx  # onnxruntime is not loaded for a simulator

        return load_onnx(path, start)
    raise ModelError(f"{path}: ending {suffix or 'missing'}, expected a model file (.yaml, .onnx) or builtin:NAME")


def library_names() -> tuple[str, ...]:
    """Names of the built-in models, such as `tendon-catheter`."""
    return tuple(sorted(_shipped()))


def library_file(name: str) -> Path:
    """File of a built-in model.

    Raises:
        ModelError: on an unknown name; says which there are.
    """
    shipped = _shipped()
    if name not in shipped:
        raise ModelError(f"no built-in model {name!r}, {did_you_mean(name, shipped)}")
    return shipped[name]


def model_path(text: str, folder: Path | str = ".") -> Path:
    """Path of the model named in a configuration: `builtin:NAME`, or a path relative to `folder`.

    Raises:
        ModelError: on an unknown built-in name.
    """
    if text.startswith(BUILTIN):
        return library_file(text.removeprefix(BUILTIN))
    return Path(folder) / text


def absolute_name(text: str, folder: Path) -> str:
    """Name of a model as of `model_path`, absolute; `builtin:NAME` stays as it is.

    Raises:
        ModelError: on an unknown built-in name.
    """
    path = model_path(text, folder)
    return text if text.startswith(BUILTIN) else str(path)


def _shipped() -> dict[str, Path]:
    # A wheel is always unpacked, so that the folder of a resource is a real one.
    entries = (Path(str(entry)) for entry in files("hystmpc.models.library").iterdir())
    return {path.stem.replace("_", "-"): path for path in entries if path.suffix in _ENDINGS}
