"""Identification problem: free runs of a baseline with candidate effects, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from hystmpc.trials.types import Vec

from ..chain import Chain, with_dependences
from ..effects.effect import CORE, Candidate
from ..start import Box
from .baseline import Baseline
from .free_run import StagedChain
from .runs import AS_IT_IS, Run, RunsTogether, whitened

_BLOCK_S = 4.0
_RIDGE = 1e-9
_FAINT = 1e-4  # working units: the influence of a start is neglected below it
_STARTS, _NUDGE = 2, 1e-4  # number of unknowns of a start, and their step for differences


@final
@dataclass(frozen=True)
class TrialTerms:
    """Linear terms with separate coefficients for each trial.

    Attributes:
        shift: offset, gain and width of the trial, to first order: columns 1, theta and d theta / d width.
        trial_offset: an offset alone; no effect, as sensors are zeroed anew for a trial.
        frequency_hz: of a disturbance with a separate phase in each trial; 0 for none.
        harmonics: of that disturbance.
        width: position of the baseline's width among the unknowns, -1 for none.
    """

    shift: bool = False
    trial_offset: bool = False
    frequency_hz: float = 0.0
    harmonics: int = 2
    width: int = -1

    @property
    def names(self) -> tuple[str, ...]:
        """Effects that the terms represent."""
        return (*(("trial_shift",) if self.shift else ()), *(("periodic_disturbance",) if self.frequency_hz else ()))

    def columns(self, run: Run, theta: Vec, by_q: Vec) -> Vec:
        """Columns (C, K) of the terms at the samples that count."""
        made: list[Vec] = [np.ones(theta.size)] if self.trial_offset else []
        if self.shift:
            made += [np.ones(theta.size), theta - theta.mean()]
            if self.width >= 0 and np.ptp(by_q[:, self.width]) > 0:
                made.append(by_q[:, self.width])
        if self.frequency_hz:
            turns = 2 * np.pi * self.frequency_hz * run.dt_s * np.flatnonzero(run.counts)
            made += [wave(h * turns) for h in range(1, self.harmonics + 1) for wave in (np.sin, np.cos)]
        return np.stack(made, axis=1) if made else np.empty((theta.size, 0))

    def amplitude(self, run: Run, theta: Vec, by_q: Vec) -> float:
        """Amplitude of the first harmonic of the disturbance in a run [deg]."""
        weights = self._weights(run, theta, by_q)
        first = weights[-2 * self.harmonics :][:2]
        return float(np.hypot(first[0], first[1]))

    def offset(self, run: Run, theta: Vec, by_q: Vec) -> float:
        """Mean of the shift of a run [deg]."""
        return float(-self._weights(run, theta, by_q)[0])

    def _weights(self, run: Run, theta: Vec, by_q: Vec) -> Vec:
        """Coefficients (K,) of the terms by least squares on a run's error."""
        columns = self.columns(run, theta[run.counts], by_q[run.counts])
        return np.asarray(np.linalg.lstsq(columns, (theta - run.angle)[run.counts], rcond=None)[0], dtype=np.float64)

    @property
    def apart(self) -> bool:
        """Whether a trial has a separate offset, see `common`."""
        return self.shift or self.trial_offset

    def common(self, run: Run, theta: Vec, both: Vec) -> Vec:
        """Offset and, if fitted, gain times the spread of theta [deg] (1 or 2, Q + 1), the derivative first."""
        columns = self.columns(run, theta, both)
        scale = np.array([1.0, max(float(theta.std()), 1e-9)] if self.shift else [1.0])[:, None]
        return np.asarray(scale * np.linalg.pinv(columns)[: len(scale)] @ both)

    def projected(self, run: Run, theta: Vec, both: Vec) -> Vec:
        """Derivative and, in the last column, error (C, Q + 1), without the part explained by the terms."""
        columns = self.columns(run, theta, both)
        if not columns.shape[1]:
            return both
        basis = np.linalg.qr(columns)[0]
        return both - basis @ (basis.T @ both)

    def cross_fitted(self, run: Run, theta: Vec, error: Vec, by_q: Vec) -> Vec:
        """Error (C,) minus the terms, whose coefficients come from every other block of four seconds."""
        columns = self.columns(run, theta, by_q)
        if not columns.shape[1]:
            return error
        odd = run.blocks(_BLOCK_S) % 2 == 1
        left = error.copy()
        for chosen in (odd, ~odd):
            seen = ~chosen if (~chosen).any() else chosen
            square = columns[seen].T @ columns[seen]
            square += _RIDGE * np.trace(square) * np.eye(square.shape[0])
            left[chosen] -= columns[chosen] @ np.linalg.solve(square, columns[seen].T @ error[seen])
        return left


NO_TERMS = TrialTerms()


def _from_lead(both: Vec, lead: int) -> Vec:
    """Subtract the effect of the estimated start from derivatives and error in place; return that of the angle."""
    starts, rest = both[:, :_STARTS], both[:, _STARTS:]
    known = np.max(np.abs(starts[:lead]), axis=0) > _FAINT
    if not known.any():
        return np.zeros(both.shape[0])
    columns = starts[:, known]
    square = columns[:lead].T @ columns[:lead]
    square += _RIDGE * np.trace(square) * np.eye(square.shape[0])
    shares = np.linalg.solve(square, columns[:lead].T @ rest[:lead])
    rest -= columns @ shares
    return np.asarray(columns @ shares[:, -1])


@final
class Problem:
    """Angles of a run as a function of scaled unknowns q = (baseline, effects).

    Positive parameters are scaled by their logarithm, all others in units of a typical change, so that steps of one are
    comparable.
    """

    def __init__(self, baseline: Baseline, effects: Sequence[Candidate] = (), terms: TrialTerms = NO_TERMS) -> None:
        self.baseline, self.effects, self.terms = baseline, tuple(effects), terms
        nominal = baseline.chain
        before = sorted((c for c in self.effects if c.side == "command"), key=lambda c: c.order)
        after = sorted((c for c in self.effects if c.side == "output"), key=lambda c: c.order)
        leading = [(c, operator) for c in before for operator in c.operators]
        trailing = [(c, operator) for c in after for operator in c.operators]
        self.chain = with_dependences(
            Chain(
                nominal.core,
                (*(operator for _, operator in leading), *nominal.before),
                (*nominal.after, *(operator for _, operator in trailing)),
            ),
            [c.depends for c in self.effects if c.depends is not None],
        )
        self.offsets_by_inputs = any(c.depends is not None and c.depends.group == "offset" for c in self.effects)
        self._staged, self._given = StagedChain(self.chain), self.chain.values
        at, states = self._places()
        core = len(self.chain.before)
        self._nominal = [
            at[k] + i for k, o in enumerate(nominal.operators, len(leading)) for i in range(len(o.parameters))
        ]
        first = core + 1 + len(nominal.after)
        owners = [*((c, k) for k, (c, _) in enumerate(leading)), *((c, first + k) for k, (c, _) in enumerate(trailing))]
        self._before, self._leading = slice(0, states[core]), len(leading)
        self._carried = [(c.carries, states[k]) for c, k in owners if c.carries]
        kept = {
            k for name, indices in baseline.effects.items() if name not in self._in_core() for k in indices.values()
        }
        kept.update(baseline.held)
        self._active = [k for k in range(baseline.nominal.size) if k not in kept]
        self._z = len(self._active)
        self._freedoms = [
            (freedom, self._indices(freedom.name, self._owned(c, owners), at))
            for c in self.effects
            for freedom in c.free
        ]
        scales = np.array([*baseline.scale[self._active], *(f.scale for f, _ in self._freedoms)])
        self._log = scales == 0.0
        self._scale = np.where(self._log, 1.0, scales)
        self.lower = self.scaled(np.array([*baseline.lower[self._active], *(f.lower for f, _ in self._freedoms)]))
        self.roughness = np.zeros((len(baseline.roughness), self.size))  # rows (R, Q), as of the baseline
        if len(baseline.roughness):
            self.roughness[:, : self._z] = baseline.roughness[:, self._active] * baseline.scale[self._active]
        self.upper = self.scaled(np.array([*baseline.upper[self._active], *(f.upper for f, _ in self._freedoms)]))
        self._last: tuple[Vec, Vec, Vec] | None = None

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self._z + len(self._freedoms)

    def units(self, q: Vec) -> Vec:
        """Usual steps (Q,) of the unknowns about q; infinite where the angle is linear in them."""
        units = np.maximum(np.abs(q), 1.0)
        units[: self._z][self.baseline.linear[self._active]] = np.inf
        return units

    def start(self, z: Vec, effects: Sequence[Sequence[float]]) -> Vec:
        """Unknowns from baseline values z (Z,) and free parameters of each effect, in the core those that z has not."""
        z, outside = z.copy(), list[float]()
        for k, values in enumerate(effects):
            if self.effects[k].variant != CORE:
                outside += values
            elif values:
                z[list(self.baseline.effects[self.effects[k].effect].values())] = values
        return self.scaled(np.array([*z[self._active], *outside], dtype=np.float64))

    @property
    def as_given(self) -> Vec:
        """Unknowns (Q,) of the simulator as given, without candidate effects."""
        return self.start(self.baseline.nominal, [])

    def scaled(self, values: Vec) -> Vec:
        """Unknowns q of parameter values."""
        q = values / self._scale
        q[self._log] = np.log(q[self._log])
        return q

    def plain(self, q: Vec) -> Vec:
        """Parameter values of unknowns q."""
        values = q * self._scale
        values[self._log] = np.exp(values[self._log])
        return values

    def retuned(self, q: Vec) -> Vec:
        """Baseline unknowns z (Z,) at unknowns q."""
        return self._retuned(self.plain(q))

    def _retuned(self, values: Vec) -> Vec:
        z = self.baseline.nominal.copy()
        z[self._active] = values[: self._z]
        return z

    def effect_values(self, q: Vec) -> list[dict[str, float]]:
        """Free parameters of each effect by name, in the order of `start`."""
        values = self.plain(q)[self._z :].tolist()
        return [{freedom.name: values.pop(0) for freedom in c.free} for c in self.effects]

    def identified(self, q: Vec) -> dict[str, dict[str, float]]:
        """Parameters by effect and name, those of effects in the core included."""
        z = self.retuned(q)
        by_effect = {c.effect: dict(values) for c, values in zip(self.effects, self.effect_values(q), strict=True)}
        for name in self._in_core():
            by_effect[name] = {label: float(z[k]) for label, k in self.baseline.effects[name].items()}
        return by_effect

    def fitted_chain(self, q: Vec) -> Chain:
        """Chain with the identified parameters."""
        return self.chain.with_values(self._values(q)[0].tolist())

    def angles(self, q: Vec, run: Run) -> Vec:
        """Angles (T,) of a free run [deg]."""
        p = self._values(q)[0]
        together = RunsTogether.of([run])
        state = self._start(together, p, np.empty((p.size, 0)))[0]
        commands, inputs = together.command[:, None], {name: z[:, None] for name, z in together.inputs.items()}
        theta = self._staged.simulate(commands, run.dt_s, state, p, inputs)[0][together.recorded, 0]
        return np.asarray(theta + run.correction, dtype=np.float64)

    def filtered(self, q: Vec, run: Run) -> Vec:
        """Commands (T,) of a run behind the effects on its side, as the nominal simulator gets them [cmd]."""
        if not self._leading:
            return run.command
        *others, last = self.chain.operators[: self._leading]
        front, p = Chain(last, tuple(others)), self._values(q)[0]
        together = RunsTogether.of([run])
        state = self._start(together, p, np.empty((p.size, 0)))[0][: front.state_size]
        commands, values = together.command[:, None], p[: len(front.parameters)]
        inputs = {name: z[:, None] for name, z in together.inputs.items()}
        return StagedChain(front).simulate(commands, run.dt_s, state, values, inputs)[0][together.recorded, 0]

    def linearised(self, q: Vec, run: Run) -> tuple[Vec, Vec]:
        """Angles (T,) and their derivative (T, Q)."""
        theta, both = self._pass(q, RunsTogether.of([run]))
        return theta, both[:, :-1]

    def error(self, q: Vec, run: Run) -> tuple[Vec, Vec]:
        """Angle minus measurement where it counts (C,) and its derivative (C, Q), without terms of the trial."""
        theta, both = self._pass(q, RunsTogether.of([run]))
        left = self.terms.projected(run, theta[run.scored], both[run.scored])
        return left[:, -1], left[:, :-1]

    def held_out_errors(self, q: Vec, runs: Sequence[Run]) -> tuple[Vec, ...]:
        """Angle minus measurement where each run counts (C,); terms of a trial are estimated on its other blocks."""
        errors = []
        for together in RunsTogether.groups(runs):
            theta, both = self._pass(q, together, self.terms.width >= 0)
            for run, at in together.each():
                scored = both[at][run.scored]
                error = np.ascontiguousarray(scored[:, -1])  # a view would keep all derivatives
                errors.append(self.terms.cross_fitted(run, theta[at][run.scored], error, scored[:, :-1]))
        return tuple(errors)

    def products(self, q: Vec, together: RunsTogether, white: Vec = AS_IT_IS) -> tuple[Vec, list[Vec]]:
        """Products of derivatives and errors in one pass over many runs, derivatives first and the error last.

        Args:
            white: filter for derivatives and error (`whitening`).

        Returns:
            Sum over the samples that count of the products of both (Q + 1, Q + 1), the terms of trials projected out,
            and offsets and gains of the trials (2, Q + 1) each [deg]; none where trials have no offset.
        """
        theta, both = self._pass(q, together)
        parts, common = [both[a:b] for a, b in together.spans], []
        if self.terms != NO_TERMS:
            scored = [(run, theta[at][run.scored], both[at][run.scored]) for run, at in together.each()]
            parts = [self.terms.projected(*pair) for pair in scored]
            common = [self.terms.common(*pair) for pair in scored] if self.terms.apart else []
        parts = [whitened(part, white) for part in parts]
        return sum((part.T @ part for part in parts), np.zeros((q.size + 1, q.size + 1))), common

    def begun(self, q: Vec, run: Run, box: Box) -> Run:
        """Run with the start estimated at unknowns q, where it begins in motion."""
        runs = self._staged.rollouts(run.dt_s, self._values(q)[0], run.inputs, run.lead)
        return run.begun(runs, box, self.chain.rest_samples)

    def _pass(self, q: Vec, together: RunsTogether, derivatives: bool = True) -> tuple[Vec, Vec]:
        """Angles (T,), their derivative, if asked, and, in the last column, their error (T, Q + 1) over all samples."""
        p, slope = self._values(q)
        slope = slope if derivatives else slope[:, :0]
        more = _STARTS * any(run.lead for run in together.runs)
        seeds = np.column_stack([np.zeros((p.size, more)), slope, np.zeros(p.size)])
        state, moving = self._start(together, p, seeds)
        if more:
            self._move_starts(together, p, state, moving)
        theta, both = self._staged.differentiate(
            together.command, together.dt_s, state, moving, p, seeds, together.first, together.inputs
        )
        theta, both = theta[together.recorded], both[together.recorded]
        theta += together.correction
        np.subtract(theta, together.angle, out=both[:, -1])
        if not more:
            return theta, both
        for run, at in together.each():
            if run.lead:
                theta[at] -= _from_lead(both[at], run.lead)
        return theta, np.ascontiguousarray(both[:, more:])

    def _move_starts(self, together: RunsTogether, p: Vec, state: Vec, moving: Vec) -> None:
        """Set the derivatives of the states by command and angle at rest before, in the first columns."""
        command, angle = together.rests
        none, leads = np.empty((p.size, 0)), np.array([run.lead > 0 for run in together.runs])
        for k, (du, dy) in enumerate(((_NUDGE, 0.0), (0.0, _NUDGE))):
            rests = command + du, angle + dy, together.dt_s, p, none, together.first_inputs
            moved = (self._staged.settled(*rests)[0] - state) / _NUDGE
            part = self._before if k == 0 else slice(self._before.stop, None)
            moving[part, :, k] = moved[part] * leads
        for _, index in self._carried:
            moving[index, :, :_STARTS] = 0.0

    def _values(self, q: Vec) -> tuple[Vec, Vec]:
        """Parameters (P,) of the chain and their derivative (P, Q) by the unknowns; the last result is cached."""
        last = self._last
        if last is None or not np.array_equal(q, last[0]):
            self._last = last = (q.copy(), *self._values_at(q))
        return last[1:]

    def _values_at(self, q: Vec) -> tuple[Vec, Vec]:
        values = self.plain(q)
        p, slope = self._given.copy(), np.zeros((self._given.size, q.size))
        given, by_z = self.baseline.chain_values(self._retuned(values))
        p[self._nominal], slope[self._nominal, : self._z] = given, (by_z * self.baseline.scale)[:, self._active]
        for k, (freedom, indices) in enumerate(self._freedoms, self._z):
            p[indices], slope[indices, k] = values[k], freedom.scale or values[k]
        return p, slope

    def _in_core(self) -> list[str]:
        return [c.effect for c in self.effects if c.variant == CORE]

    def _owned(self, c: Candidate, owners: Sequence[tuple[Candidate, int]]) -> Sequence[int]:
        """Numbers of the operators that may have a candidate's parameters: all for a dependence on an input."""
        return [k for other, k in owners if other is c] if c.depends is None else range(len(self.chain.operators))

    def _indices(self, name: str, operators: Sequence[int], at: Sequence[int]) -> list[int]:
        positions = []
        for k in operators:
            names = [p.name for p in self.chain.operators[k].parameters]
            if name in names:
                positions.append(at[k] + names.index(name))
        return positions

    def _start(self, together: RunsTogether, p: Vec, seeds: Vec) -> tuple[Vec, Vec]:
        """States (S, N) before the first sample of each run, and their derivatives (S, N, D)."""
        state, slope = self._staged.settled(*together.rests, together.dt_s, p, seeds, together.first_inputs)
        for what, index in self._carried:
            state[index] = [
                run.bent_before if what == "bend" else run.clock_s - len(run.approach) * run.dt_s
                for run in together.runs
            ]
            slope[index] = 0.0
        return state, slope

    def _places(self) -> tuple[list[int], list[int]]:
        at, states = [0], [0]
        for operator in self.chain.operators:
            at.append(at[-1] + len(operator.parameters))
            states.append(states[-1] + len(operator.states))
        return at, states
