"""A data set: named splits of trials, with what it was made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.trial import Trial

Progress = Callable[[int, int], None]
"""Called with the trials done and their number."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """Trials of one device in splits such as `p2p/train`.

    Attributes:
        name: `s1` or `s2`.
        seed: of everything random in it.
        settings: device, sensor and signals it was made with, as plain data.
        splits: trials by split, in order.

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
