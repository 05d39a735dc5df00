"""Data sets on disk: canonical CSV files and a manifest."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hystmpc.trials.config import dump_yaml, read_yaml
from hystmpc.trials.csv_files import read_csv, write_csv
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.layouts import CANONICAL
from hystmpc.trials.run_folder import require_vacant
from hystmpc.trials.trial import Trial

from .dataset import Dataset, Progress

FORMAT = "hystmpc-dataset/1"
MANIFEST = "manifest.yaml"


def write_dataset(dataset: Dataset, folder: Path | str, progress: Progress | None = None) -> Path:
    """Write one canonical CSV a trial and `manifest.yaml` (seed, settings, splits); whole or not at all.

    A trial named `s2/p2p/test_07` becomes `p2p/test_07.csv`. Everything is written beside the folder first and moved
    there at the end.

    Raises:
        ConfigError: if the folder is not vacant or cannot be made.
    """
    path = Path(folder)
    require_vacant(path)
    total, done = sum(map(len, dataset.splits.values())), 0
    part = None
    try:
        path.absolute().parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.absolute().parent))
        part.chmod(0o755)
        splits: dict[str, list[dict[str, Any]]] = {}
        for split, trials in dataset.splits.items():
            splits[split] = []
            for trial in trials:
                splits[split].append(_write(trial, part))
                done += 1
                if progress:
                    progress(done, total)
        manifest = {"format": FORMAT, "name": dataset.name, "seed": dataset.seed, "settings": dict(dataset.settings)}
        write_atomically(part / MANIFEST, dump_yaml({**manifest, "splits": splits}))
        part.replace(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written ({error.strerror}), expected a writable folder") from None
    finally:
        if part is not None:
            shutil.rmtree(part, ignore_errors=True)
    return path


def read_dataset(folder: Path | str) -> Dataset:
    """A data set that `write_dataset` wrote; trials read back exactly, sources included.

    Raises:
        ConfigError: if the manifest is missing, of another format, or lacks an entry.
        LogError: if a trial's file is missing, unreadable, or has another number of samples than the manifest says.
    """
    file = Path(folder) / MANIFEST
    manifest = read_yaml(file)
    found = manifest.get("format") if isinstance(manifest, Mapping) else None
    if found != FORMAT:
        raise ConfigError(f"{file}: format {found!r}, expected {FORMAT!r}")
    try:
        splits = {
            split: tuple(_read(Path(folder), entry) for entry in entries)
            for split, entries in manifest["splits"].items()
        }
        return Dataset(manifest["name"], manifest["seed"], manifest["settings"], splits)
    except (KeyError, TypeError, AttributeError) as error:
        raise ConfigError(f"{file}: not a manifest ({error}), expected name, seed, settings and splits") from None


def _write(trial: Trial, folder: Path) -> dict[str, Any]:
    """Write one trial and return its entry of the manifest."""
    file = Path(*trial.source.split("/")[1:]).with_suffix(".csv")
    write_csv(trial, folder / file)
    return {"file": file.as_posix(), "source": trial.source, "samples": len(trial)}


def _read(folder: Path, entry: Mapping[str, Any]) -> Trial:
    trial = read_csv(folder / entry["file"], CANONICAL)
    if len(trial) != entry["samples"]:
        raise LogError(f"{trial.source}: got {len(trial)} samples, expected {entry['samples']} as the manifest says")
    return Trial(trial.t, trial.command, trial.angle, trial.channels, trial.units, entry["source"])
