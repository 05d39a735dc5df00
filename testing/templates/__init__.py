"""Templates of external classes: each a folder with class, contract tests that pass, and settings."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType

from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.run_folder import require_vacant

KINDS: Mapping[str, str] = MappingProxyType(
    {"transport": "new-transport", "effect": "new-effect", "controller": "new-controller"}
)
"""Kinds of classes, and the folder of the template of each."""


def write_template(kind: str, folder: Path) -> tuple[Path, ...]:
    """Write the template of a kind of class into a new or empty folder, and return its files.

    Raises:
        ConfigError: if there is no such kind, or the folder holds something or cannot be written.
    """
    if kind not in KINDS:
        raise ConfigError(f"new {kind}: unknown kind, {did_you_mean(kind, KINDS)}")
    require_vacant(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for source in sorted(
        files("hystmpc.testing.templates").joinpath(KINDS[kind]).iterdir(), key=lambda file: file.name
    ):
        target = folder / source.name.removesuffix(".txt")
        target.write_text(source.read_text(encoding="utf-8"), encoding="utf-8")
        written.append(target)
    return tuple(written)
