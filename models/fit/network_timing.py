"""How long a training will take: a few of its updates are made on random numbers and timed."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial

from ..identify.trial_set import check_trial_set
from ..networks.settings import HybridSettings
from ..operators.backlash import Backlash
from ..operators.operator import Operator
from ..train.hold_out import hold_out
from .network_settings import NetworkSettings, StreamTraining, WindowTraining

if TYPE_CHECKING:
    from ..networks.network_ import Network

_FIRST, _TIMED = 3, 12


def training_seconds(trials: Sequence[Trial], settings: NetworkSettings) -> float:
    """Expected duration of `fit_network` [s] on this machine as it is loaded now: its updates, nothing beside them.

    Fitting a backlash or a teacher beforehand takes seconds, looks at what is held out some percent.

    Raises:
        FitError: on unusable trials, if too few are left to train on, or if torch is not installed.
    """
    check_trial_set(trials)
    try:
        from ..networks.build_ import new_network
        from .training_torch_ import torch_session
    except ModuleNotFoundError as error:
        raise FitError(f"training needs {error.name}, expected it installed: pip install hystmpc[train]") from None
    training, _ = hold_out(trials, settings.validation_trials, settings.seed)
    with torch_session(settings.seed, settings.threads):
        net = new_network(settings.network, 0.0, _some_operator(settings))
        way = settings.training
        if isinstance(way, StreamTraining):
            return way.updates * _seconds_of(_stream_update(net, settings, way))
        count = way.windows_per_epoch or sum(len(trial) + way.padding_samples for trial in training)
        return way.epochs * math.ceil(count / way.batch) * _seconds_of(_window_update(net, settings, way))


def _seconds_of(improve: Callable[[], object]) -> float:
    """Median duration of one call [s]."""
    durations = []
    for _ in range(_FIRST + _TIMED):
        before = time.perf_counter()
        improve()
        durations.append(time.perf_counter() - before)
    return float(np.median(durations[_FIRST:]))


def _some_operator(settings: NetworkSettings) -> Operator | None:
    return Backlash(1.0, 1.0, 0.1, -0.1) if isinstance(settings.network, HybridSettings) else None


def _window_update(net: Network, settings: NetworkSettings, way: WindowTraining) -> Callable[[], object]:
    from .windows_torch_ import cut, window_update

    rng, improve = np.random.default_rng(0), window_update(net, settings, way)
    parts = [rng.uniform(-1, 1, (way.batch, net.context + way.length)).astype(np.float32) for _ in range(4)]
    return lambda: improve(cut(net, parts), 0)


def _stream_update(net: Network, settings: NetworkSettings, way: StreamTraining) -> Callable[[], object]:
    import torch

    from .streams_torch_ import Piece, stream_update

    improve = stream_update(net, settings, way)
    signal = torch.rand(way.streams, way.length)
    piece = Piece(signal, signal, torch.ones_like(signal), torch.ones(way.streams, 1, dtype=torch.bool))
    return lambda: improve(piece, None, 0)
