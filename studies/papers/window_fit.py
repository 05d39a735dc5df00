"""Training with a memory of another length than the preset's: the window study of S2's code."""

from __future__ import annotations

from collections.abc import Sequence

from hystmpc.models.fit.network_bundle import network_bundle
from hystmpc.models.fit.network_settings import NetworkSettings
from hystmpc.models.fit.networks import fit_network
from hystmpc.models.kinds.kind import FitRequest, Identified
from hystmpc.models.kinds.network_fit import network_settings
from hystmpc.models.networks.settings import FeedForwardSettings
from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial

WINDOWS = {"lstm": (2, 10, 20, 30, 40, 50, 100), "fnn_hib": (1, 2, 10, 20, 30, 40, 50, 100)}
"""Lengths that the code of S2 compares [samples]: of a training window, and of a history buffer."""


def fit_with_window(kind: str, trials: Sequence[Trial], request: FitRequest, window: int) -> Identified:
    """Identify with training windows (recurrent networks) or a history buffer (FNN-HIB) of `window` samples.

    Raises:
        FitError: for a kind that has neither, or as its `fit` raises.
    """
    if kind not in WINDOWS:
        raise FitError(f"{kind}: got a window of {window} samples, the window study knows {', '.join(WINDOWS)}")
    settings = windowed(network_settings(kind, request), window)
    found = fit_network(trials, settings, None, request.validation)
    history = tuple((look.step, look.validation_rmse_deg) for look in found.history)
    report = f"weights of step {found.best_step} of {settings.steps}, {window} samples"
    return Identified(network_bundle(found, trials, request.limits), None, history, report, found.interrupted)


def windowed(settings: NetworkSettings, window: int) -> NetworkSettings:
    """The settings with a history buffer of another length for a feed-forward network, else with other windows.

    Raises:
        ConfigError: if the length is not possible.
    """
    data = settings.model_dump()
    if isinstance(settings.network, FeedForwardSettings):
        data["network"]["history"] = window
    else:
        data["training"]["length"] = window
    return NetworkSettings.parse(data, f"window of {window} samples")
