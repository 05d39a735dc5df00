"""Training on short windows, as in both papers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
import torch

from hystmpc.trials.types import Vec

from ..networks.network_ import Network, numbers
from ..train.windows import draw_windows
from .network_settings import NetworkSettings, WindowTraining
from .streams import Run
from .training_torch_ import Check, Judged, constancy, rounding_error, update, weighted_error

_ROUNDED = 64  # windows that are run in double precision as well, which has no fused LSTM and is slow


@final
@dataclass
class WindowUpdate:
    """One update on a batch of windows; `net` and `optimiser` change."""

    net: Network
    optimiser: torch.optim.Optimizer
    way: WindowTraining

    def __call__(self, batch: Judged, step: int) -> tuple[float, int]:
        """Mean square error before the update, and the samples behind it."""
        output, _ = self.net(batch.command, self.net.begin(batch.past, batch.start))
        error, used = weighted_error(output, batch.angle, batch.weight)
        loss = error
        if self.way.constancy_weight:
            loss = error + self.way.constancy_weight * constancy(output, batch.command)
        update([self.optimiser], self.net, loss, math.inf, step)
        return float(error.item()), used


def window_update(net: Network, settings: NetworkSettings, way: WindowTraining) -> WindowUpdate:
    """An update by Adam."""
    return WindowUpdate(net, torch.optim.Adam(_trained(net), lr=settings.learning_rate), way)


def window_checks(
    net: Network, training: Sequence[Run], held_out: Sequence[Run], settings: NetworkSettings, way: WindowTraining
) -> Iterator[Check]:
    """One look after every epoch, at windows of the held-out trials, a fifth as many as in an epoch."""
    rng = np.random.default_rng(settings.seed)
    improve = window_update(net, settings, way)
    count = way.windows_per_epoch or sum(run.command.size for run in training)
    length = net.context + way.length
    signals = [_signals(net, run) for run in training]
    judged = cut(net, draw_windows([_signals(net, run) for run in held_out], -(-count // 5), length, rng))
    for epoch in range(1, way.epochs + 1):
        parts = draw_windows(signals, count, length, rng)
        squares = samples = 0.0
        for first in range(0, count, way.batch):
            error, used = improve(cut(net, tuple(part[first : first + way.batch] for part in parts)), epoch)
            squares, samples = squares + used * error, samples + used
        output = judged.output(net)
        error_now, _ = weighted_error(output, judged.angle, judged.weight)
        rounding = rounding_error(net, judged.head(_ROUNDED), output[:_ROUNDED])
        yield Check(epoch, math.sqrt(squares / max(samples, 1)), math.sqrt(error_now.item()), rounding, net)


def cut(net: Network, parts: Sequence[np.ndarray]) -> Judged:
    """A batch of windows (N, context + length) of command, angle, weight and what the state starts from."""
    command, angle, weight, shown = (torch.from_numpy(part) for part in parts)
    at = net.context
    return Judged(shown[:, at], command[:, :at], command[:, at:], angle[:, at:], weight[:, at:])


def _signals(net: Network, run: Run) -> tuple[Vec, ...]:
    with torch.no_grad():
        shown = net.shown(*(torch.tensor(part, dtype=torch.float32)[None] for part in (run.command, run.angle)))
    return run.command, run.angle, run.weight, numbers(shown)[0]


def _trained(net: Network) -> list[torch.nn.Parameter]:
    return [p for p in net.parameters() if p.requires_grad]
