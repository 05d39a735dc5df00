"""Training on streams of whole trials by truncated backpropagation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import cast, final

import numpy as np
import torch

from ..networks.network_ import Network
from .network_settings import NetworkSettings, StreamTraining
from .streams import Rng, Run, Streams, arrange, pause, stretch
from .training_torch_ import Check, Judged, constancy, rounding_error, update, weighted_error, whole_runs

_RAMP_UPDATES = 50  # in which the learning rate rises from zero: Adam's first steps know no curvature

TeacherRuns = Callable[[float, Rng], list[Run]]
"""Scaled runs of a teacher, drawn anew at every call; the first argument is the share of training that is done."""


@dataclass(frozen=True)
class Piece:
    """Pieces of N streams: command, angle and weight (N, L); fresh (N, 1), whether a run begins with it."""

    command: torch.Tensor
    angle: torch.Tensor
    weight: torch.Tensor
    fresh: torch.Tensor


@final
@dataclass
class StreamUpdate:
    """One update on a piece of every stream; `net`, optimisers, schedules and the running mean change."""

    net: Network
    optimisers: list[torch.optim.Optimizer]
    schedules: Sequence[torch.optim.lr_scheduler.LRScheduler]
    averaged: torch.optim.swa_utils.AveragedModel
    way: StreamTraining

    def __call__(self, piece: Piece, state: torch.Tensor | None, step: int) -> tuple[torch.Tensor, float, int]:
        """State after the piece, mean square error before the update, and the samples behind it; 0 for none."""
        start = self.net.start(piece.angle[:, 0])
        state = start if state is None else torch.where(piece.fresh, start, state.detach())
        output, following = self.net(piece.command, state)
        error, used = weighted_error(output, piece.angle, piece.weight)
        if used:
            loss = error
            if self.way.constancy_weight:
                loss = error + self.way.constancy_weight * constancy(output, piece.command)
            update(self.optimisers, self.net, loss, self.way.clip_norm, step)
            for schedule in self.schedules:
                schedule.step()
            self.averaged.update_parameters(self.net)
        return following, float(error.item()), used


def stream_update(net: Network, settings: NetworkSettings, way: StreamTraining) -> StreamUpdate:
    """An update by Muon and Adam."""
    optimisers = _muon_and_adam(net, way.matrix_learning_rate, settings.learning_rate)
    schedules = [torch.optim.lr_scheduler.LambdaLR(o, lambda k: _rate(k, way.updates)) for o in optimisers]
    averaged = torch.optim.swa_utils.AveragedModel(
        net, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(way.averaging)
    )
    return StreamUpdate(net, optimisers, schedules, averaged, way)


def stream_checks(
    net: Network,
    training: Sequence[Run],
    held_out: Sequence[Run],
    teacher: TeacherRuns,
    settings: NetworkSettings,
    way: StreamTraining,
) -> Iterator[Check]:
    """A look after every few rounds, at free runs over whole held-out trials by the averaged weights."""
    rng = np.random.default_rng(settings.seed)
    improve = stream_update(net, settings, way)
    judged = whole_runs(held_out, settings.warmup_samples)
    step = rounds = 0
    squares = samples = 0.0
    while step < way.updates:
        runs = stretch([run for run in training for _ in range(way.copies)], way.time_scaling, rng)
        runs = pause(runs, way.longest_pause, rng)
        runs += teacher(step / way.updates, rng)
        state = None
        for piece in pieces(arrange(runs, way.streams, way.length, settings.warmup_samples, rng)):
            state, error, used = improve(piece, state, step)
            step, squares, samples = step + (used > 0), squares + used * error, samples + used
            if step == way.updates:
                break
        rounds += 1
        if rounds % way.rounds_between_checks == 0 or step == way.updates:
            yield _look(step, math.sqrt(squares / samples), cast(Network, improve.averaged.module), judged)
            squares = samples = 0.0


def pieces(streams: Streams) -> Iterator[Piece]:
    """One after the other, as tensors."""
    for k in range(len(streams.command)):
        parts = (streams.command[k], streams.angle[k], streams.weight[k], streams.fresh[k][:, None])
        yield Piece(*(torch.from_numpy(np.ascontiguousarray(part)) for part in parts))


def _look(step: int, training: float, mean: Network, judged: Judged) -> Check:
    output = judged.output(mean)
    return Check(step, training, _mean_run_error(output, judged), rounding_error(mean, judged, output), mean)


def _muon_and_adam(net: Network, matrix_rate: float, rate: float) -> list[torch.optim.Optimizer]:
    """Muon (Jordan et al., 2024) for the matrices between layers, Adam for the rest: biases, input weights, head.

    Orthogonalised steps move all directions of a matrix alike. On hysteresis they reach half of Adam's error in the
    same number of updates; supposedly, since the directions that tell loading from unloading have small gradients.
    """
    matrices = net.matrices
    others = [p for p in net.parameters() if p.requires_grad and all(p is not matrix for matrix in matrices)]
    adam = torch.optim.Adam(others, lr=rate)
    if not matrices:
        return [adam]
    return [torch.optim.Muon(matrices, lr=matrix_rate, weight_decay=0.0, adjust_lr_fn="match_rms_adamw"), adam]


def _rate(step: int, updates: int) -> float:
    """Factor on the learning rate: a short ramp up, then half a cosine down to zero."""
    return min(1.0, (step + 1) / _RAMP_UPDATES) * 0.5 * (1.0 + math.cos(math.pi * min(1.0, step / updates)))


def _mean_run_error(output: torch.Tensor, batch: Judged) -> float:
    """Root of the mean over runs of their mean square errors, so that a long trial counts as much as a short one."""
    each = (batch.weight * (output - batch.angle) ** 2).sum(dim=1) / torch.count_nonzero(batch.weight, dim=1)
    return math.sqrt(each.mean().item())
