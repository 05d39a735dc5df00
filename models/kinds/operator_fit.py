"""What the kinds that are operators share: bounded least squares into a simulator and its bundle."""

from __future__ import annotations

from collections.abc import Sequence

from hystmpc.trials.trial import Trial

from ..export_simulator import simulator_bundle
from ..fit.identify import identify
from ..fit.operators import OperatorFitSettings
from .kind import FitRequest, Identified, Progress


def identify_operator(
    kind: str, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None
) -> Identified:
    """Identify an operator by `identify` and wrap what it found."""
    history: list[tuple[int, float]] = []

    def show(done: int, rmse: float) -> None:
        history.append((done, rmse))
        if progress:
            progress(done, rmse)

    settings = OperatorFitSettings(request.skip_first_flexure, seed=request.seed)
    simulator, fit = identify(kind, trials, settings, request.plays, request.limits, show)
    unit = trials[0].units.angle
    report = f"{fit.evaluations} free runs over all trials, {fit.rmse_deg:.4f} {unit}"
    return Identified(simulator_bundle(simulator), simulator, tuple(history), report, fit.interrupted)
