"""The kind `auto`: drive, creep and core of a device, chosen from the trials and fitted jointly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial

from ..identify.auto import AutoFit, auto_chain, identify_auto
from ..identify.simulators import simulator_of
from ..kernels.compiling import expecting
from ..model import FitProgress
from ..simulator import simulator_bundle
from .kind import FitRequest, Identified, ModelKind

_STEPS = 100  # of the progress
_COMPILES_S = 150.0  # where nothing is on disk: the kernels of all operators that are tried


@final
class AutoKind(ModelKind):
    """A whole device as a chain of operators; see `identify.auto.identify_auto`."""

    name = "auto"
    title = "auto"
    trainings = ("best",)
    readable = True
    invertible = False

    @expecting(_COMPILES_S)
    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None) -> Identified:
        self.check(trials, request)
        if not trials:
            raise FitError("got no trials, expected at least one")

        history: list[tuple[int, float]] = []

        def tell(share: float, rmse: float) -> None:
            history.append((round(_STEPS * share), rmse))
            if progress:
                progress(*history[-1])

        fit = identify_auto(trials, None, request.skip_first_flexure, tell)
        words = f"auto: {fit.choice.hypothesis.label} + {fit.choice.core.label}"
        simulator = simulator_of(
            auto_chain(fit), trials, request.limits, words, request.seed, request.skip_first_flexure, fit.noise
        )
        report = _report(fit, trials[0].units.angle)
        bundle = simulator_bundle(simulator)
        return Identified(bundle, simulator, tuple(history), report, fit.interrupted, fit)

    def steps(self, request: FitRequest) -> int:
        del request
        return _STEPS


def _report(fit: AutoFit, unit: str) -> str:
    """One line: what the device consists of, and the error on trials left out."""
    parts = [c.label for form in fit.choice.forms.values() for c in form if c.free]
    rmse = fit.choice.rmse_deg * fit.decades.angle
    return f"{' + '.join([*parts, fit.choice.core.label])}; {rmse:.4g} {unit} on trials left out"
