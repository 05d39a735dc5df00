"""The free run of a baseline with candidate effects, and its exact derivative by everything that a fit may move."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from hystmpc.trials.types import Vec

from ..chain import Chain
from ..effects.effect import CORE, Candidate
from .baseline import Baseline
from .free_run import StagedChain
from .runs import Run
from .trial_terms import NO_TERMS, TrialTerms


@final
class Problem:
    """Angles of a run as a function of scaled unknowns q = (baseline, effects).

    Positive parameters are searched by their logarithm, all others in units of a typical change, so that a step of
    one means the same everywhere.

    Args:
        baseline: the nominal chain and what retuning may change.
        effects: candidates that are added to it.
        terms: what each trial has of its own.
    """

    def __init__(self, baseline: Baseline, effects: Sequence[Candidate] = (), terms: TrialTerms = NO_TERMS) -> None:
        self.baseline, self.effects, self.terms = baseline, tuple(effects), terms
        nominal = baseline.chain
        before = sorted((c for c in self.effects if c.side == "command"), key=lambda c: c.order)
        after = sorted((c for c in self.effects if c.side == "output"), key=lambda c: c.order)
        leading = [(c, operator) for c in before for operator in c.operators]
        trailing = [(c, operator) for c in after for operator in c.operators]
        self.chain = Chain(
            nominal.core,
            (*(operator for _, operator in leading), *nominal.before),
            (*nominal.after, *(operator for _, operator in trailing)),
        )
        self._staged = StagedChain(self.chain)
        at, states = self._places()
        core = len(self.chain.before)
        self._core = slice(at[core], at[core + 1])
        first = core + 1 + len(nominal.after)
        owners = [*((c, k) for k, (c, _) in enumerate(leading)), *((c, first + k) for k, (c, _) in enumerate(trailing))]
        self._carried = [(c.carries, states[k]) for c, k in owners if c.carries]
        kept = {k for name, own in baseline.effects.items() if name not in self._in_core() for k in own.values()}
        self._active = [k for k in range(baseline.nominal.size) if k not in kept]
        self._z = len(self._active)
        self._freedoms = [
            (freedom, self._indices(freedom.name, [k for other, k in owners if other is c], at))
            for c in self.effects
            for freedom in c.free
        ]
        self.lower = self.scaled(np.array([*baseline.lower[self._active], *(f.lower for f, _ in self._freedoms)]))
        self.upper = self.scaled(np.array([*baseline.upper[self._active], *(f.upper for f, _ in self._freedoms)]))

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self._z + len(self._freedoms)

    def start(self, z: Vec, effects: Sequence[Sequence[float]]) -> Vec:
        """Unknowns from the baseline's freedom z (Z,) and each effect's free parameters."""
        return self.scaled(np.array([*z[self._active], *(v for values in effects for v in values)], dtype=np.float64))

    def scaled(self, values: Vec) -> Vec:
        """Unknowns q from values."""
        own = values[: self._z] / self.baseline.scale[self._active]
        effects = [
            v / f.scale if f.scale else np.log(v) for v, (f, _) in zip(values[self._z :], self._freedoms, strict=True)
        ]
        return np.array([*own, *effects])

    def plain(self, q: Vec) -> Vec:
        """Values from unknowns q."""
        own = q[: self._z] * self.baseline.scale[self._active]
        effects = [
            v * f.scale if f.scale else np.exp(v) for v, (f, _) in zip(q[self._z :], self._freedoms, strict=True)
        ]
        return np.array([*own, *effects])

    def retuned(self, q: Vec) -> Vec:
        """The baseline's freedom z (Z,) at unknowns q."""
        z = self.baseline.nominal.copy()
        z[self._active] = self.plain(q)[: self._z]
        return z

    def effect_values(self, q: Vec) -> list[dict[str, float]]:
        """Free parameters of each effect by name, in the order that `start` takes them."""
        values = self.plain(q)[self._z :].tolist()
        return [{freedom.name: values.pop(0) for freedom in c.free} for c in self.effects]

    def identified(self, q: Vec) -> dict[str, dict[str, float]]:
        """Parameters by effect and name, those of the core among them."""
        z = self.retuned(q)
        found = {c.effect: dict(values) for c, values in zip(self.effects, self.effect_values(q), strict=True)}
        for name in self._in_core():
            found[name] = {label: float(z[k]) for label, k in self.baseline.effects[name].items()}
        return found

    def fitted_chain(self, q: Vec) -> Chain:
        """The chain with its numbers."""
        return self.chain.with_values(self._values(q)[0].tolist())

    def angles(self, q: Vec, run: Run) -> Vec:
        """Angles (T,) of a free run [deg]."""
        p = self._values(q)[0]
        state = self._start(run, p)[0]
        return self._staged.simulate(run.command[:, None], run.dt_s, state[:, None], p)[0][:, 0] + run.correction

    def linearised(self, q: Vec, run: Run) -> tuple[Vec, Vec]:
        """Angles (T,) and their derivative (T, Q)."""
        p, slope = self._values(q)
        theta, by_p = self._staged.differentiate(run.command, run.dt_s, *self._start(run, p), p)
        return theta + run.correction, by_p @ slope

    def error(self, q: Vec, run: Run) -> tuple[Vec, Vec]:
        """Angle less measurement where it counts (C,) and its derivative (C, Q), a trial's own terms projected out."""
        theta, error, by_q = self._counted(q, run)
        return self.terms.projected(run, theta, error, by_q)

    def error_and_common(self, q: Vec, run: Run) -> tuple[tuple[Vec, Vec], tuple[Vec, Vec]]:
        """The error, and the trial's own offset and gain (2,) [deg] with their derivative (2, Q)."""
        theta, error, by_q = self._counted(q, run)
        return self.terms.projected(run, theta, error, by_q), self.terms.common(run, theta, error, by_q)

    def _counted(self, q: Vec, run: Run) -> tuple[Vec, Vec, Vec]:
        """Angle, error and derivative of the samples that count."""
        theta, by_q = self.linearised(q, run)
        return theta[run.counts], (theta - run.angle)[run.counts], by_q[run.counts]

    def held_out_error(self, q: Vec, run: Run) -> Vec:
        """Angle less measurement where it counts (C,); what belongs to the trial alone is estimated on other blocks."""
        theta, by_q = self.linearised(q, run)
        return self.terms.cross_fitted(run, theta[run.counts], (theta - run.angle)[run.counts], by_q[run.counts])

    def _values(self, q: Vec) -> tuple[Vec, Vec]:
        """Parameters (P,) of the chain and their derivative by the unknowns (P, Q)."""
        values = self.plain(q)
        p, slope = self.chain.values, np.zeros((len(self.chain.parameters), q.size))
        core, by_z = self.baseline.core_values(self.retuned(q))
        p[self._core], slope[self._core, : self._z] = core, (by_z * self.baseline.scale)[:, self._active]
        for k, (freedom, indices) in enumerate(self._freedoms, self._z):
            p[indices], slope[indices, k] = values[k], freedom.scale or values[k]
        return p, slope

    def _in_core(self) -> list[str]:
        """Effects that are a freedom of the core."""
        return [c.effect for c in self.effects if c.variant == CORE]

    def _indices(self, name: str, operators: Sequence[int], at: Sequence[int]) -> list[int]:
        """Positions of a parameter of that name among the chain's, of every operator that has it."""
        found = []
        for k in operators:
            names = [p.name for p in self.chain.operators[k].parameters]
            if name in names:
                found.append(at[k] + names.index(name))
        return found

    def _start(self, run: Run, p: Vec) -> tuple[Vec, Vec]:
        state, slope = self._staged.settled(run.rest_command, run.rest_angle, run.dt_s, p)
        for what, index in self._carried:
            state[index], slope[index] = (run.bent_before if what == "bend" else run.clock_s), 0.0
        return state, slope

    def _places(self) -> tuple[list[int], list[int]]:
        """First parameter and first state of each operator."""
        at, states = [0], [0]
        for operator in self.chain.operators:
            at.append(at[-1] + len(operator.parameters))
            states.append(states[-1] + len(operator.states))
        return at, states
