"""Data sets: named splits of trials, in memory and as canonical CSV files with a manifest."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hystmpc.trials.config import dump_yaml, read_yaml
from hystmpc.trials.csv_files import read_csv, write_csv
from hystmpc.trials.errors import ConfigError, LogError, did_you_mean
from hystmpc.trials.files import write_atomically
from hystmpc.trials.layouts import CANONICAL
from hystmpc.trials.run_folder import require_vacant
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress

FORMAT = "hystmpc-dataset/1"
MANIFEST = "manifest.yaml"


@dataclass(frozen=True, eq=False)
class Dataset:
    """Trials of one device in splits such as `p2p/train`.

    Attributes:
        name: `s1` or `s2`.
        settings: device, sensor and signals it was made with, as plain data.

    Raises:
        ConfigError: if there is no split, or one without trials.
    """

    name: str
    seed: int
    settings: Mapping[str, Any]
    splits: Mapping[str, tuple[Trial, ...]]

    def __post_init__(self) -> None:
        splits = {split: tuple(trials) for split, trials in self.splits.items()}
        if not splits or not all(splits.values()):
            empty = [split for split, trials in splits.items() if not trials]
            raise ConfigError(f"data set {self.name}: no trials in {', '.join(empty) or 'any split'}, expected some")
        object.__setattr__(self, "splits", MappingProxyType(splits))

    def __reduce__(self) -> tuple[type[Dataset], tuple[object, ...]]:
        # A mapping proxy cannot be pickled, and data sets travel to worker processes.
        return Dataset, (self.name, self.seed, self.settings, dict(self.splits))

    def __getitem__(self, split: str) -> tuple[Trial, ...]:
        """Trials of one split.

        Raises:
            ConfigError: if there is no such split.
        """
        if split not in self.splits:
            raise ConfigError(f"data set {self.name}: no split {split!r}, {did_you_mean(split, self.splits)}")
        return self.splits[split]

    @property
    def samples(self) -> dict[str, int]:
        """Samples by split."""
        return {split: sum(map(len, trials)) for split, trials in self.splits.items()}


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
