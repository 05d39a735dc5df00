"""Free runs of a chain: compiled simulation with exact sensitivities, its states at rest, and its error over trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import final

import numpy as np

from hystmpc.core.chain import ChainCode
from hystmpc.trials.errors import ModelError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Index, Vec

from ..chain import Chain
from ..operators.dynamics import Delay
from ..scheduled import Scheduled
from ..stages import chain_code, driven_code
from ..start import Runs, search_box
from .runs import RunsTogether, angle_range, check_trial_set, command_range, runs_to_fit

_ROUNDING = 1e-6  # share of a store, for a delay that fills it except for rounding

Inputs = Mapping[str, Vec]
"""Measured inputs by name."""
NO_INPUTS: Inputs = MappingProxyType({})


@final
class StagedChain:
    """Free runs of a chain in the engine, batched, with exact sensitivities to all parameters.

    Values equal the chain's `transition` to rounding. Measured inputs of the chain are given by name, with the shape of
    the commands; further names are ignored. Without any, each input keeps the value in the state.

    Args:
        chain: its operators and their order; its values are used only where a call gives none.
    """

    def __init__(self, chain: Chain) -> None:
        self.chain = chain
        self._stages: list[tuple[slice, slice]] = []  # where states and parameters of each operator stand
        states = parameters = 0
        for operator in chain.operators:
            s, p = len(operator.states), len(operator.parameters)
            self._stages.append((slice(states, states + s), slice(parameters, parameters + p)))
            states, parameters = states + s, parameters + p
        self._code = chain_code(chain.operators)
        self.state_size, self.parameter_count = states, parameters
        places = zip(chain.operators, self._stages, strict=True)
        self._stores = [
            (columns.start, operator.samples) for operator, (_, columns) in places if isinstance(operator, Delay)
        ]
        self._core = len(chain.before)
        self._inputs = tuple(given.name for given in chain.inputs)
        self._driven = driven_code(chain.operators) if self._inputs else self._code
        self._held = [  # inputs by number, and the parameters that are their values at rest
            (self._inputs.index(given.name), columns.stop - len(operator.inputs) + k)
            for operator, (_, columns) in zip(chain.operators, self._stages, strict=True)
            if isinstance(operator, Scheduled)
            for k, given in enumerate(operator.inputs)
        ]

    def rest(self, command: Vec, angle: Vec, values: Vec | None = None) -> Vec:
        """States (S, N) at rest at commands (N,) [cmd] with output angles (N,) [deg], by the rule of `Chain.rest`.

        Args:
            values: parameters (P,) of all rows or (P, N) of each; the chain's where left out.
        """
        return self.rest_with_slope(command, angle, values, np.empty((self.parameter_count, 0)))[0]

    def rest_with_slope(
        self, command: Vec, angle: Vec, values: Vec | None = None, seeds: Vec | None = None
    ) -> tuple[Vec, Vec]:
        """States (S, N) at rest, see `rest`, and their derivatives (S, N, D) in the directions of `differentiate`."""
        p, seeds = self._rows(values, command.size), self._seeds(seeds)
        x = np.empty((self.state_size, command.size))
        m = np.empty((*x.shape, seeds.shape[1]))
        signals = [np.ascontiguousarray(signal, dtype=np.float64) for signal in (command, angle)]
        still = np.zeros((command.size, seeds.shape[1]))
        for k, (state, columns) in enumerate(self._stages):
            u, seen = signals[k > self._core], signals[k >= self._core]
            self._code.rest(k, u, still, seen, still, p[columns], seeds[columns], x[state], m[state])
        return x, m

    def simulate(
        self, commands: Vec, dt_s: float, states: Vec, values: Vec | None = None, inputs: Inputs = NO_INPUTS
    ) -> tuple[Vec, Vec]:
        """Simulate N rows freely.

        Args:
            commands: (T, N), time first [cmd].
            states: (S, N) before the first sample.
            values: parameters (P,) of all rows or (P, N) of each; the chain's where left out.

        Returns:
            Angles (T, N) [deg] and states (S, N) after the last sample.

        Raises:
            ModelError: if a shape does not fit, or a delay is longer than its store at that sample time.
        """
        self._check(commands, states)
        p, x = self._rows(values, commands.shape[1]), np.array(states, dtype=np.float64, order="C")
        self._require_room(p, dt_s)
        one = values is None or np.ndim(values) == 1
        signals, code = self._signals(commands, inputs)
        return code.simulate(code.prepare(np.ascontiguousarray(p[:, :1]) if one else p, dt_s), x, signals), x

    def _signals(self, commands: Vec, inputs: Inputs) -> tuple[Vec, ChainCode]:
        """Signals of the engine, (inputs, ...) where there are several, and the code that reads them."""
        u = np.ascontiguousarray(commands, dtype=np.float64)
        if not self._inputs or not inputs:
            return u, self._code
        if gone := [name for name in self._inputs if name not in inputs]:
            raise ModelError(f"input {gone[0]}: not among those of the trials ({', '.join(inputs)}), expected in each")
        return np.stack([u, *(np.broadcast_to(inputs[name], u.shape) for name in self._inputs)]), self._driven

    def settled(
        self,
        command: Vec,
        angle: Vec,
        dt_s: float,
        values: Vec | None = None,
        seeds: Vec | None = None,
        inputs: Inputs = NO_INPUTS,
    ) -> tuple[Vec, Vec]:
        """States (S, N) at rest under constant commands with given output angles, and their derivatives (S, N, D).

        Unlike `rest`, every operator starts at the output of the one before it, and the core at the angle for which the
        whole chain shows the measured one: a creep, a stop or a curve behind the core is no offset. Newton's method on
        the core's angle a; dx/dp = dx/dp|_a - dx/da (dy/dp|_a) / (dy/da) by the implicit function
        theorem.

        Args:
            command: constant (N,) [cmd].
            angle: measured (N,) [deg].
            values: parameters (P,); the chain's where left out.
            inputs: constant (N,) each.
        """
        p, seeds = self._rows(values, 1), self._seeds(seeds)
        self._require_room(p, dt_s)
        u, y = (np.ascontiguousarray(rest, dtype=np.float64) for rest in (command, angle))
        if not self._held or not inputs:
            return self._code.settle(self._code.prepare(p, dt_s), self._core, u, y, p, seeds)
        x, m = np.empty((self.state_size, u.size)), np.empty((self.state_size, u.size, seeds.shape[1]))
        levels, owner = np.unique(self._signals(u, inputs)[0][1:], axis=1, return_inverse=True)
        for k, level in enumerate(levels.T):
            rows, at = owner.ravel() == k, p.copy()
            for j, place in self._held:
                at[place] = level[j]
            x[:, rows], m[:, rows] = self._code.settle(
                self._code.prepare(at, dt_s), self._core, u[rows], y[rows], at, seeds
            )
        return x, m

    def rollouts(self, dt_s: float, values: Vec, inputs: Inputs = NO_INPUTS, lead: int = 0) -> Runs:
        """Free runs of the chain with parameters (P,), for `estimated_start`.

        Args:
            inputs: of the trial (T,); before it they have their first values.
            lead: samples of the trial at the end of each run.
        """

        def run(commands: Vec, angles: Vec, plans: Vec) -> Vec:
            first = {name: np.full(commands.size, z[0]) for name, z in inputs.items()}
            states = self.settled(commands, angles, dt_s, values, np.empty((self.parameter_count, 0)), first)[0]
            if held := self.chain.rest_samples:
                states = self.simulate(np.tile(commands, (held, 1)), dt_s, states, values, first)[1]
            early = plans.shape[1] - lead
            along = {name: np.r_[np.full(early, z[0]), z[:lead]][:, None] for name, z in inputs.items()}
            return self.simulate(plans.T, dt_s, states, values, along)[0].T

        return run

    def differentiate(
        self,
        commands: Vec,
        dt_s: float,
        state: Vec,
        slope: Vec,
        values: Vec | None = None,
        seeds: Vec | None = None,
        first: Index | None = None,
        inputs: Inputs = NO_INPUTS,
    ) -> tuple[Vec, Vec]:
        """Simulate N concatenated free runs with derivatives in D directions.

        Args:
            commands: of all runs (T,) [cmd].
            state, slope: before the first sample of each run (S, N), and its derivative (S, N, D).
            values: parameters (P,); the chain's where left out.
            seeds: derivative of the parameters in each direction (P, D); of every parameter alone where left out.
            first: first sample of each run, and T (N + 1,); one run where left out.

        Returns:
            Angles (T,) [deg] and their derivatives (T, D).
        """
        seeds, first = self._seeds(seeds), np.array([0, commands.size]) if first is None else first
        p = self._rows(values, 1)
        self._require_room(p, dt_s)
        x, m = (np.ascontiguousarray(part, dtype=np.float64) for part in (state, slope))
        u, code = self._signals(commands, inputs)
        return code.differentiate(code.prepare(p, dt_s), np.asarray(first, dtype=np.intc), u, None, seeds, x, m)

    def _seeds(self, seeds: Vec | None) -> Vec:
        return np.eye(self.parameter_count) if seeds is None else np.ascontiguousarray(seeds, dtype=np.float64)

    def _rows(self, values: Vec | None, rows: int) -> Vec:
        p = self.chain.values if values is None else np.asarray(values, dtype=np.float64)
        if p.shape not in ((self.parameter_count,), (self.parameter_count, rows)):
            raise ModelError(
                f"got parameters of shape {p.shape}, expected ({self.parameter_count},) or "
                f"({self.parameter_count}, {rows})"
            )
        if p.ndim == 1:
            p = p[:, None] if rows == 1 else np.repeat(p[:, None], rows, axis=1)
        return np.ascontiguousarray(p)

    def _require_room(self, p: Vec, dt_s: float) -> None:
        """Refuse a delay (P, N) that is longer than its store: all its weights would vanish."""
        for k, samples in self._stores:
            if (longest := float(np.max(p[k]))) > samples * dt_s * (1 + _ROUNDING):
                raise ModelError(
                    f"delay: {longest:.6g} s at a sample time of {dt_s:.6g} s, expected at most {samples * dt_s:.6g} s "
                    f"from its store of {samples} samples; bring the simulator to that sample time (`at_sample_time`)"
                )

    def _check(self, commands: Vec, states: Vec) -> None:
        if commands.ndim != 2 or states.shape != (self.state_size, commands.shape[1]):
            raise ModelError(
                f"got commands of shape {commands.shape} and states of shape {states.shape}, expected (T, N) and "
                f"({self.state_size}, N)"
            )


@final
class FreeRuns:
    """Free runs of a chain over trials, and their error; every trial has the same weight.

    A run starts at rest (`StagedChain.settled`) where its trial does (`models.start`), after the chain's warm-up. The
    start of a trial in motion is estimated by `estimate_starts` from samples that are not scored.

    Args:
        chain: its structure; parameters are given with each call.
        trials: uniformly sampled at one rate, in one pair of units.
        skip_first_flexure: score each trial from the first reversal of its command on.
        lead_s: start of each trial that is not scored [s].

    Raises:
        FitError: on unusable trials, see `check_trial_set`.
    """

    def __init__(
        self,
        chain: Chain,
        trials: Sequence[Trial],
        skip_first_flexure: bool = False,
        lead_s: float = 0.0,
    ) -> None:
        dt_s, self._staged = check_trial_set(trials), StagedChain(chain)
        self._box = search_box(command_range(trials), angle_range(trials))
        self.runs = [
            replace(run, dt_s=dt_s, approach=(run.rest_command,) * chain.rest_samples)
            for run in runs_to_fit(trials, skip_first_flexure, lead_s)
        ]

    @property
    def in_motion(self) -> bool:
        """Whether a trial begins in motion."""
        return any(run.lead for run in self.runs)

    def estimate_starts(self, p: Vec) -> None:
        """Estimate the start of each run that begins in motion, with parameters p (P,)."""
        rollouts, held = self._staged.rollouts(self.runs[0].dt_s, p), self._staged.chain.rest_samples
        self.runs = [run.begun(rollouts, self._box, held) if run.lead else run for run in self.runs]

    def angles(self, p: Vec) -> list[Vec]:
        """Outputs (T,) of each run at parameters p (P,)."""
        angles = []
        for run in self.runs:
            rest = np.array([[run.rest_command], [run.rest_angle]])
            state = self._staged.settled(rest[0], rest[1], run.dt_s, p)[0]
            commands = np.concatenate([run.approach, run.command])
            angles.append(self._staged.simulate(commands[:, None], run.dt_s, state, p)[0][len(run.approach) :, 0])
        return angles

    def mse(self, p: Vec) -> float:
        """Mean over trials of the mean square error at parameters p (P,); infinite where a run is not finite."""
        runs = zip(self.runs, self.angles(p), strict=True)
        errors = [(theta - run.angle)[run.scored] for run, theta in runs]
        loss = sum(float(error @ error) / error.size for error in errors) / len(self.runs)
        return loss if np.isfinite(loss) else np.inf

    def residuals(self, p: Vec) -> tuple[Vec, Vec]:
        """Residuals (R,) at parameters p (P,) and their Jacobian (R, P), initial states' dependence on p included.

        r = (theta(p) - measured) / sqrt(T_trial n_trials), so that sum r^2 is the mean square error of `mse`.
        """
        together, residuals, jacobians = RunsTogether.of(self.runs), [], []
        start = self._staged.settled(*together.rests, together.dt_s, p)
        thetas, gradients = self._staged.differentiate(together.command, together.dt_s, *start, p, first=together.first)
        thetas, gradients = thetas[together.recorded], gradients[together.recorded]
        for run, at in together.each():
            error = (thetas[at] - run.angle)[run.scored]
            scale = 1 / np.sqrt(error.size * len(self.runs))
            residuals.append(error * scale)
            jacobians.append(gradients[at][run.scored] * scale)
        return np.concatenate(residuals), np.vstack(jacobians)
