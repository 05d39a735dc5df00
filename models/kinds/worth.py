"""What every identification ends with: a model that a straight line would beat is refused, and why is said."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.trials.check import check
from hystmpc.trials.clock_shift import clock_shift
from hystmpc.trials.errors import FitError
from hystmpc.trials.findings import Severity
from hystmpc.trials.trial import Trial

from ..contract.export import model_bytes
from ..evaluate import evaluate
from ..model import FitProgress, LoadedModel
from .kind import FitRequest, Identified, ModelKind

_SLACK = 1.02  # of the line's error: a device that is a line is identified up to this much worse
_ROUNDING = 1e-9  # of the angle's range: trials that are a line to the last digit are identified, too
_CAUSES = ("numbers", "clocks", "time base", "units", "sign")


def identified(
    kind: ModelKind, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None
) -> Identified:
    """Identify, and refuse a model whose free run errs more over these trials than one straight line through them.

    What was interrupted, or was asked to stop after so many steps, is returned as it is.

    Raises:
        FitError: as `ModelKind.fit`, or that two clocks are the cause; where a line is better, with both errors and
            what the check of the trials says.
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
    model, line = _errors(_opened(identification, kind.name), trials, request.skip_first_flexure)
    if model > _SLACK * line + _ROUNDING * _span(trials):
        unit = trials[0].units.angle
        raise FitError(
            f"{kind.name}: errs by {model:.3g} {unit} over these trials, a straight line by {line:.3g} {unit}: "
            f"no model of them, and none is kept; {_why(trials)}"
        )
    return identification


def _opened(identification: Identified, name: str) -> LoadedModel:
    if identification.simulator is not None:
        from ..simulator import ChainModel

        return ChainModel(identification.simulator)
    from ..contract.load import OnnxModel

    return OnnxModel(model_bytes(identification.bundle), name)


def _errors(model: LoadedModel, trials: Sequence[Trial], skip_first_flexure: bool) -> tuple[float, float]:
    """Root mean square errors of the model's free run and of one line through all samples that count."""
    runs = [evaluate(model, trial, skip_first_flexure) for trial in trials]
    u = np.concatenate([run.trial.command[run.start :] for run in runs])
    y = np.concatenate([run.trial.angle[run.start :] for run in runs])
    theta = np.concatenate([run.theta[run.start :] for run in runs])
    columns = np.column_stack([np.ones(u.size), u])
    left = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
    return float(np.sqrt(np.mean((theta - y) ** 2))), float(np.sqrt(np.mean(left**2)))


def _span(trials: Sequence[Trial]) -> float:
    """Greatest range of the angle in a trial."""
    return max(float(np.ptp(trial.angle)) for trial in trials)


def _why(trials: Sequence[Trial]) -> str:
    """What the check of the trials finds that may be the cause."""
    for trial in trials:
        forward = trial.swapped() if trial.inverted else trial
        for finding in check(forward).findings:
            if finding.severity in (Severity.WARNING, Severity.ERROR) and finding.topic.startswith(_CAUSES):
                return f"`check` says: {finding.message}"
    return "`check` finds no cause: try `auto`, or more trials"
