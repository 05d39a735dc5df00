"""What the kinds that are networks share: presets changed by a request, training, bundle, and its time beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hystmpc.trials.trial import Trial

from ..fit.network_bundle import network_bundle
from ..fit.network_presets import NETWORK_PRESETS
from ..fit.network_settings import NetworkSettings, WindowTraining
from ..fit.network_timing import training_seconds
from ..fit.networks import fit_network
from .kind import FitRequest, Identified, ModelKind, Progress

_WINDOW = 50  # S2's, over which its constancy term is taken


def identify_network(
    kind: str, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None
) -> Identified:
    """Train a network and wrap it for export."""
    settings = network_settings(kind, request)
    found = fit_network(trials, settings, progress, request.validation)
    judges = ", ".join(Path(source).name for source in found.held_out) or "the training trials"
    report = (
        f"weights of step {found.best_step} of {settings.steps}, judged by {judges} "
        f"({found.validation_rmse_deg:.3f} {trials[0].units.angle})"
    )
    history = tuple((look.step, look.validation_rmse_deg) for look in found.history)
    return Identified(network_bundle(found, trials, request.limits), None, history, report, found.interrupted)


def estimate_network(kind: str, trials: Sequence[Trial], request: FitRequest) -> float:
    """Seconds that the training will take, from a few updates of it."""
    return training_seconds(trials, network_settings(kind, request))


def network_steps(kind: str, request: FitRequest) -> int:
    """Epochs or updates."""
    return network_settings(kind, request).steps


def network_settings(kind: str, request: FitRequest) -> NetworkSettings:
    """The preset's settings with what the request changes.

    A feed-forward network, which the papers train on single samples, is trained on windows where the constancy term
    is asked for.
    """
    chosen = NETWORK_PRESETS[kind][request.preset]
    way = chosen.training.model_dump()
    if request.steps is not None:
        way["epochs" if isinstance(chosen.training, WindowTraining) else "updates"] = request.steps
    if request.constancy_weight is not None:
        way["constancy_weight"] = request.constancy_weight
        if request.constancy_weight > 0:
            way["length"] = max(way["length"], _WINDOW)
    changes: dict[str, Any] = {"seed": request.seed, "training": way}
    if request.skip_first_flexure:
        changes["first_flexure_weight"] = 0.0
    if request.validation:
        changes["validation_trials"] = 0
    elif request.hold_out is not None:
        changes["validation_trials"] = request.hold_out
    return NetworkSettings.parse(chosen.model_dump() | changes, f"{kind}, preset {request.preset}")


class NetworkKind(ModelKind):
    """A kind that is a network, with presets of `NETWORK_PRESETS`."""

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: Progress | None = None) -> Identified:
        self.check(trials, request)
        return identify_network(self.name, trials, request, progress)

    def steps(self, request: FitRequest) -> int | None:
        return network_steps(self.name, request)

    def estimate(self, trials: Sequence[Trial], request: FitRequest) -> float | None:
        return estimate_network(self.name, trials, request)
