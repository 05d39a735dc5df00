"""Identification by Adam on short windows, the training of operators in S2, with exact compiled sensitivities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.decades import size_of
from hystmpc.models.identify.chain_fit import ChainFit, ChainTask, Tracker
from hystmpc.models.identify.free_run import FreeRuns, StagedChain
from hystmpc.models.identify.runs import check_trial_set, end_to_end
from hystmpc.models.model import FitProgress
from hystmpc.trials.errors import FitError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec


@dataclass(frozen=True)
class AdamSettings:
    """Settings of a fit by Adam, with the values of S2 if printed.

    Attributes:
        epochs: greatest number of passes.
        window: samples of a window.
        batch: windows of a step.
        rate: step size, in units of the parameters' scales (see `parameter_scales`); not printed in S2.
        windows_per_epoch: windows drawn in an epoch; None for as many as the trials hold side by side.
        skip_first_flexure: draw no window from before the first reversal of a trial's command.
        seed: of the draw.

    Raises:
        FitError: if a number is not positive.
    """

    epochs: int = 300
    window: int = 50
    batch: int = 16
    rate: float = 1e-3
    windows_per_epoch: int | None = None
    skip_first_flexure: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if min(self.epochs, self.window - 1, self.batch, self.rate, self.windows_per_epoch or 1) <= 0:
            raise FitError(f"got {self}, expected positive numbers and windows of at least 2 samples")


@dataclass(frozen=True, eq=False)
class Windows:
    """Pieces of trials of equal length: commands and angles (N, W)."""

    commands: Vec
    angles: Vec


class WindowLoss:
    """Mean square error over windows, each from the state that matches its first measured output.

    Derivatives are those of the active branch: the switching itself is not differentiated, as S2 detaches it.
    """

    def __init__(self, chain: Chain, dt: float) -> None:
        self._dt, self._staged = dt, StagedChain(chain)

    def value(self, p: Vec, windows: Windows) -> float:
        """Loss at parameters p (P,)."""
        state = self._staged.rest(windows.commands[:, 0], windows.angles[:, 0], p)
        theta, _ = self._staged.simulate(windows.commands.T, self._dt, state, p)
        loss = float(np.mean((theta.T - windows.angles) ** 2))
        return loss if np.isfinite(loss) else np.inf

    def gradient(self, p: Vec, windows: Windows) -> Vec:
        """Gradient (P,) of the loss by p."""
        start = self._staged.rest_with_slope(windows.commands[:, 0], windows.angles[:, 0], p)
        commands, first = end_to_end(list(windows.commands))
        theta, by_p = self._staged.differentiate(commands, self._dt, *start, p, first=first)
        return 2 * (theta - windows.angles.ravel()) @ by_p / commands.size


def fit_by_adam(task: ChainTask, settings: AdamSettings, progress: FitProgress | None = None) -> ChainFit:
    """Fit by Adam from the best of the task's starts; the epoch with the lowest loss over all windows is kept.

    These windows lie side by side. Parameters stay within their physical bounds. KeyboardInterrupt ends the fit and
    keeps the best epoch so far; progress gets the epoch and the root of the best loss.
    """
    dt, template = check_trial_set(task.trials), task.starts[0]
    pieces = [_counted(trial, settings) for trial in task.trials]
    loss, side_by_side = WindowLoss(template, dt), _side_by_side(pieces, settings.window)
    tracker = Tracker(lambda p: loss.value(p, side_by_side), task.free, progress)
    q = min((task.free.part(start.values) for start in task.starts), key=tracker)
    interrupted = False
    try:
        _descend(q, task, settings, loss, tracker, pieces)
    except KeyboardInterrupt:
        interrupted = True
    chain = tracker.chain(template, interrupted)
    rmse = np.sqrt(FreeRuns(template, task.trials, settings.skip_first_flexure).mse(chain.values))
    return ChainFit(chain, float(rmse), tracker.evaluations, tracker.report("adam", settings.epochs), interrupted)


def _descend(
    q: Vec, task: ChainTask, settings: AdamSettings, loss: WindowLoss, tracker: Tracker, pieces: list[Windows]
) -> None:
    """Run all epochs of Adam with its usual constants (Kingma and Ba, ICLR 2015)."""
    rng, free = np.random.default_rng(settings.seed), task.free
    scales = free.part(parameter_scales(task.starts[0], task.trials))
    count = settings.windows_per_epoch or sum(p.commands.size for p in pieces) // settings.window
    output = float(np.ptp(np.concatenate([piece.angles.ravel() for piece in pieces])))
    mean, square, step = np.zeros(q.size), np.zeros(q.size), 0
    for _ in range(settings.epochs):
        for _ in range(max(1, count // settings.batch)):
            drawn = _draw(pieces, settings, rng)
            slope = free.part(loss.gradient(free.full(q), drawn)) * scales / output**2
            slope, step = np.nan_to_num(slope, posinf=0.0, neginf=0.0), step + 1
            mean, square = 0.9 * mean + 0.1 * slope, 0.999 * square + 0.001 * slope**2
            move = mean / (1 - 0.9**step) / (np.sqrt(square / (1 - 0.999**step)) + 1e-8)
            q = np.clip(q - settings.rate * scales * move, *free.bounds)
        tracker.iteration(tracker(q))


def parameter_scales(chain: Chain, trials: Sequence[Trial]) -> Vec:
    """Natural size (P,) of each parameter, from its unit and the ranges of the trials.

    A command counts as its range, an angle as its range, a second as the range of the command over its greatest
    speed: what normalised signals make of them.
    """
    forward = [trial.swapped() if trial.inverted else trial for trial in trials]
    span = max(float(np.ptp(trial.command)) for trial in forward)
    speed = max(float(np.max(np.abs(np.diff(trial.command)))) / trial.dt for trial in forward)
    sizes = {"cmd": span, "deg": max(float(np.ptp(t.angle)) for t in forward), "s": span / speed}
    return np.array([size_of(parameter.unit, sizes) for parameter in chain.parameters])


def _counted(trial: Trial, settings: AdamSettings) -> Windows:
    """Part of a trial from which windows are drawn, as one row."""
    first = first_flexure_end(trial) if settings.skip_first_flexure else 0
    if len(trial) - first < settings.window:
        raise FitError(f"{trial.source}: {len(trial) - first} samples count, expected {settings.window} of a window")
    return Windows(trial.command[None, first:], trial.angle[None, first:])


def _side_by_side(pieces: list[Windows], length: int) -> Windows:
    """All consecutive, non-overlapping windows."""
    rows = [[signal[0, a : a + length] for signal in (piece.commands, piece.angles)]
            for piece in pieces for a in range(0, piece.commands.size - length + 1, length)]  # fmt: skip
    commands, angles = (np.ascontiguousarray(np.stack(signals)) for signals in zip(*rows, strict=True))
    return Windows(commands, angles)


def _draw(pieces: list[Windows], settings: AdamSettings, rng: np.random.Generator) -> Windows:
    """Draw a batch: a random start in a random trial for each window, as in S2's code."""
    rows = []
    for k in rng.integers(len(pieces), size=settings.batch):
        piece = pieces[k]
        a = int(rng.integers(piece.commands.size - settings.window + 1))
        rows.append((piece.commands[0, a : a + settings.window], piece.angles[0, a : a + settings.window]))
    commands, angles = (np.ascontiguousarray(np.stack(signals)) for signals in zip(*rows, strict=True))
    return Windows(commands, angles)
