"""Outputs of the tasks: existing or write-protected files are refused before any computation."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hystmpc.trials.config import read_yaml
from hystmpc.trials.errors import ConfigError, HystmpcError
from hystmpc.trials.files import require_writable
from hystmpc.trials.run_folder import require_vacant


@dataclass(frozen=True)
class Output:
    """A kind of output file."""

    what: str  # its name, with an article, for messages
    endings: tuple[str, ...]  # of its file names, in lower case
    format_of: Callable[[Path], str]  # format of a file; empty, or a reading error, for any other file
    formats: tuple[str, ...]  # permitted beginnings of the format

    def is_one(self, path: Path) -> bool:
        """Whether a file is of this kind, in any version."""
        try:
            return self.format_of(path).startswith(self.formats)
        except (OSError, ValueError, LookupError, RecursionError, HystmpcError, zipfile.BadZipFile):
            return False


def _of_model(path: Path) -> str:
    from hystmpc.models.contract.load import parse_model
    from hystmpc.models.contract.metadata import PREFIX

    entries = parse_model(path.read_bytes(), str(path)).metadata_props
    return next((str(entry.value) for entry in entries if entry.key == f"{PREFIX}format"), "").strip('"')


def _of_data(path: Path) -> str:
    data = json.loads(path.read_text(encoding="utf-8")) if path.suffix.lower() == ".json" else read_yaml(path)
    return str(data.get("format", "")) if isinstance(data, dict) else ""


def _of_text(path: Path) -> str:
    with path.open(encoding="utf-8") as file:
        head = file.read(1000)
    marks = ('<meta name="generator" content="hystmpc">', "Written by hystmpc")
    return "hystmpc" if any(mark in head for mark in marks) else ""


def _of_fmu(path: Path) -> str:
    with zipfile.ZipFile(path) as archive:
        description = archive.read("modelDescription.xml").decode("utf-8")
    return "hystmpc" if 'generationTool="hystmpc' in description else ""


MODEL = Output("an ONNX model of hystmpc", (".onnx",), _of_model, ("hystmpc-model/", "hystmpc-two-axes-model/"))
SIMULATOR = Output("a simulator file", (".yaml", ".yml"), _of_data, ("hystmpc-simulator/", "hystmpc-two-axes/"))
_EVALUATIONS = ("hystmpc-evaluation/", "hystmpc-inverse-evaluation/", "hystmpc-two-axis-evaluation/")
EVALUATION = Output("an evaluation", (".json",), _of_data, _EVALUATIONS)
BENCHMARK = Output("a benchmark's result", (".json",), _of_data, ("hystmpc-bench/",))
C_CODE = Output("an exported controller", (".c", ".h"), _of_text, ("hystmpc",))
FMU = Output("an FMU of hystmpc", (".fmu",), _of_fmu, ("hystmpc",))
REPORT = Output("a report of hystmpc", (".html",), _of_text, ("hystmpc",))


def check_figures(figures: Path | str | None) -> None:
    """Refuse a folder of `--figures` that is not vacant.

    Raises:
        ConfigError: if it is not new or empty, or cannot be written.
    """
    if figures is not None:
        require_vacant(figures)


def check_page(page: Path | str | None, figures: Path | str | None, inputs: Iterable[Path], force: bool) -> None:
    """Refuse a page of `--report`, or a folder of its `--figures`, that may not be written.

    Raises:
        ConfigError: if the page or its figures may not be written.
    """
    if page is not None:
        check_output("--report", page, (REPORT,), inputs, force)
    elif figures is not None:
        raise ConfigError(f"--figures {figures}: is of the page of --report, which is not given")
    check_figures(figures)


def check_output(
    option: str,
    path: Path | str,
    kinds: Sequence[Output],
    inputs: Iterable[Path] = (),
    force: bool = False,
    of: str = "",
) -> None:
    """Refuse a path that may not be written; only `--force` replaces a file, and only one of the same kind.

    Args:
        option: option of the file, for messages.
        path: the file.
        kinds: permitted kinds, selected by the ending.
        inputs: input files of the same call, which must not be replaced.
        force: whether an older file may be replaced.
        of: content of the file, for the message on a wrong ending.

    Raises:
        ConfigError: if the ending is none of the kinds, the path is a folder or an input or cannot be written, or an
            existing file may not be replaced.
    """
    path = Path(path)
    where = f"{option} {path}"
    kind = next((kind for kind in kinds if path.suffix.lower() in kind.endings), None)
    if kind is None:
        endings = " or ".join(ending for kind in kinds for ending in kind.endings)
        raise ConfigError(f"{where}: expected a file ending in {endings}{f' for {of}' if of else ''}")
    try:
        require_writable(path)
    except ConfigError as error:
        raise ConfigError(f"{option} {error}") from None
    if path.is_dir():
        raise ConfigError(f"{where}: is a folder, expected a file")
    for other in inputs:
        if _same(path, other):
            raise ConfigError(f"{where}: is read by the same command ({other}), expected another file")
    if os.path.lexists(path):
        if not force:
            raise ConfigError(f"{where}: exists, expected a new file; --force replaces it if it is {kind.what}")
        if not kind.is_one(path):
            raise ConfigError(f"{where}: exists and is not {kind.what}, which is all that --force replaces")


def _same(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)
    except (OSError, ValueError):  # one of them does not exist
        return False
