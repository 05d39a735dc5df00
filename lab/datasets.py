"""Data sets of the papers on simulated devices, in memory and as canonical CSV files with a manifest."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from hystmpc.sim.devices.device import Quantities, quantity
from hystmpc.trajectories.excitation import (
    S2_OFFSETS,
    Offset,
    Split,
    s1_raised_baseline,
    s1_zero_baseline,
    s2_point_to_point,
    s2_sinusoid,
)
from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.config import dump_yaml, read_yaml
from hystmpc.trials.csv_files import read_csv, write_csv
from hystmpc.trials.errors import ConfigError, LogError, did_you_mean
from hystmpc.trials.files import write_atomically
from hystmpc.trials.json_text import plain
from hystmpc.trials.layouts import CANONICAL
from hystmpc.trials.run_folder import require_vacant
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress

from .devices.muscle import MuscleRecorder
from .devices.recorder import TendonRecorder, generator
from .devices.rod import RodRecorder
from .paper_commands import S1_ARBITRARY, S1_TRAIN_HZ, S2_FREQUENCIES_HZ, s1_test_a, s1_test_b, s1_test_c

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
        """Number of samples by split."""
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
    """Read a data set written by `write_dataset`; trials are restored exactly, sources included.

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


DATASETS = ("s1", "s2", "rod")


@dataclass(frozen=True)
class S1Settings(Quantities):
    """Choices that S1 leaves open, with the defaults of this package.

    13.4 s at the 250 Hz of the laser give 8 x 3350 = 26 800 training samples; S1 has 26 798.

    Attributes:
        group_s: duration of a training group and of test (a) [s].
        chirp_s: duration of tests (b) and (c) [s].
        tau_c_per_s: decay of test (c) [1/s]; S1 prints 0.05 and calls the signal ascending, which is -0.05.
    """

    recorder: MuscleRecorder = field(default_factory=MuscleRecorder)
    group_s: float = quantity(13.4, "s", 0.1, 1000.0, "duration of a training group and of test (a)")
    chirp_s: float = quantity(3.5, "s", 0.1, 20.0, "duration of tests (b) and (c)")
    tau_c_per_s: float = quantity(-0.05, "1/s", -1.0, 1.0, "decay of test (c)")


def s1_motions(settings: S1Settings, seed: int) -> Mapping[str, Mapping[str, Trajectory]]:
    """Commands [bar] by split and by name of the trial; test (d) is a seeded ramp-hold stand-in, its shape is lost."""
    training: dict[str, Trajectory] = {}
    for kind, make in (("zero", s1_zero_baseline), ("raised", s1_raised_baseline)):
        for frequency in S1_TRAIN_HZ:
            name = f"train_{kind}_{f'{frequency:g}'.replace('.', 'p')}hz"
            training[name] = make(frequency, duration_s=settings.group_s)
    return {
        "train": training,
        "test_a": {"test_a": s1_test_a(settings.group_s)},
        "test_b": {"test_b": s1_test_b(settings.chirp_s)},
        "test_c": {"test_c": s1_test_c(settings.tau_c_per_s, settings.chirp_s)},
        "test_d": {"test_d": S1_ARBITRARY(generator(seed, "s1/test_d", "motion"))},
    }


@dataclass(frozen=True)
class S2Settings(Quantities):
    """Choices that S2 leaves open, with the defaults of this package; see docs/reference/devices.md.

    Attributes:
        train_hz, val_hz, test_hz: frequencies of the sinusoids [Hz], each with all three baselines.
        train_moves, val_moves, test_moves: numbers of point-to-point trials.
        check_offset: baseline of repeatability and frequency check.
        repeats: trials of the repeatability check, at 0.5 Hz.
        check_hz: frequencies of the frequency check [Hz].

    Raises:
        ConfigError: if a number is out of its bounds, or the baseline is unknown.
    """

    recorder: TendonRecorder = field(default_factory=TendonRecorder)
    train_hz: tuple[float, ...] = S2_FREQUENCIES_HZ["train"]
    val_hz: tuple[float, ...] = S2_FREQUENCIES_HZ["validation"]
    test_hz: tuple[float, ...] = S2_FREQUENCIES_HZ["test"]
    train_moves: int = quantity(15, "1", 1, 10_000, "point-to-point trials to train on")
    val_moves: int = quantity(5, "1", 1, 10_000, "point-to-point trials to validate on")
    test_moves: int = quantity(20, "1", 1, 10_000, "point-to-point trials to test on")
    check_offset: Offset = "0BL"
    repeats: int = quantity(5, "1", 1, 1000, "trials of the repeatability check")
    check_hz: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4, 0.5)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.check_offset not in S2_OFFSETS:
            raise ConfigError(f"check_offset: got {self.check_offset!r}, {did_you_mean(self.check_offset, S2_OFFSETS)}")


def s2_motions(settings: S2Settings, seed: int) -> Mapping[str, Mapping[str, Trajectory]]:
    """Commands [mm] by split and by name of the trial."""
    return {
        "sin/train": _sinusoids("train", settings.train_hz),
        "sin/val": _sinusoids("val", settings.val_hz),
        "sin/test": _sinusoids("test", settings.test_hz),
        "p2p/train": _moves("train", settings.train_moves, "train", seed),
        "p2p/val": _moves("val", settings.val_moves, "train", seed),  # drawn as training is
        "p2p/test": _moves("test", settings.test_moves, "test", seed),
        "repeatability": {
            f"trial_{k + 1:02d}": s2_sinusoid(0.5, settings.check_offset) for k in range(settings.repeats)
        },
        "frequency": {_hz(f): s2_sinusoid(f, settings.check_offset) for f in settings.check_hz},
    }


def _sinusoids(split: str, frequencies: tuple[float, ...]) -> dict[str, Trajectory]:
    offsets: tuple[Offset, ...] = ("0BL", "MidBL", "EndBL")
    return {f"{split}_{_hz(f)}_{offset}": s2_sinusoid(f, offset) for f in frequencies for offset in offsets}


def _moves(split: str, count: int, kind: Split, seed: int) -> dict[str, Trajectory]:
    names = [f"{split}_{k + 1:02d}" for k in range(count)]
    return {name: s2_point_to_point(generator(seed, f"s2/p2p/{name}", "motion"), kind) for name in names}


def _hz(frequency: float) -> str:
    return f"{frequency:g}hz".replace(".", "p")


@dataclass(frozen=True)
class RodSettings:
    """Settings of the recordings on the rod.

    Attributes:
        motions: which motions of S2, and how many; its own recorder, that of the tendon catheter, is not used.
    """

    recorder: RodRecorder = field(default_factory=RodRecorder)
    motions: S2Settings = field(default_factory=S2Settings)

    def plain(self) -> dict[str, Any]:
        """Settings as plain data for the manifest."""
        motions: Mapping[str, Any] = plain(asdict(self.motions))
        kept = {name: value for name, value in motions.items() if name != "recorder"}
        return {"recorder": plain(asdict(self.recorder)), "motions": kept}


Settings = S1Settings | S2Settings | RodSettings
_SETTINGS: Mapping[str, type[Settings]] = {"s1": S1Settings, "s2": S2Settings, "rod": RodSettings}


def make_dataset(
    name: str, seed: int = 0, settings: Settings | None = None, progress: Progress | None = None
) -> Dataset:
    """Record a whole data set; equal arguments give equal trials.

    Every trial has its own device (see `TendonVariation`, `MuscleVariation`, `RodVariation`) and its own noise, drawn
    from `seed` and its name, so that a trial does not change when others are added.

    Args:
        name: `s1` (splits train, test_a to test_d) or `s2` (sin/..., p2p/... with train, val, test; repeatability;
            frequency) or `rod` (the motions and splits of `s2`).
        seed: zero or above.
        settings: `S1Settings`, `S2Settings` or `RodSettings`; defaults where left out.

    Raises:
        ConfigError: on an unknown name, settings of the other set, or a negative seed.
    """
    if name not in DATASETS:
        raise ConfigError(f"no data set {name!r}, {did_you_mean(name, DATASETS)}")
    if seed < 0:
        raise ConfigError(f"seed: got {seed}, expected 0 or above")
    settings = settings or _SETTINGS[name]()
    if type(settings) is not _SETTINGS[name]:
        raise ConfigError(f"data set {name}: got {type(settings).__name__}, expected {_SETTINGS[name].__name__}")
    motions = _motions(settings, seed)
    total, done = sum(map(len, motions.values())), 0
    splits = {}
    for split, excitations in motions.items():
        group = name if name == "s1" else f"{name}/{split.partition('/')[0]}"
        trials = []
        for trial, excitation in excitations.items():
            trials.append(settings.recorder.record(excitation, seed, f"{group}/{trial}"))
            done += 1
            if progress:
                progress(done, total)
        splits[split] = tuple(trials)
    parameters = settings.plain() if isinstance(settings, RodSettings) else plain(asdict(settings))
    return Dataset(name, seed, parameters, splits)


def _motions(settings: Settings, seed: int) -> Mapping[str, Mapping[str, Trajectory]]:
    if isinstance(settings, S1Settings):
        return s1_motions(settings, seed)
    return s2_motions(settings.motions if isinstance(settings, RodSettings) else settings, seed)
