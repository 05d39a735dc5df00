"""Training in PyTorch: on short windows as in both papers, and on streams of whole trials."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import cast, final

import numpy as np
import torch

from hystmpc.trials.errors import FitError
from hystmpc.trials.types import Vec

from ..networks.network_ import Network, numbers
from ..networks.settings import NetworkSettings, StreamTraining, WindowTraining
from .runs import Rng, Streams, TrainingRun, arrange, draw_windows, pause, stretch

_EPSILON = 1e-4  # of S2 (RA-L 2024) eq. (12)


@dataclass(frozen=True)
class Check:
    """State of the training at one check.

    Attributes:
        training: root mean square error since the last check, scaled.
        judged: root mean square error of `net` on held-out trials, scaled.
        rounding: largest difference between `net` in single and in double precision on held-out trials, scaled.
        net: the judged network; it changes in further training.
    """

    step: int
    training: float
    judged: float
    rounding: float
    net: Network


@contextmanager
def torch_session(seed: int, threads: int) -> Iterator[None]:
    """Context of PyTorch seeded and on a fixed number of threads; both are restored."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            yield
    finally:
        torch.set_num_threads(before)


def update(
    optimisers: Sequence[torch.optim.Optimizer], net: Network, loss: torch.Tensor, clip_norm: float, step: int
) -> None:
    """Update the network by one gradient step.

    Raises:
        FitError: if the loss is not finite.
    """
    if not math.isfinite(loss.item()):
        raise FitError(f"training diverged: the loss is {loss.item()} at step {step}; lower learning_rate")
    net.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(net.parameters(), clip_norm)
    for optimiser in optimisers:
        optimiser.step()


def weighted_error(output: torch.Tensor, angle: torch.Tensor, weight: torch.Tensor) -> tuple[torch.Tensor, int]:
    """Weighted mean square error over the samples that count, and their number."""
    used = int(torch.count_nonzero(weight))
    return (weight * (output - angle) ** 2).sum() / max(used, 1), used


def constancy(output: torch.Tensor, command: torch.Tensor) -> torch.Tensor:
    """Constant-in, constant-out term, S2 eq. (12): mean over windows of std(output) / (std(command) + eps)."""
    return (output.std(dim=1) / (command.std(dim=1) + _EPSILON)).mean()


@dataclass(frozen=True)
class ValidationRuns:
    """Held-out runs as one batch.

    Attributes:
        start: outputs from which the states start (N,).
        past: inputs before the start (N, context).
        command, angle, weight: (N, T).
    """

    start: torch.Tensor
    past: torch.Tensor
    command: torch.Tensor
    angle: torch.Tensor
    weight: torch.Tensor

    def head(self, rows: int) -> ValidationRuns:
        """The first `rows` runs."""
        return ValidationRuns(*(part[:rows] for part in (self.start, self.past, self.command, self.angle, self.weight)))

    def output(self, net: Network) -> torch.Tensor:
        """Outputs (N, T), in the precision of the network."""
        exact = next(net.parameters()).dtype
        start, past, command = (part.to(exact) for part in (self.start, self.past, self.command))
        with torch.no_grad():
            state = net.begin(past, start) if past.shape[1] else net.start(start)
            return net(command, state)[0]


def whole_runs(runs: Sequence[TrainingRun], warmup: int) -> ValidationRuns:
    """Batch of whole runs, padded to the longest, for free runs from their start."""
    longest = warmup + max(run.command.size for run in runs)
    streams = arrange(runs, len(runs), longest, warmup, np.random.default_rng(0))
    command, angle, weight = (torch.from_numpy(part[0]) for part in (streams.command, streams.angle, streams.weight))
    return ValidationRuns(angle[:, 0], command[:, :0], command, angle, weight)


def rounding_error(net: Network, judged: ValidationRuns, output: torch.Tensor) -> float:
    """Error of a free run in single precision; a network that amplifies it is chaotic and cannot be exported."""
    exact = judged.output(copy.deepcopy(net).double())
    return float((exact - output).abs().max())


_ROUNDED = 64  # windows that are also simulated in double precision, which is slow without a fused LSTM


@final
@dataclass
class WindowUpdate:
    """Update on a batch of windows; `net` and `optimiser` change."""

    net: Network
    optimiser: torch.optim.Optimizer
    scheme: WindowTraining

    def __call__(self, batch: ValidationRuns, step: int) -> tuple[float, int]:
        """Mean square error before the update, and its number of samples."""
        output, _ = self.net(batch.command, self.net.begin(batch.past, batch.start))
        error, used = weighted_error(output, batch.angle, batch.weight)
        loss = error
        if self.scheme.constancy_weight:
            loss = error + self.scheme.constancy_weight * constancy(output, batch.command)
        update([self.optimiser], self.net, loss, math.inf, step)
        return float(error.item()), used


def window_update(net: Network, settings: NetworkSettings, scheme: WindowTraining) -> WindowUpdate:
    """Window update by Adam."""
    return WindowUpdate(net, torch.optim.Adam(_trained(net), lr=settings.learning_rate), scheme)


def window_checks(
    net: Network,
    training: Sequence[TrainingRun],
    held_out: Sequence[TrainingRun],
    settings: NetworkSettings,
    scheme: WindowTraining,
) -> Iterator[Check]:
    """Checks after every epoch, on windows of the held-out trials, a fifth as many as in an epoch."""
    rng = np.random.default_rng(settings.seed)
    improve = window_update(net, settings, scheme)
    count = scheme.windows_per_epoch or sum(run.command.size for run in training)
    length = net.context + scheme.length
    signals = [_signals(net, run) for run in training]
    judged = cut(net, draw_windows([_signals(net, run) for run in held_out], -(-count // 5), length, rng))
    for epoch in range(1, scheme.epochs + 1):
        parts = draw_windows(signals, count, length, rng)
        squares = samples = 0.0
        for first in range(0, count, scheme.batch):
            error, used = improve(cut(net, tuple(part[first : first + scheme.batch] for part in parts)), epoch)
            squares, samples = squares + used * error, samples + used
        output = judged.output(net)
        error_now, _ = weighted_error(output, judged.angle, judged.weight)
        rounding = rounding_error(net, judged.head(_ROUNDED), output[:_ROUNDED])
        yield Check(epoch, math.sqrt(squares / max(samples, 1)), math.sqrt(error_now.item()), rounding, net)


def cut(net: Network, parts: Sequence[np.ndarray]) -> ValidationRuns:
    """Batch of windows (N, context + length) of command, angle, weight and initial output."""
    command, angle, weight, shown = (torch.from_numpy(part) for part in parts)
    at = net.context
    return ValidationRuns(shown[:, at], command[:, :at], command[:, at:], angle[:, at:], weight[:, at:])


def _signals(net: Network, run: TrainingRun) -> tuple[Vec, ...]:
    with torch.no_grad():
        shown = net.shown(*(torch.tensor(part, dtype=torch.float32)[None] for part in (run.command, run.angle)))
    return run.command, run.angle, run.weight, numbers(shown)[0]


def _trained(net: Network) -> list[torch.nn.Parameter]:
    return [p for p in net.parameters() if p.requires_grad]


_RAMP_UPDATES = 50  # updates with a rising learning rate, while Adam has no estimate of the curvature

TeacherRuns = Callable[[float, Rng], list[TrainingRun]]
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
    """Update on a piece of every stream; `net`, optimisers, schedules and the running mean change."""

    net: Network
    optimisers: list[torch.optim.Optimizer]
    schedules: Sequence[torch.optim.lr_scheduler.LRScheduler]
    averaged: torch.optim.swa_utils.AveragedModel
    scheme: StreamTraining

    def __call__(self, piece: Piece, state: torch.Tensor | None, step: int) -> tuple[torch.Tensor, float, int]:
        """State after the piece, mean square error before the update, and its number of samples; 0 for none."""
        start = self.net.start(piece.angle[:, 0])
        state = start if state is None else torch.where(piece.fresh, start, state.detach())
        output, following = self.net(piece.command, state)
        error, used = weighted_error(output, piece.angle, piece.weight)
        if used:
            loss = error
            if self.scheme.constancy_weight:
                loss = error + self.scheme.constancy_weight * constancy(output, piece.command)
            update(self.optimisers, self.net, loss, self.scheme.clip_norm, step)
            for schedule in self.schedules:
                schedule.step()
            self.averaged.update_parameters(self.net)
        return following, float(error.item()), used


def stream_update(net: Network, settings: NetworkSettings, scheme: StreamTraining) -> StreamUpdate:
    """Stream update by Muon and Adam."""
    optimisers = _muon_and_adam(net, scheme.matrix_learning_rate, settings.learning_rate)
    schedules = [torch.optim.lr_scheduler.LambdaLR(o, lambda k: _rate(k, scheme.updates)) for o in optimisers]
    averaged = torch.optim.swa_utils.AveragedModel(
        net, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(scheme.averaging)
    )
    return StreamUpdate(net, optimisers, schedules, averaged, scheme)


def stream_checks(
    net: Network,
    training: Sequence[TrainingRun],
    held_out: Sequence[TrainingRun],
    teacher: TeacherRuns,
    settings: NetworkSettings,
    scheme: StreamTraining,
) -> Iterator[Check]:
    """Checks after every few rounds, by free runs of the averaged weights over whole held-out trials."""
    rng = np.random.default_rng(settings.seed)
    improve = stream_update(net, settings, scheme)
    judged = whole_runs(held_out, settings.warmup_samples)
    step = rounds = 0
    squares = samples = 0.0
    while step < scheme.updates:
        runs = stretch([run for run in training for _ in range(scheme.copies)], scheme.time_scaling, rng)
        runs = pause(runs, scheme.longest_pause, rng)
        runs += teacher(step / scheme.updates, rng)
        state = None
        for piece in pieces(arrange(runs, scheme.streams, scheme.length, settings.warmup_samples, rng)):
            state, error, used = improve(piece, state, step)
            step, squares, samples = step + (used > 0), squares + used * error, samples + used
            if step == scheme.updates:
                break
        rounds += 1
        if rounds % scheme.rounds_between_checks == 0 or step == scheme.updates:
            yield _look(step, math.sqrt(squares / samples), cast(Network, improve.averaged.module), judged)
            squares = samples = 0.0


def pieces(streams: Streams) -> Iterator[Piece]:
    """Pieces in order, as tensors."""
    for k in range(len(streams.command)):
        parts = (streams.command[k], streams.angle[k], streams.weight[k], streams.fresh[k][:, None])
        yield Piece(*(torch.from_numpy(np.ascontiguousarray(part)) for part in parts))


def _look(step: int, training: float, mean: Network, judged: ValidationRuns) -> Check:
    output = judged.output(mean)
    return Check(step, training, _mean_run_error(output, judged), rounding_error(mean, judged, output), mean)


def _muon_and_adam(net: Network, matrix_rate: float, rate: float) -> list[torch.optim.Optimizer]:
    """Muon (Jordan et al., 2024; half of Adam's error in as many updates) for inner matrices, Adam for the rest."""
    matrices = net.matrices
    others = [p for p in net.parameters() if p.requires_grad and all(p is not matrix for matrix in matrices)]
    adam = torch.optim.Adam(others, lr=rate)
    if not matrices:
        return [adam]
    return [torch.optim.Muon(matrices, lr=matrix_rate, weight_decay=0.0, adjust_lr_fn="match_rms_adamw"), adam]


def _rate(step: int, updates: int) -> float:
    """Factor on the learning rate: a short ramp up, then half a cosine down to zero."""
    return min(1.0, (step + 1) / _RAMP_UPDATES) * 0.5 * (1.0 + math.cos(math.pi * min(1.0, step / updates)))


def _mean_run_error(output: torch.Tensor, batch: ValidationRuns) -> float:
    """Root of the mean over runs of their mean square errors, so that a long trial counts as much as a short one."""
    each = (batch.weight * (output - batch.angle) ** 2).sum(dim=1) / torch.count_nonzero(batch.weight, dim=1)
    return math.sqrt(each.mean().item())
