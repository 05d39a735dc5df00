"""Free runs of a chain: the one compiled engine with exact sensitivities, and its error over trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from hystmpc.trials.errors import ModelError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..chain import Chain
from ..kernels.chain_kernels import StageKernels, stage_kernels
from .runs import check_trial_set

_ROUNDS, _CLOSE, _FLAT, _WITHIN = 8, 1e-9, 1e-3, 1e-6


class _Held(NamedTuple):
    """One row held at a command, its core told to show an angle.

    Attributes:
        state, slope: (S,), and its derivative by the parameters and that angle (S, P + 1).
        shown, by_shown: angle that the chain shows one sample later [deg], and its derivative (P + 1,).
        core: angle that the core shows then [deg]; the one it was told where it can hold it.
    """

    state: Vec
    slope: Vec
    shown: float
    by_shown: Vec
    core: float


class _Led(NamedTuple):
    """One row held at a command, up to some operator.

    Attributes:
        state, slope: as of `_Held`, filled up to that operator.
        signal, by_signal: what it hands on one sample later, and its derivative (P + 1,).
    """

    state: Vec
    slope: Vec
    signal: float
    by_signal: Vec


@final
class StagedChain:
    """Compiled free runs of a chain, batched, with exact sensitivities to all parameters.

    A chain is a series connection, so its operators can pass over a whole trial one after another. Each is compiled
    once, alone: any number of them in any order needs no further compilation, which is what a search over structures
    lives on. Values equal the chain's `transition`, sample by sample, to rounding.

    Args:
        chain: its operators and their order; its values count only where a call is given none.
    """

    def __init__(self, chain: Chain) -> None:
        self.chain = chain
        self._stages: list[tuple[StageKernels, slice, slice]] = []
        states = parameters = 0
        for operator in chain.operators:
            s, p = len(operator.states), len(operator.parameters)
            self._stages.append((stage_kernels(operator), slice(states, states + s), slice(parameters, parameters + p)))
            states, parameters = states + s, parameters + p
        self.state_size, self.parameter_count = states, parameters
        self._core = len(chain.before)

    def rest(self, command: Vec, angle: Vec, values: Vec | None = None) -> Vec:
        """States (S, N) at rest at commands (N,) [cmd] where the device shows angles (N,) [deg].

        The rule is the chain's: up to the core the signal is the command, from the core on the angle.
        """
        p = self._rows(values, command.size)
        x = np.empty((self.state_size, command.size))
        for n in range(command.size):
            x[:, n] = self._rest_of(float(command[n]), float(angle[n]), p[:, n], None)
        return x

    def simulate(self, commands: Vec, dt_s: float, states: Vec, values: Vec | None = None) -> tuple[Vec, Vec]:
        """Run N rows freely.

        Args:
            commands: (T, N), time first [cmd].
            dt_s: sample time [s].
            states: (S, N) before the first sample.
            values: parameters (P,) of all rows or (P, N) of each; the chain's where left out.

        Returns:
            Angles (T, N) [deg] and states (S, N) after the last sample.

        Raises:
            ModelError: if a shape does not fit.
        """
        self._check(commands, states)
        p, x = self._rows(values, commands.shape[1]), np.array(states, dtype=np.float64, order="C")
        signal = np.ascontiguousarray(commands, dtype=np.float64)
        for kernels, state, parameters in self._stages:
            kept = np.empty((kernels.kept[0], signal.shape[1]))
            kernels.prepare(p[parameters], dt_s, kernels.constants[0], kept)
            following = np.empty_like(signal)
            kernels.simulate(x[state], signal, kept, following)
            signal = following
        return signal, x

    def rest_with_slope(self, command: float, angle: float, values: Vec | None = None) -> tuple[Vec, Vec]:
        """State (S,) of one row at rest, see `rest`, and its derivative by the parameters (S, P)."""
        slope = np.zeros((self.state_size, self.parameter_count))
        return self._rest_of(command, angle, self._rows(values, 1)[:, 0], slope), slope

    def settled(self, command: float, angle: float, dt_s: float, values: Vec | None = None) -> tuple[Vec, Vec]:
        """State (S,) of one row that was held at a command and shows an angle, and its derivative (S, P).

        Unlike `rest`, every operator starts at what the one before it really hands on, and the core at the angle for
        which the whole chain shows the one that was seen: a creep, a stop or a curve behind the core is no offset.
        Newton's method on the core's angle a; dx/dp = dx/dp|_a - dx/da (dy/dp|_a) / (dy/da) by the implicit function
        theorem. Where that is beyond what the core can hold at the command, the search goes on from the edge of what it
        can; and where it cannot show the angle at all it shows the nearest that it can.

        Args:
            command: held [cmd].
            angle: seen [deg].
            dt_s: sample time [s].
            values: parameters (P,); the chain's where left out.
        """
        p, at = self._rows(values, 1), angle
        before = self._before_core(command, dt_s, p)
        held, side = self._held(before, at, dt_s, p), 0.0
        beyond: _Held | None = None
        for _ in range(_ROUNDS):
            if abs(angle - held.shown) < _CLOSE:
                break
            if abs(held.by_shown[-1]) < _FLAT:  # beyond what the core can hold: go on from the edge, a little within
                past, side, beyond = side, float(np.sign(angle - held.shown)), beyond or held
                at = held.core + side * _WITHIN
                held = self._held(before, at, dt_s, p)
                if side == past or abs(held.by_shown[-1]) < _FLAT:  # nothing within leads any further
                    held = beyond
                    break
            at += (angle - held.shown) / float(held.by_shown[-1])
            held = self._held(before, at, dt_s, p)
        x, slope, by = held.state, held.slope, held.by_shown
        follows = slope[:, :-1]
        if abs(by[-1]) >= _FLAT:
            follows = follows - slope[:, -1:] * (by[:-1] / by[-1])[None]
        return x, np.ascontiguousarray(follows, dtype=np.float64)

    def _before_core(self, command: float, dt_s: float, p: Vec) -> _Led:
        """What stands before the core, held at a command."""
        count = self.parameter_count + 1
        led = _Led(np.empty(self.state_size), np.zeros((self.state_size, count)), command, np.zeros(count))
        for k in range(self._core):
            led = self._next_held(k, led, (led.signal, led.by_signal), dt_s, p)
        return led

    def _held(self, before: _Led, core_angle: float, dt_s: float, p: Vec) -> _Held:
        """The whole row; what stands before the core does not depend on the core's angle, and is found once."""
        led = _Led(before.state.copy(), before.slope.copy(), before.signal, before.by_signal)
        told = np.zeros(self.parameter_count + 1)
        told[-1] = 1.0
        led = self._next_held(self._core, led, (core_angle, told), dt_s, p)
        core = led.signal
        for k in range(self._core + 1, len(self._stages)):
            led = self._next_held(k, led, (led.signal, led.by_signal), dt_s, p)
        return _Held(led.state, led.slope, led.signal, led.by_signal, core)

    def _next_held(self, k: int, led: _Led, seen: tuple[float, Vec], dt_s: float, p: Vec) -> _Led:
        """One operator further; it fills its own states, and starts at rest at what it sees (value and derivative)."""
        kernels, states, parameters = self._stages[k]
        x, slope, moving = led.state, led.slope, led.by_signal[None]
        own, by_input, by_output = _stage_at_rest(kernels, led.signal, seen[0], p[parameters, 0], x[states])
        slope[states] = by_input[:, None] * moving + by_output[:, None] * seen[1]
        slope[states, parameters] += own
        kept = np.empty((kernels.kept[1], 1))
        kernels.prepare_slopes(p[parameters], dt_s, kernels.constants[1], kept)
        following, moved = np.empty(1), np.zeros_like(moving)
        kernels.differentiate(
            x[states].copy(),
            slope[states].copy(),
            np.array([led.signal]),
            moving,
            kept,
            parameters.start,
            moving.shape[1],
            following,
            moved,
        )
        return _Led(x, slope, float(following[0]), moved[0])

    def differentiate(
        self, commands: Vec, dt_s: float, state: Vec, slope: Vec, values: Vec | None = None
    ) -> tuple[Vec, Vec]:
        """One row's free run, and its derivative by every parameter.

        Args:
            commands: (T,) [cmd].
            dt_s: sample time [s].
            state, slope: before the first sample (S,), and its derivative by the parameters (S, P).
            values: parameters (P,); the chain's where left out.

        Returns:
            Angles (T,) [deg] and their derivatives (T, P).
        """
        p, x, m = self._rows(values, 1), state.copy(), slope.copy()
        signal = np.ascontiguousarray(commands, dtype=np.float64)
        moving = np.zeros((commands.size, self.parameter_count))
        ahead = False  # whether a state so far depends on parameters of later operators, as the settled ones do
        for kernels, states, parameters in self._stages:
            ahead = ahead or bool(m[states, parameters.stop :].any())
            reach = self.parameter_count if ahead else parameters.stop
            kept = np.empty((kernels.kept[1], 1))
            kernels.prepare_slopes(p[parameters], dt_s, kernels.constants[1], kept)
            following, moved = np.empty_like(signal), np.zeros_like(moving)
            kernels.differentiate(x[states], m[states], signal, moving, kept, parameters.start, reach, following, moved)
            signal, moving = following, moved
        return signal, moving

    def _rest_of(self, command: float, angle: float, p: Vec, slope: Vec | None) -> Vec:
        """State (S,) of one row at rest; `slope` (S, P) receives its derivative."""
        x = np.empty(self.state_size)
        for k, (kernels, state, parameters) in enumerate(self._stages):
            seen_in, seen_out = (command if k <= self._core else angle), (command if k < self._core else angle)
            own, _, _ = _stage_at_rest(kernels, seen_in, seen_out, p[parameters], x[state])
            if slope is not None:
                slope[state, parameters] = own
        return x

    def _rows(self, values: Vec | None, rows: int) -> Vec:
        """Parameters (P, N)."""
        p = self.chain.values if values is None else np.asarray(values, dtype=np.float64)
        if p.shape not in ((self.parameter_count,), (self.parameter_count, rows)):
            raise ModelError(
                f"got parameters of shape {p.shape}, expected ({self.parameter_count},) or "
                f"({self.parameter_count}, {rows})"
            )
        return np.ascontiguousarray(np.broadcast_to(p[:, None] if p.ndim == 1 else p, (self.parameter_count, rows)))

    def _check(self, commands: Vec, states: Vec) -> None:
        if commands.ndim != 2 or states.shape != (self.state_size, commands.shape[1]):
            raise ModelError(
                f"got commands of shape {commands.shape} and states of shape {states.shape}, expected (T, N) and "
                f"({self.state_size}, N)"
            )


def _stage_at_rest(kernels: StageKernels, u: float, seen: float, p: Vec, x: Vec) -> tuple[Vec, Vec, Vec]:
    """Fill one operator's state (S,) at rest; its derivatives by own parameters (S, P), input (S,) and output (S,)."""
    own, by_u, by_seen = np.zeros((x.size, p.size)), np.zeros(x.size), np.zeros(x.size)
    kernels.rest(u, seen, np.ascontiguousarray(p), kernels.constants[2], x, own, by_u, by_seen)
    return own, by_u, by_seen


@dataclass(frozen=True, eq=False)
class ScoredRun:
    """One trial as a fit runs it.

    Attributes:
        commands: the trial's commands behind the chain's warm-up, in which the first is held (W + T,).
        angle: what was measured (T,).
        warmup: samples W.
        start: first sample of the trial that counts.
    """

    commands: Vec
    angle: Vec
    warmup: int
    start: int


@final
class FreeRuns:
    """Free runs of a chain over trials, and their error; every trial has the same weight.

    A run starts at rest (`StagedChain.rest`) at the first command and angle, and is compared after the chain's warm-up.

    Args:
        chain: its structure; parameters are given with each call.
        trials: uniformly sampled at one rate, in one pair of units.
        skip_first_flexure: score each trial from the first reversal of its command on.
        offset_free: take the mean off the error of each trial.

    Raises:
        FitError: on unusable trials, see `check_trial_set`.
    """

    def __init__(
        self, chain: Chain, trials: Sequence[Trial], skip_first_flexure: bool = False, offset_free: bool = False
    ) -> None:
        self._dt, self._staged, self._offset_free = check_trial_set(trials), StagedChain(chain), offset_free
        warmup = chain.settling_samples
        self.runs = [
            ScoredRun(
                np.concatenate([np.full(warmup, trial.command[0]), trial.command]),
                trial.angle,
                warmup,
                first_flexure_end(trial) if skip_first_flexure else 0,
            )
            for trial in trials
        ]

    def angles(self, p: Vec) -> list[Vec]:
        """Outputs (W + T,) of each run at parameters p (P,)."""
        found = []
        for run in self.runs:
            state = self._staged.rest(run.commands[:1], run.angle[:1], p)
            found.append(self._staged.simulate(run.commands[:, None], self._dt, state, p)[0][:, 0])
        return found

    def mse(self, p: Vec) -> float:
        """Mean over trials of the mean square error at parameters p (P,); infinite where a run is not finite."""
        errors = [self._error(run, theta) for run, theta in zip(self.runs, self.angles(p), strict=True)]
        loss = sum(float(error @ error) / error.size for error in errors) / len(self.runs)
        return loss if np.isfinite(loss) else np.inf

    def residuals(self, p: Vec) -> tuple[Vec, Vec]:
        """Residuals (R,) at parameters p (P,) and their Jacobian (R, P), initial states' dependence on p included.

        r = (theta(p) - measured) / sqrt(T_trial n_trials), so that sum r^2 is the mean square error of `mse`.
        """
        residuals, jacobians = [], []
        for run in self.runs:
            start = self._staged.rest_with_slope(float(run.commands[0]), float(run.angle[0]), p)
            theta, gradient = self._staged.differentiate(run.commands, self._dt, *start, p)
            error = self._error(run, theta)
            by_p = gradient[-error.size :]
            if self._offset_free:
                by_p = by_p - by_p.mean(axis=0)
            scale = 1 / np.sqrt(error.size * len(self.runs))
            residuals.append(error * scale)
            jacobians.append(by_p * scale)
        return np.concatenate(residuals), np.vstack(jacobians)

    def _error(self, run: ScoredRun, theta: Vec) -> Vec:
        """Model less measurement over the samples that count, from theta (W + T,)."""
        error = theta[run.warmup + run.start :] - run.angle[run.start :]
        return error - error.mean() if self._offset_free else error
