"""Iterated least squares for the backlash with four parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hystmpc.models.identify.chain_fit import ChainFit, ChainTask, Tracker
from hystmpc.models.identify.free_run import FreeRuns
from hystmpc.models.identify.runs import Run, check_trial_set
from hystmpc.models.model import FitProgress
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec


@dataclass(frozen=True)
class IteratedSettings:
    """Settings of iterated least squares.

    Attributes:
        iterations: regressions; 20 in the code of S2.
        start: m_lo, m_up, c_lo, -c_up to begin with, for command and angle that are each centred in their range and
            taken over half of it: two lines of slope one a little either side of the middle.
        memory: where y_{k-1} of the switching comes from: the model's own free run, or the measurement as in Voros'
            equation. Noise of the measurement then sorts the samples, and both lines move away from the loop's middle.
        skip_first_flexure: regress and score each trial from the first reversal of its command on.

    Raises:
        FitError: if there is no iteration, or a slope is not positive.
    """

    iterations: int = 20
    start: tuple[float, float, float, float] = (1.0, 1.0, 0.01, 0.01)
    memory: Literal["model", "measured"] = "model"
    skip_first_flexure: bool = False

    def __post_init__(self) -> None:
        if self.iterations < 1 or min(self.start[:2]) <= 0:
            raise FitError(f"got {self}, expected at least one iteration from positive slopes")


@dataclass(frozen=True, eq=False)
class Samples:
    """Normalised command, angle, and angle one sample before, of all counted samples (N,)."""

    u: Vec
    y: Vec
    last: Vec


@dataclass(frozen=True)
class Frame:
    """Middle and half range of command and angle."""

    u: float
    u_scale: float
    y: float
    y_scale: float

    def to_units(self, lines: Vec) -> Vec:
        """Lines (m_lo, m_up, c_lo, c_up) of normalised signals, converted to deg/cmd and cmd."""
        slopes = lines[:2] * self.y_scale / self.u_scale
        return np.concatenate([slopes, self.y / slopes - self.u + lines[2:] * self.u_scale])


def fit_by_iteration(task: ChainTask, settings: IteratedSettings, progress: FitProgress | None = None) -> ChainFit:
    """Alternate between assigning samples to lines and regressing the lines from their samples.

    f1 = [u_k <= y_{k-1} / m_lo - c_lo],  f2 = [u_k >= y_{k-1} / m_up - c_up]
    y_k = m_lo (u_k + c_lo) f1 + m_up (u_k + c_up) f2 + y_{k-1} (1 - f1) (1 - f2)

    is linear in m_lo, m_lo c_lo, m_up, m_up c_up while f1 and f2 are given. A line without two different commands
    keeps its numbers. The iterate with the least error of its free runs is kept.

    Raises:
        FitError: on unusable trials, another chain than a backlash, or if no iterate is a usable backlash.

    Source: Voros, Automatica 46 (2010), and the code of S2 for number of iterations, start and centred signals.
    """
    check_trial_set(task.trials)
    template = task.starts[0]
    if not isinstance(template.core, Backlash) or len(template.operators) > 1:
        raise FitError(f"iterated least squares fits a backlash alone, got {', '.join(template.labels)}")
    frame = _frame(task.trials)
    loss = FreeRuns(template, task.trials, settings.skip_first_flexure)
    tracker = Tracker(loss.mse, task.free, progress)
    lines, interrupted = np.array(settings.start) * [1, 1, 1, -1], False
    try:
        for _ in range(settings.iterations):
            own = loss.angles(frame.to_units(lines)) if settings.memory == "model" else None
            lines = _regressed(lines, _samples(loss.runs, frame, own))
            if min(lines[:2]) > 0:
                tracker(frame.to_units(lines))
            tracker.iteration()
    except KeyboardInterrupt:
        interrupted = True
    chain = tracker.chain(template, interrupted)
    report = tracker.report("iterated", settings.iterations)
    return ChainFit(chain, float(np.sqrt(tracker.best_loss)), tracker.evaluations, report, interrupted)


def _frame(trials: tuple[Trial, ...]) -> Frame:
    ends = [
        (min(getattr(t, name).min() for t in trials), max(getattr(t, name).max() for t in trials))
        for name in ("command", "angle")
    ]
    (u0, u1), (y0, y1) = ends
    return Frame(0.5 * (u0 + u1), 0.5 * (u1 - u0), 0.5 * (y0 + y1), 0.5 * (y1 - y0))


def _samples(runs: Sequence[Run], frame: Frame, own: Sequence[Vec] | None) -> Samples:
    """Normalised counted samples; `own` has the free runs that give the previous angle."""
    parts = []
    for k, run in enumerate(runs):
        last = run.angle if own is None else own[k]
        u = (run.command[run.scored] - frame.u) / frame.u_scale
        y, last = ((signal[run.scored] - frame.y) / frame.y_scale for signal in (run.angle, last))
        parts.append((u[1:], y[1:], last[:-1]))
    return Samples(*(np.concatenate(signals) for signals in zip(*parts, strict=True)))


def _regressed(lines: Vec, s: Samples) -> Vec:
    """Next m_lo, m_up, c_lo, c_up; a sample on both lines belongs to the unloading one, as in the model."""
    m_lo, m_up, c_lo, c_up = lines
    on_lower = s.u <= s.last / m_lo - c_lo
    on_upper = (s.u >= s.last / m_up - c_up) & ~on_lower
    found = lines.copy()
    for k, on in enumerate((on_lower, on_upper)):
        if np.any(on) and np.ptp(s.u[on]) > 1e-6:
            slope, height = np.polyfit(s.u[on], s.y[on], 1)
            if abs(slope) > 1e-9:
                found[k], found[k + 2] = slope, height / slope
    return found
