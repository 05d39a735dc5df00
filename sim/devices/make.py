"""Recording the papers' data sets on the simulated devices."""

from __future__ import annotations

from collections.abc import Mapping

from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.errors import ConfigError, did_you_mean

from .dataset import Dataset, Progress
from .quantities import to_plain
from .rod_data import RodSettings
from .s1_data import S1Settings, s1_motions
from .s2_data import S2Settings, s2_motions

DATASETS = ("s1", "s2", "rod")
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
        progress: called with the trials done and their number.

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
    plain = settings.plain() if isinstance(settings, RodSettings) else to_plain(settings)
    return Dataset(name, seed, plain, splits)


def _motions(settings: Settings, seed: int) -> Mapping[str, Mapping[str, Trajectory]]:
    if isinstance(settings, S1Settings):
        return s1_motions(settings, seed)
    return s2_motions(settings.motions if isinstance(settings, RodSettings) else settings, seed)
