"""The data set of S2: sinusoids, point-to-point motions, repeatability and frequency check, on the tendon catheter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from hystmpc.trajectories.excitation import (
    S2_FREQUENCIES_HZ,
    S2_OFFSETS,
    Offset,
    Split,
    s2_point_to_point,
    s2_sinusoid,
)
from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.errors import ConfigError, did_you_mean

from .excited import generator
from .quantities import check_quantities, quantity
from .tendon_recorder import TendonRecorder


@dataclass(frozen=True)
class S2Settings:
    """What S2 leaves open, with our defaults; see docs/devices.md.

    Attributes:
        recorder: the bench.
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
        check_quantities(self)
        if self.check_offset not in S2_OFFSETS:
            raise ConfigError(f"check_offset: got {self.check_offset!r}, {did_you_mean(self.check_offset, S2_OFFSETS)}")


def s2_motions(settings: S2Settings, seed: int) -> Mapping[str, Mapping[str, Trajectory]]:
    """Commands [mm] by split and by name of the trial.

    Raises:
        TrajectoryError: if a frequency is not positive.
    """
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
