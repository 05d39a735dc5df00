"""The two ways to train an LSTM in PyTorch: short windows, and streams of whole trials."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import cast

import numpy as np
import torch

from hystmpc.trials.errors import FitError

from ..lstm.torch_ import LstmNet
from .lstm_settings import LstmSettings, StreamTraining, WindowTraining
from .streams import Rng, Run, Streams, arrange, pause, stretch
from .windows import draw_windows

_EPSILON = 1e-4  # of S2 eq. (12)
_RAMP_UPDATES = 50  # in which the learning rate rises from zero: Adam's first steps know no curvature


@dataclass(frozen=True)
class Check:
    """The state of training at one look.

    Attributes:
        step: epochs or updates done.
        training: root mean square error since the last look, scaled.
        judged: root mean square error of `net` on what is held out, scaled.
        rounding: largest difference between `net` in single and in double precision on what is held out, scaled.
        net: the network that was judged; it goes on changing.
    """

    step: int
    training: float
    judged: float
    rounding: float
    net: LstmNet


TeacherRuns = Callable[[float, Rng], list[Run]]
"""Scaled runs of a teacher, drawn anew at every call; the first argument is the share of training that is done."""


@contextmanager
def torch_session(seed: int, threads: int) -> Iterator[None]:
    """Seeded, on a fixed number of threads; both go back to what they were."""
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            yield
    finally:
        torch.set_num_threads(before)


def new_net(settings: LstmSettings) -> LstmNet:
    """PyTorch's initial weights with a gain on the command and, with `memory_samples`, gates that remember.

    Memories tau from 1 to that many samples, log(tau) uniform: forget bias log(tau), input bias -log(tau), after Tallec
    and Ollivier, ICLR 2018.
    """
    net = LstmNet(settings.hidden, settings.layers)
    getattr(net.lstm, "weight_ih_l0").data.mul_(settings.command_gain)  # noqa: B009  # PyTorch sets it at run time
    if settings.memory_samples:
        for k in range(settings.layers):
            bias = getattr(net.lstm, f"bias_ih_l{k}").data
            memory = torch.rand(settings.hidden) * math.log(settings.memory_samples)
            bias[: settings.hidden] = -memory
            bias[settings.hidden : 2 * settings.hidden] = memory
    return net


def window_checks(
    net: LstmNet, training: Sequence[Run], held_out: Sequence[Run], settings: LstmSettings, way: WindowTraining
) -> Iterator[Check]:
    """One look after every epoch, at windows of the held-out trials, a fifth as many as in an epoch."""
    rng = np.random.default_rng(settings.seed)
    optimisers = [torch.optim.Adam(net.parameters(), lr=settings.learning_rate)]
    count = way.windows_per_epoch or sum(run.command.size for run in training)
    judged = [torch.from_numpy(part) for part in draw_windows(held_out, -(-count // 5), way.length, rng)]
    for epoch in range(1, way.epochs + 1):
        parts = [torch.from_numpy(part).split(way.batch) for part in draw_windows(training, count, way.length, rng)]
        squares = samples = 0.0
        for command, angle, weight in zip(*parts, strict=True):
            output, _ = net(command)
            error, used = _weighted_error(output, angle, weight)
            loss = error + way.constancy_weight * _constancy(output, command)
            _update(optimisers, net, loss, math.inf, epoch)
            squares, samples = squares + used * error.item(), samples + used
        output = judged_output(net, judged[0])
        error, _ = _weighted_error(output, judged[1], judged[2])
        rounding = rounding_error(net, judged[0], output)
        yield Check(epoch, math.sqrt(squares / samples), math.sqrt(error.item()), rounding, net)


def stream_checks(
    net: LstmNet,
    training: Sequence[Run],
    held_out: Sequence[Run],
    teacher: TeacherRuns,
    settings: LstmSettings,
    way: StreamTraining,
) -> Iterator[Check]:
    """A look after every few rounds, at free runs over whole held-out trials by the averaged weights."""
    rng = np.random.default_rng(settings.seed)
    optimisers = _muon_and_adam(net, way.matrix_learning_rate, settings.learning_rate)
    schedules = [torch.optim.lr_scheduler.LambdaLR(o, lambda k: _rate(k, way.updates)) for o in optimisers]
    averaged = torch.optim.swa_utils.AveragedModel(
        net, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(way.averaging)
    )
    judged = _as_one_batch(held_out, settings.warmup_samples)
    step = rounds = 0
    squares = samples = 0.0
    while step < way.updates:
        runs = stretch([run for run in training for _ in range(way.copies)], way.time_scaling, rng)
        runs = pause(runs, way.longest_pause, rng)
        runs += teacher(step / way.updates, rng)
        state = None
        streams = arrange(runs, way.streams, way.length, settings.warmup_samples, rng)
        for command, angle, weight, fresh in _pieces(streams):
            if state is not None:
                state = (state[0].detach() * ~fresh, state[1].detach() * ~fresh)
            output, state = net(command, state)
            error, used = _weighted_error(output, angle, weight)
            if not used:
                continue
            _update(optimisers, net, error, way.clip_norm, step)
            for schedule in schedules:
                schedule.step()
            averaged.update_parameters(net)
            step, squares, samples = step + 1, squares + used * error.item(), samples + used
            if step == way.updates:
                break
        rounds += 1
        if rounds % way.rounds_between_checks == 0 or step == way.updates:
            mean = cast(LstmNet, averaged.module)
            output = judged_output(mean, judged[0])
            rounding = rounding_error(mean, judged[0], output)
            yield Check(step, math.sqrt(squares / samples), _mean_run_error(output, judged), rounding, mean)
            squares = samples = 0.0


def _muon_and_adam(net: LstmNet, matrix_rate: float, rate: float) -> list[torch.optim.Optimizer]:
    """Muon (Jordan et al., 2024) for the square gate matrices, Adam for the rest: biases, command weights, head.

    Orthogonalised steps move all directions of a matrix alike. On hysteresis they reach half of Adam's error in the
    same number of updates; supposedly, since the directions that tell loading from unloading have small gradients.
    """
    matrices = [p for name, p in net.named_parameters() if name.startswith("lstm.") and p.ndim == 2 and p.shape[1] > 1]
    others = [p for p in net.parameters() if all(p is not matrix for matrix in matrices)]
    muon = torch.optim.Muon(matrices, lr=matrix_rate, weight_decay=0.0, adjust_lr_fn="match_rms_adamw")
    return [muon, torch.optim.Adam(others, lr=rate)]


def _update(
    optimisers: Sequence[torch.optim.Optimizer], net: LstmNet, loss: torch.Tensor, clip_norm: float, step: int
) -> None:
    if not math.isfinite(loss.item()):
        raise FitError(f"training diverged: the loss is {loss.item()} at step {step}; lower learning_rate")
    net.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_norm_(net.parameters(), clip_norm)
    for optimiser in optimisers:
        optimiser.step()


def _weighted_error(output: torch.Tensor, angle: torch.Tensor, weight: torch.Tensor) -> tuple[torch.Tensor, int]:
    """Weighted mean square error over the samples that count, and their number."""
    used = int(torch.count_nonzero(weight))
    return (weight * (output - angle) ** 2).sum() / max(used, 1), used


def _constancy(output: torch.Tensor, command: torch.Tensor) -> torch.Tensor:
    """Constant in, constant out, S2 eq. (12): mean over windows of std(output) / (std(command) + eps)."""
    return (output.std(dim=1) / (command.std(dim=1) + _EPSILON)).mean()


def _rate(step: int, updates: int) -> float:
    """Factor on the learning rate: a short ramp up, then half a cosine down to zero."""
    return min(1.0, (step + 1) / _RAMP_UPDATES) * 0.5 * (1.0 + math.cos(math.pi * min(1.0, step / updates)))


def _pieces(streams: Streams) -> Iterator[tuple[torch.Tensor, ...]]:
    for k in range(len(streams.command)):
        parts = (streams.command[k], streams.angle[k], streams.weight[k], streams.fresh[k][None, :, None])
        yield tuple(torch.from_numpy(np.ascontiguousarray(part)) for part in parts)


def _as_one_batch(runs: Sequence[Run], warmup: int) -> tuple[torch.Tensor, ...]:
    """Whole runs as one piece, filled up to the longest."""
    longest = warmup + max(run.command.size for run in runs)
    streams = arrange(runs, len(runs), longest, warmup, np.random.default_rng(0))
    return tuple(torch.from_numpy(part[0]) for part in (streams.command, streams.angle, streams.weight))


def judged_output(net: LstmNet, command: torch.Tensor) -> torch.Tensor:
    with torch.no_grad():
        return net(command)[0]


def rounding_error(net: LstmNet, command: torch.Tensor, output: torch.Tensor) -> float:
    """What single precision does to a free run. A network that amplifies it is chaotic and cannot be exported."""
    exact = judged_output(copy.deepcopy(net).double(), command.double())
    return float((exact - output).abs().max())


def _mean_run_error(output: torch.Tensor, batch: tuple[torch.Tensor, ...]) -> float:
    """Root of the mean over runs of their mean square errors, so that a long trial counts as much as a short one."""
    each = (batch[2] * (output - batch[1]) ** 2).sum(dim=1) / torch.count_nonzero(batch[2], dim=1)
    return math.sqrt(each.mean().item())
