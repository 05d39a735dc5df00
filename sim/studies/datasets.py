"""The trials of a study: recorded on the simulated devices, or read from logs."""

from __future__ import annotations

from collections.abc import Mapping

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial, resample

from .job import Splits
from .settings import StudySettings

LOGS = "logs"
_FEWEST_LOGS = 2
_QUICK_TRIALS = {"train": 2, "val": 1, "test": 3}
_QUICK_SAMPLES, _QUICK_S = 600, 5.0  # whichever is longer: a command has to turn in it


def study_splits(settings: StudySettings) -> Splits:
    """Trials by split: those of `sim.devices.make_dataset` for `s1` and `s2`, one split `logs` for `real`.

    Raises:
        ConfigError: if fewer than two logs are given, or two of them are the same.
        LogError: if a log cannot be read or resampled.
    """
    splits: Mapping[str, tuple[Trial, ...]]
    if settings.study == "real":
        splits = {LOGS: _logs(settings)}
    else:
        from ..devices.make import make_dataset  # compiles its devices

        splits = make_dataset(settings.study, settings.seed).splits
    return {name: _shortened(name, trials) for name, trials in splits.items()} if settings.quick else dict(splits)


def _logs(settings: StudySettings) -> tuple[Trial, ...]:
    trials = tuple(resample(t, settings.rate_hz) for t in read_trials(settings.logs, settings.layout))
    sources = [trial.source for trial in trials]
    if len(sources) < _FEWEST_LOGS:
        raise ConfigError(f"study real: got {len(sources)} log, expected at least two: each is tested on the others")
    twice = [source for source in sources if sources.count(source) > 1]
    if twice:
        raise ConfigError(f"study real: {twice[0]} is given twice, expected each log once")
    return trials


def _shortened(split: str, trials: tuple[Trial, ...]) -> tuple[Trial, ...]:
    """A few trials of their first samples."""
    part = split.rpartition("/")[2]
    count = _QUICK_TRIALS.get(part, len(trials) if part != LOGS else 3)
    return tuple(trial.select(0, max(_QUICK_SAMPLES, round(_QUICK_S / trial.dt))) for trial in trials[:count])
