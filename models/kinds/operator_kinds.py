"""Kinds of model that consist of operators: one operator of `CHAIN_KINDS`, or the whole device of `auto`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import final

from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial

from ..contract.metadata import DeviceLimits
from ..identify.auto import AutoFit, auto_chain, identify_auto
from ..identify.chain_fit import OperatorFitSettings, identify_chain, methods_by_training
from ..identify.chain_kinds import ChainKind
from ..identify.simulators import simulator_of
from ..model import FitProgress
from ..simulator import simulator_bundle
from .kind import FitRequest, Identified, ModelKind, recorded


@final
class OperatorKind(ModelKind):
    """Kind of model that is one operator, identified by a method for each training; swapped trials give the inverse."""

    readable = True

    def __init__(self, entry: ChainKind) -> None:
        self.name, self.title, self.trainings = entry.name, entry.title, tuple(methods_by_training(entry.name))
        self.invertible, self.rings = entry.inverse is not None, entry.rings
        self._entry = entry

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None) -> Identified:
        self.check(trials, request)
        inverted = bool(trials) and trials[0].inverted
        kind = f"inverse_{self.name}" if inverted else self.name
        method = methods_by_training(self.name)[request.training]
        settings = method.settings_for(request.steps, request.seed, request.skip_first_flexure)
        if isinstance(settings, OperatorFitSettings) and self._entry.restarts is not None:
            settings = replace(settings, restarts=self._entry.restarts)
        plays = self._entry.plays if request.plays is None else request.plays
        chain, fit = identify_chain(kind, trials, method.name, settings, plays, progress)
        # The limits of the request are those of the device's command, which an inverse map gives and does not take.
        limits = DeviceLimits() if inverted else request.limits
        words = f"{method.name}, training {request.training}"
        simulator = simulator_of(chain, trials, limits, words, request.seed, request.skip_first_flexure)
        history = tuple((k + 1, loss**0.5) for k, loss in enumerate(fit.report.losses))
        report = f"{fit.report.line()}; {fit.rmse_deg:.4g} {trials[0].units.angle} free run"
        return Identified(simulator_bundle(simulator), simulator, history, report, fit.interrupted)

    def steps(self, request: FitRequest) -> int | None:
        del request
        return None


_STEPS = 100  # steps of the progress


@final
class AutoKind(ModelKind):
    """Kind of model of a whole device as a chain of operators; see `identify_auto`."""

    name = "auto"
    title = "auto"
    trainings = ("best",)
    readable = True
    invertible = False
    takes_inputs = True

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None) -> Identified:
        self.check(trials, request)
        if not trials:
            raise FitError("got no trials, expected at least one")

        history, show = recorded(progress)
        skip = request.skip_first_flexure
        fit = identify_auto(trials, skip, lambda share, rmse: show(round(_STEPS * share), rmse), request.ranges)
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
    parts = [c.label for form in fit.choice.forms.values() for c in form if c.free]
    rmse = fit.choice.rmse_deg * fit.decades.angle
    return f"{' + '.join([*parts, fit.choice.core.label])}; {rmse:.4g} {unit} on trials left out"
