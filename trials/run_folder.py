"""Run folder: the files of every simulation, experiment, study and diagnosis, for replay."""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from filelock import FileLock, Timeout
from numpy.typing import ArrayLike, NDArray

from . import mcap_
from .config import Settings, dump_yaml, read_yaml
from .csv_files import format_table, read_csv
from .errors import ConfigError, LogError
from .files import require_writable, write_atomically
from .formats import read_lines
from .json_text import file_hash
from .layouts import CANONICAL, TWO_AXES
from .tables import read_table
from .trial import Trial

if TYPE_CHECKING:
    from .report import Report

FORMAT = "hystmpc-run/1"
_META = {"start": str, "versions": dict}  # required keys of meta.json
_PACKAGES = ("hystmpc", "numpy", "casadi", "onnxruntime", "osqp")

Column = NDArray[np.float64] | tuple[str, ...]


@dataclass(frozen=True)
class RunFolder:
    """One run on disk: `config.yaml`, `meta.json`, `log.csv`, `log.mcap` (if `mcap` is installed), `report.html`.

    Every file is written completely or not at all. Use `create` for a new run and `open` for an existing one.

    Attributes:
        meta: content of `meta.json`: format, versions, seed, model hashes, host, start, command line.
    """

    path: Path
    meta: Mapping[str, Any]

    @classmethod
    def create(
        cls,
        path: Path | str,
        settings: Settings | Mapping[str, Any],
        *,
        seed: int | None = None,
        models: Iterable[Path | str] = (),
        command_line: Sequence[str] | None = None,
    ) -> RunFolder:
        """Start a run: make the folder and write settings and metadata.

        Args:
            seed: of the run's random numbers; None without random numbers.
            models: model files of the run; their SHA-256 is stored.
            command_line: command line of the run; that of this process if left out.

        Raises:
            ConfigError: if the path is a file, a folder that is not empty, or cannot be made; or a model is missing.
        """
        folder, installed = Path(path), dict[str, str]()
        require_vacant(folder)
        for name in _PACKAGES:
            with suppress(PackageNotFoundError):
                installed[name] = version(name)
        meta = {
            "format": FORMAT,
            "start": datetime.now(UTC).isoformat(),
            "host": platform.node(),
            "platform": platform.platform(),
            "command_line": list(sys.argv if command_line is None else command_line),
            "seed": seed,
            "models": {str(model): file_hash(Path(model)) for model in models},
            "versions": {"python": platform.python_version()} | dict.fromkeys(_PACKAGES) | installed,
        }
        plain = settings.model_dump(mode="json") if isinstance(settings, Settings) else dict(settings)
        try:
            write_atomically(folder / "config.yaml", dump_yaml(plain))
            write_atomically(folder / "meta.json", json.dumps(meta, indent=2) + "\n")
        except OSError as error:
            raise ConfigError(f"{folder}: cannot be written ({error.strerror}), expected a writable folder") from None
        return cls(folder, meta)

    @classmethod
    def open(cls, path: Path | str) -> RunFolder:
        """Open an existing run folder.

        Raises:
            LogError: if the folder holds no run, or one of another format.
        """
        file = Path(path) / "meta.json"
        try:
            meta = json.loads(file.read_text(encoding="utf-8"))
        except OSError:
            raise LogError(f"{path}: no readable meta.json, expected the folder of a run") from None
        except (ValueError, RecursionError) as error:
            raise LogError(f"{file}: not JSON ({error})") from None
        written = meta.get("format") if isinstance(meta, dict) else None
        if written != FORMAT:
            raise LogError(f"{file}: format {written!r}, expected {FORMAT!r}")
        if gone := [name for name, kind in _META.items() if not isinstance(meta.get(name), kind)]:
            raise LogError(f"{file}: lacks {', '.join(gone)}, expected what a run writes there")
        return cls(Path(path), meta)

    def write_log(self, columns: Mapping[str, ArrayLike | Sequence[str]]) -> None:
        """Write `log.csv`, and `log.mcap` if `mcap` is installed.

        Args:
            columns: `time_s`, `command` (or `command_bar`, ...), `angle_deg`, or those of two axes, then any further
                numbers or texts, each (T,).

        Raises:
            LogError: if a canonical column is missing or lengths differ.
        """
        if (gone := CANONICAL.missing(list(columns))) and TWO_AXES.missing(list(columns)):
            raise LogError(f"{self.path}: log lacks {', '.join(gone)}; got {', '.join(columns)}")
        arrays = {name: _column(values) for name, values in columns.items()}
        lengths = {name: len(values) for name, values in arrays.items()}
        if len(set(lengths.values())) > 1:
            raise LogError(f"{self.path}: log columns of different lengths, expected one: {lengths}")
        write_atomically(self.path / "log.csv", format_table(arrays))
        if mcap_.available():
            start_ns = round(1e9 * datetime.fromisoformat(self.meta["start"]).timestamp())
            t = np.asarray(arrays[CANONICAL.time], dtype=np.float64)
            write_atomically(self.path / "log.mcap", mcap_.format_mcap(arrays, t, start_ns))

    def write_report(self, report: Report) -> Path:
        """Write `report.html`."""
        return report.save(self.path / "report.html")

    def config(self) -> Any:
        """Resolved settings of the run, as plain data."""
        return read_yaml(self.path / "config.yaml")

    def log(self) -> dict[str, Column]:
        """All columns of `log.csv`: numbers as arrays (T,), texts as tuples."""
        file = self.path / "log.csv"
        table = read_table(read_lines(file), str(file))
        return {name: table.numbers[name] if name in table.numbers else table.texts[name] for name in table.header}

    def trial(self) -> Trial:
        """The log as a trial, for replay or identification; columns of text are left out."""
        file = self.path / "log.csv"
        header = read_lines(file)[0].split(",")
        return read_csv(file, TWO_AXES if CANONICAL.missing(header) and not TWO_AXES.missing(header) else CANONICAL)


def require_vacant(folder: Path | str) -> None:
    """Refuse a folder that is not empty, so that a run never overwrites files.

    Raises:
        ConfigError: if the path is a file, a folder that is not empty, or cannot be written.
    """
    folder = Path(folder)
    require_writable(folder)
    if folder.is_dir():
        try:
            inside = sorted(entry.name for entry in folder.iterdir())
        except OSError as error:
            raise ConfigError(f"{folder}: cannot be read ({error.strerror}), expected a new or empty folder") from None
        if inside:
            what = "holds a run" if "meta.json" in inside else "is not empty"
            names = ", ".join(inside[:5]) + (", ..." if len(inside) > 5 else "")
            raise ConfigError(f"{folder}: {what} ({names}), expected a new or empty folder")
    elif os.path.lexists(folder):
        raise ConfigError(f"{folder}: is a file, expected a new or empty folder")


def take_back(folder: Path, files: Iterable[str] = (), made: bool = True) -> None:
    """Remove the settings, the metadata and these files of a run that did not begin, and a folder `made` for it."""
    with suppress(OSError):
        for name in ("config.yaml", "meta.json", *files):
            (folder / name).unlink(missing_ok=True)
        if made:
            folder.rmdir()


def require_resumable(folder: Path | str) -> None:
    """Refuse a folder that is neither empty nor a run that can be resumed.

    Raises:
        ConfigError: if the path is a file, a folder that holds something else, or cannot be written.
        LogError: if it is the folder of a run of another format.
    """
    folder = Path(folder)
    if (folder / "meta.json").is_file():
        require_writable(folder)
        RunFolder.open(folder)
    else:
        require_vacant(folder)


def resumed_folder(path: Path, settings: Mapping[str, Any], seed: int, refusal: Callable[[Any], str]) -> RunFolder:
    """Create a run folder, or open the folder of the same unfinished work and rewrite its settings.

    Raises:
        ConfigError: if the folder holds something else.
        LogError: if it holds a run of another format.
    """
    if not (path / "meta.json").exists():
        return RunFolder.create(path, settings, seed=seed)
    folder = RunFolder.open(path)
    if reason := refusal(folder.config()):
        raise ConfigError(f"{path}: {reason}")
    write_atomically(path / "config.yaml", dump_yaml(dict(settings)))
    return folder


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Context with exclusive write access to a folder for one process; the lock of a dead process is ignored.

    Raises:
        ConfigError: if another process works in it.
    """
    lock = FileLock(folder / ".lock", timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise ConfigError(f"{folder}: another process works in it, expected to be alone") from None
    try:
        yield
    finally:
        lock.release()


def _column(values: ArrayLike | Sequence[str]) -> NDArray[np.generic] | tuple[str, ...]:
    array = np.asarray(values)
    if array.dtype.kind in "fiu":
        return array
    if array.dtype.kind == "b":
        return array.astype(np.int64)
    return tuple(str(value) for value in np.asarray(values, dtype=object))
