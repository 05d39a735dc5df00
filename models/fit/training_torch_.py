"""What both ways to train a network in PyTorch share: session, update, loss, and the look at what is held out."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch

from hystmpc.trials.errors import FitError

from ..networks.network_ import Network
from .streams import Run, arrange

_EPSILON = 1e-4  # of S2 eq. (12)


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
    net: Network


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


def update(
    optimisers: Sequence[torch.optim.Optimizer], net: Network, loss: torch.Tensor, clip_norm: float, step: int
) -> None:
    """One step down the gradient.

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
    """Constant in, constant out, S2 eq. (12): mean over windows of std(output) / (std(command) + eps)."""
    return (output.std(dim=1) / (command.std(dim=1) + _EPSILON)).mean()


@dataclass(frozen=True)
class Judged:
    """What is held out, as one batch.

    Attributes:
        start: what the states start from (N,).
        past: inputs before it that the network sees (N, context).
        command, angle, weight: (N, T).
    """

    start: torch.Tensor
    past: torch.Tensor
    command: torch.Tensor
    angle: torch.Tensor
    weight: torch.Tensor

    def head(self, rows: int) -> Judged:
        """The first `rows` of it."""
        return Judged(*(part[:rows] for part in (self.start, self.past, self.command, self.angle, self.weight)))

    def output(self, net: Network) -> torch.Tensor:
        """Outputs (N, T), in the precision of the network."""
        exact = next(net.parameters()).dtype
        start, past, command = (part.to(exact) for part in (self.start, self.past, self.command))
        with torch.no_grad():
            state = net.begin(past, start) if past.shape[1] else net.start(start)
            return net(command, state)[0]


def whole_runs(runs: Sequence[Run], warmup: int) -> Judged:
    """Whole runs as one piece, filled up to the longest, for free runs from their start."""
    longest = warmup + max(run.command.size for run in runs)
    streams = arrange(runs, len(runs), longest, warmup, np.random.default_rng(0))
    command, angle, weight = (torch.from_numpy(part[0]) for part in (streams.command, streams.angle, streams.weight))
    return Judged(angle[:, 0], command[:, :0], command, angle, weight)


def rounding_error(net: Network, judged: Judged, output: torch.Tensor) -> float:
    """What single precision does to a free run. A network that amplifies it is chaotic and cannot be exported."""
    exact = judged.output(copy.deepcopy(net).double())
    return float((exact - output).abs().max())
