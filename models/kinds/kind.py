"""Kind of model: identified from trials, forward or inverse, always into an exportable bundle."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hystmpc.trials.check import check
from hystmpc.trials.clock_shift import clock_shift
from hystmpc.trials.errors import FitError, did_you_mean
from hystmpc.trials.findings import Severity
from hystmpc.trials.trial import Trial

from ..contract.export import ExportBundle, model_bytes
from ..contract.metadata import DeviceLimits
from ..evaluate import evaluate
from ..model import FitProgress, LoadedModel

if TYPE_CHECKING:
    from ..identify.auto import AutoFit
    from ..simulator import Simulator


@dataclass(frozen=True)
class FitRequest:
    """Options of an identification; a kind ignores those that do not apply.

    Attributes:
        training: `best`, or `paper` for the papers' training settings; for operators the method, see each kind.
        seed: of all random numbers.
        steps: greatest number of steps (epochs, updates, iterations); None for the training's.
        hold_out: number of trials held out to stop early; None for the training's.
        validation: trials that only judge, in place of held-out ones.
        constancy_weight: beta of the constant-in, constant-out term, S2 (RA-L 2024) eq. (12); None for the training's.
        plays: number of plays of a Prandtl-Ishlinskii model; None for the kind's default.
        skip_first_flexure: score each trial from the first reversal of its command on.
        limits: limits of the command sent to the device.
        ranges: of measured inputs over which a dependence on them is to hold; those of the trials where left out.
    """

    training: str = "best"
    seed: int = 1
    steps: int | None = None
    hold_out: int | None = None
    validation: tuple[Trial, ...] = ()
    constancy_weight: float | None = None
    plays: int | None = None
    skip_first_flexure: bool = False
    limits: DeviceLimits = field(default_factory=DeviceLimits)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Identified:
    """Result of an identification.

    Attributes:
        bundle: graph, facts and reference, ready for `export_onnx`; `OnnxModel` runs it.
        simulator: the readable form of an operator; None for networks.
        history: step and best error so far, in the unit of the output.
        parts: of `auto`, the effect of each part on the error, its numbers with intervals, and what to record.
    """

    bundle: ExportBundle
    simulator: Simulator | None
    history: tuple[tuple[int, float], ...]
    report: str
    interrupted: bool = False
    parts: AutoFit | None = None


def recorded(progress: FitProgress | None) -> tuple[list[tuple[int, float]], FitProgress]:
    """Empty history of (step, least error), and a progress function that fills it and calls the given one."""
    history: list[tuple[int, float]] = []

    def show(done: int, error: float) -> None:
        history.append((done, error))
        if progress:
            progress(done, error)

    return history, show


class ModelKind(ABC):
    """Kind of model, final and without state; swapped trials (`Trial.swapped`) request the inverse map.

    Attributes:
        trainings: possible values of `FitRequest.training`, the default first.
        inverse_training: the default for inverse maps, where it is another one.
        readable: whether the result also has a readable form, a simulator in YAML.
        invertible: whether inverse maps can be identified.
        recurrent: whether its angle depends on more than the present command.
        rings: whether its angle oscillates after the command stops.
        takes_inputs: whether parameters may depend on measured inputs.
    """

    name: str
    title: str
    trainings: tuple[str, ...] = ("best", "paper")
    inverse_training: str = ""
    readable: bool = False
    invertible: bool = True
    recurrent: bool = True
    rings: bool = False
    takes_inputs: bool = False

    def usual_training(self, inverted: bool) -> str:
        """Default training."""
        return (inverted and self.inverse_training) or self.trainings[0]

    @abstractmethod
    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None) -> Identified:
        """Identify from uniformly sampled trials of one rate and one pair of units.

        `progress` gets the steps so far and the best error; KeyboardInterrupt keeps the best so far.

        Raises:
            FitError: on unusable trials, an unknown training, a diverging fit, or a missing extra.
        """

    @abstractmethod
    def steps(self, request: FitRequest) -> int | None:
        """Number of steps that progress counts up to; None where it is unknown."""

    def estimate(self, trials: Sequence[Trial], request: FitRequest) -> float | None:
        """Duration of `fit` [s], measured on a few of its steps; None where it cannot be estimated.

        Raises:
            FitError: on unusable trials or a missing extra.
        """
        del trials, request
        return None

    def check(self, trials: Sequence[Trial], request: FitRequest) -> None:
        """Refuse a request that this kind cannot fulfil, before the fit.

        Raises:
            FitError: on an unknown training, an inverse map of a kind that has none, or measured inputs for a kind that
                cannot depend on any.
        """
        if not self.takes_inputs and any(trial.inputs for trial in trials):
            raise FitError(f"{self.name}: got the input {next(iter(trials[0].inputs))}, expected none; `auto` takes it")
        if request.training not in self.trainings:
            raise FitError(
                f"{self.name}: no training {request.training!r}, {did_you_mean(request.training, self.trainings)}"
            )
        if trials and trials[0].inverted and not self.invertible:
            raise FitError(f"{self.name} has no inverse map; its inverse can be searched, or another kind identified")


_SLACK = 1.02  # accepted ratio to the line's error, for devices that are a line
_ROUNDING = 1e-9  # share of the angle's range: errors below it are accepted
_CAUSES = ("numbers", "clocks", "time base", "units", "sign")


def identified(
    kind: ModelKind, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None
) -> Identified:
    """Identify a model, and refuse the result of a complete fit if a straight line has a smaller error.

    Raises:
        FitError: as `ModelKind.fit`; if two clocks are the cause; where a line is better, with both errors and the
            findings of the check of the trials.
    """
    try:
        identification = kind.fit(trials, request, progress)
    except FitError as error:
        for trial in trials:
            if (shift := clock_shift(trial.t, trial.command, trial.angle)) is not None and not trial.inverted:
                raise FitError(f"{trial.source}: {shift.text}") from error
        raise
    if identification.interrupted or request.steps is not None:
        return identification
    model, line = _errors(opened(identification, kind.name), trials, request.skip_first_flexure)
    if model > _SLACK * line + _ROUNDING * _span(trials):
        unit = trials[0].units.angle
        raise FitError(
            f"{kind.name}: errs by {model:.3g} {unit} over these trials, a straight line by {line:.3g} {unit}: "
            f"no model of them, and none is kept; {_why(trials)}"
        )
    return identification


def opened(identification: Identified, name: str) -> LoadedModel:
    """Model of an identification, without a file."""
    if identification.simulator is not None:
        from ..simulator import ChainModel

        return ChainModel(identification.simulator)
    from ..contract.load import OnnxModel

    return OnnxModel(model_bytes(identification.bundle), name)


def _errors(model: LoadedModel, trials: Sequence[Trial], skip_first_flexure: bool) -> tuple[float, float]:
    runs = [evaluate(model, trial, skip_first_flexure) for trial in trials]
    u = np.concatenate([run.trial.command[run.start :] for run in runs])
    y = np.concatenate([run.trial.angle[run.start :] for run in runs])
    theta = np.concatenate([run.theta[run.start :] for run in runs])
    columns = np.column_stack([np.ones(u.size), u])
    left = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
    return float(np.sqrt(np.mean((theta - y) ** 2))), float(np.sqrt(np.mean(left**2)))


def _span(trials: Sequence[Trial]) -> float:
    return max(float(np.ptp(trial.angle)) for trial in trials)


def _why(trials: Sequence[Trial]) -> str:
    for trial in trials:
        forward = trial.swapped() if trial.inverted else trial
        for finding in check(forward).findings:
            if finding.severity in (Severity.WARNING, Severity.ERROR) and finding.topic.startswith(_CAUSES):
                return f"`check` says: {finding.message}"
    return "`check` finds no cause: try `auto`, or more trials"
