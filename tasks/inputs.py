"""Inputs of the tasks: models, recorded trials and settings, each as an object or as a file."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeAlias

from hystmpc.trials.check import Severity, check
from hystmpc.trials.command_noise import noise_text
from hystmpc.trials.config import override
from hystmpc.trials.errors import ConfigError, ModelError
from hystmpc.trials.findings import gaps_text
from hystmpc.trials.from_outside import allow_python
from hystmpc.trials.read import AnyLayout, Log, at_rate, expand_logs, read_trials
from hystmpc.trials.recording import require_recorded
from hystmpc.trials.tables import FrameLike
from hystmpc.trials.trial import Trial, parts_at_gaps

if TYPE_CHECKING:
    from hystmpc.models.contract.load import OnnxModel
    from hystmpc.models.model import LoadedModel
    from hystmpc.models.simulator import ChainModel, Simulator

Logs: TypeAlias = Log | Iterable[Log]
Start = Literal["initial", "conditioned"]
Settings: TypeAlias = Path | str | Mapping[str, Any]
"""A YAML file, or the same as a mapping."""

Say: TypeAlias = Callable[[str], None]
"""Called with a note or a warning, one line."""


class Fitted(Protocol):
    """The result of an identification, see `Fit`."""

    @property
    def model(self) -> LoadedModel:
        """The model, ready to run."""
        ...


Model: TypeAlias = "Fitted | Simulator | LoadedModel | Path | str"
"""A model: a fit, a simulator, an opened model, a model file, or `builtin:NAME`."""


def load_model(path: Path | str, start: Start = "initial") -> ChainModel | OnnxModel:
    """Open a model file; `.simulator` of the result is the readable form of an operator-based model.

    Args:
        path: a simulator (`.yaml`), an exported model (`.onnx`), or `builtin:NAME` for one that ships.
        start: state at the start of a free run: `initial` of a fresh device, `conditioned` after its first flexure.

    Raises:
        ModelError: if the file is missing, foreign or corrupt, or the name unknown.
    """
    from hystmpc.models.load import load_model as open_file

    return open_file(path, start)


def opened(model: Model, start: Start = "initial") -> LoadedModel:
    """The model of whatever stands for one, ready to run."""
    if isinstance(model, Path | str):
        return load_model(model, start)
    from hystmpc.models.model import LoadedModel
    from hystmpc.models.simulator import ChainModel, Simulator

    if not isinstance(model, Simulator | LoadedModel):
        runs = model.model
        model = runs.simulator if isinstance(runs, ChainModel) else runs
    return ChainModel(model, start) if isinstance(model, Simulator) else model


def chain_or_model(model: Model) -> Simulator | LoadedModel:
    """The chain of operators of whatever stands for a model; a network as the model that it is.

    Raises:
        ModelError: if a file has another ending, or cannot be opened.
    """
    from hystmpc.models.load import load_model as open_file
    from hystmpc.models.load import model_path
    from hystmpc.models.simulator import ChainModel, load_simulator

    if isinstance(model, Path | str):
        path = model_path(str(model))
        suffix = path.suffix.lower()
        if suffix in (".yaml", ".yml"):
            return load_simulator(path)
        if suffix == ".onnx":
            return open_file(path)
        raise ModelError(f"--sim {path}: ending {suffix or 'missing'}, expected .yaml, .onnx or builtin:NAME")
    runs = opened(model)
    return runs.simulator if isinstance(runs, ChainModel) else runs


def as_list(logs: Logs) -> list[Log]:
    """One or several logs as a list."""
    return [logs] if isinstance(logs, Path | str | FrameLike | Trial) else list(logs)


def files_read(logs: Sequence[Log], layout: AnyLayout) -> list[Path]:
    """The files among logs and their layout, folders expanded.

    Raises:
        LogError: if nothing is given, or a folder holds no log.
    """
    files = [Path(log) for log in logs if isinstance(log, Path | str)]
    mapping = [Path(layout)] if isinstance(layout, str) else []
    return [*(expand_logs(files) if files or not logs else []), *mapping]


def recorded_trials(logs: Sequence[Log], layout: AnyLayout, sampled_hz: float | None = None) -> list[Trial]:
    """Logs as recorded, all of them fit to learn from.

    Raises:
        LogError: if a log cannot be read, is a proposed motion, or its signals are read wrongly.
        ConfigError: on an unknown layout, or a rate that is no positive number.
    """
    trials = read_trials(logs, layout, sampled_hz=sampled_hz)
    for trial in trials:
        require_recorded(trial)
    return trials


def trials_at(
    logs: Sequence[Log], layout: AnyLayout, rate_hz: float, sampled_hz: float | None = None, say: Say | None = None
) -> list[Trial]:
    """Logs on a uniform grid; `say` gets what is made of gaps and noise, and what seems to be in another unit.

    Raises:
        LogError: as `recorded_trials`, or if a log cannot be resampled.
        ConfigError: if a rate is not a positive number.
    """
    recorded = recorded_trials(logs, layout, sampled_hz)
    if say is None:
        return at_rate(recorded, rate_hz)
    for trial in recorded:
        if note := gaps_text(trial, parts_at_gaps(trial)):
            say(f"note: {trial.source}: {note}")
    trials = at_rate(recorded, rate_hz)
    for trial in trials:
        if note := noise_text(trial):
            say(f"note: {trial.source}: {note}")
    warn_of_units(trials, say)
    return trials


def warn_of_units(trials: Iterable[Trial], say: Say) -> None:
    """Warn where a signal looks like another unit or has another clock: no error of a model would tell either."""
    for trial in trials:
        for finding in check(trial).findings:
            if finding.topic.startswith(("units", "clocks")) and finding.severity is Severity.WARNING:
                say(f"warning: {trial.source}: {finding.topic}: {finding.message}")


def allow_classes(allow: bool) -> None:
    """Permit the import of classes that files name as `python: MODULE:CLASS`, where the caller trusts them."""
    if allow:
        allow_python()


def changed(settings: Mapping[str, Any], overrides: Iterable[str]) -> dict[str, Any]:
    """A copy of plain settings with changes such as `plant.lag_s=0.1`.

    Raises:
        ConfigError: on a malformed change.
    """
    data = deepcopy(dict(settings))
    for text in overrides:
        override(data, text)
    return data


def processes(jobs: int | None) -> int:
    """Number of worker processes; one a core where it is left out.

    Raises:
        ConfigError: if it is below 1.
    """
    if jobs is not None and jobs < 1:
        raise ConfigError(f"--jobs: got {jobs}, expected 1 or more; left out it is one a core, here {os.cpu_count()}")
    return jobs or os.cpu_count() or 1
