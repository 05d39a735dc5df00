"""Inputs of the tasks: models, recorded trials and settings, each as an object or as a file."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypeVar

from hystmpc.trials.axes import both_axes, in_channels
from hystmpc.trials.check import Severity, check
from hystmpc.trials.command_noise import noise_text
from hystmpc.trials.config import Settings as Keys
from hystmpc.trials.config import load_settings, override
from hystmpc.trials.errors import ConfigError, LogError, ModelError
from hystmpc.trials.findings import gaps_text
from hystmpc.trials.from_outside import allow_python
from hystmpc.trials.read import AnyLayout, Log, at_rate, expand_logs
from hystmpc.trials.recording import recorded_trials
from hystmpc.trials.tables import FrameLike
from hystmpc.trials.trial import Trial, parts_at_gaps

if TYPE_CHECKING:
    from hystmpc.models.contract.metadata import Start
    from hystmpc.models.model import LoadedModel
    from hystmpc.models.simulator import Simulator
    from hystmpc.models.two_axes.model import TwoAxisModel

S = TypeVar("S", bound=Keys)

Logs: TypeAlias = Log | Iterable[Log]
Settings: TypeAlias = Path | str | Mapping[str, Any]
"""Settings as a YAML file or a mapping."""

Say: TypeAlias = Callable[[str], None]
"""Callback for a note or a warning, one line."""


class Fitted(Protocol):
    """Protocol of the result of an identification, see `Fit`."""

    @property
    def model(self) -> LoadedModel:
        """The model, ready to run."""
        ...


Model: TypeAlias = "Fitted | Simulator | LoadedModel | Path | str"
"""A model: a fit, a simulator, an opened model, a model file, or `builtin:NAME`."""


def opened(model: Model, start: Start = "initial") -> LoadedModel:
    """Open a model given as a file, a fit or a simulator; an opened model is returned as it is."""
    from hystmpc.models.load import load_model
    from hystmpc.models.model import LoadedModel
    from hystmpc.models.simulator import ChainModel, Simulator

    if isinstance(model, Path | str):
        return load_model(model, start)
    if not isinstance(model, Simulator | LoadedModel):
        runs = model.model
        model = runs.simulator if isinstance(runs, ChainModel) else runs
    return ChainModel(model, start) if isinstance(model, Simulator) else model


def of_two_axes(model: object) -> TwoAxisModel | None:
    """The model of two axes, of a fit, itself or a file; None for a model of one axis."""
    from hystmpc.models.two_axes.model import TwoAxisModel, has_two_axes, load_two_axes

    if isinstance(model, Path | str):
        return load_two_axes(model) if has_two_axes(model) else None
    known = getattr(model, "model", model)
    return known if isinstance(known, TwoAxisModel) else None


def both_axes_of(
    logs: Sequence[Log], layout: AnyLayout, rate_hz: float, sampled_hz: float | None, say: Say | None
) -> list[Trial]:
    """Read logs of two axes and resample them to a rate, see `trials_at`.

    Raises:
        LogError: if they have one axis, or as `trials_at`.
    """
    plain = [in_channels(log) if isinstance(log, Trial) else log for log in logs]
    recorded = trials_at(plain, layout, rate_hz, sampled_hz, say, most_axes=2)
    if (both := both_axes(recorded)) is None:
        raise LogError(
            f"{recorded[0].source}: a log of one axis, expected two for a model of two axes: command_x, command_y, "
            "angle_x_deg and angle_y_deg, or the same by a mapping file"
        )
    return both


def chain_or_model(model: Model) -> Simulator | LoadedModel:
    """Return the chain of operators of a model, or a network as it is.

    Raises:
        ModelError: if a file has another ending, cannot be opened, or depends on measured inputs.
    """
    from hystmpc.models.load import model_path
    from hystmpc.models.simulator import ChainModel

    path = model_path(str(model)) if isinstance(model, Path | str) else None
    if path is not None and path.suffix.lower() not in (".yaml", ".yml", ".onnx"):
        ending = path.suffix.lower() or "missing"
        raise ModelError(f"--sim {path}: ending {ending}, expected .yaml, .onnx or builtin:NAME")
    runs = opened(model)
    if names := ", ".join(one.name for one in runs.inputs):
        raise ModelError(f"--sim: the simulator depends on {names}, a diagnosis expects one without measured inputs")
    return runs.simulator if isinstance(runs, ChainModel) else runs


def as_list(logs: Logs) -> list[Log]:
    """One or several logs as a list."""
    return [logs] if isinstance(logs, Path | str | FrameLike | Trial) else list(logs)


def files_read(logs: Sequence[Log], layout: AnyLayout) -> list[Path]:
    """Files among logs and layout, with the logs of each folder.

    Raises:
        LogError: if nothing is given, or a folder holds no log.
    """
    files = [Path(log) for log in logs if isinstance(log, Path | str)]
    mapping = [Path(layout)] if isinstance(layout, str) else []
    return [*(expand_logs(files) if files or not logs else []), *mapping]


def trials_at(
    logs: Sequence[Log],
    layout: AnyLayout,
    rate_hz: float,
    sampled_hz: float | None = None,
    say: Say | None = None,
    most_axes: int = 1,
) -> list[Trial]:
    """Read logs and resample them to a rate; `say` gets notes on gaps, noise and doubtful units.

    Args:
        most_axes: as of `recorded_trials`.

    Raises:
        LogError: as `recorded_trials`, or if a log cannot be resampled.
        ConfigError: if a rate is not a positive number.
    """
    recorded = recorded_trials(logs, layout, sampled_hz, most_axes)
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
    """Warn of signals with a suspected other unit or clock, which no error of a model shows."""
    for trial in trials:
        for finding in check(trial).findings:
            if finding.topic.startswith(("units", "clocks")) and finding.severity is Severity.WARNING:
                say(f"warning: {trial.source}: {finding.topic}: {finding.message}")


def allow_classes(allow: bool) -> None:
    """Permit the import of classes that files name as `python: MODULE:CLASS`, if the caller trusts them."""
    if allow:
        allow_python()


def settings_of(kind: type[S], given: Settings, overrides: Iterable[str]) -> S:
    """Read settings from a YAML file or a mapping, with changes such as `plant.lag_s=0.1`.

    Raises:
        ConfigError: on an unreadable file, a malformed change, an unknown key or a value out of bounds.
    """
    if isinstance(given, Path | str):
        return load_settings(kind, given, overrides)
    data = deepcopy(dict(given))
    for text in overrides:
        override(data, text)
    return kind.parse(data)


def processes(jobs: int | None) -> int:
    """Number of worker processes; by default one per core.

    Raises:
        ConfigError: if it is below 1.
    """
    if jobs is not None and jobs < 1:
        raise ConfigError(f"--jobs: got {jobs}, expected 1 or more; left out it is one a core, here {os.cpu_count()}")
    return jobs or os.cpu_count() or 1
