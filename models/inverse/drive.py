"""Dynamics before or behind an inverted model: inputs over a preview whose outputs follow a path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, final

import numpy as np

from hystmpc.trials.types import Vec

from ..chain import Chain
from ..contract.metadata import InitialRule, ModelMetadata
from ..kernels.numba_ import njit
from ..model import Inverse, Predictor
from ..operators.dynamics import Delay, stored
from ..operators.operator import Operator
from ..prediction.compiled import CompiledPredictor

_MOVE_WEIGHT = 1e-3  # of a squared move of the input against a squared deviation of the output
_ROUNDS = 3  # linearisations
_LINEAR = 1e-6  # share of the output's change that the linearisation may miss
_ACTS = 1e-6  # share of the greatest answer below which an input does not act yet
_WHOLE = 1e-9  # share of a sample by which a delay of whole samples may be short of them
_FREE = 1e9  # bound of moves that have none
_CHANGES = 4  # of the active set, per move
_SIGN = 1e-10  # share of the greatest gradient that counts as zero


class DriveFit(NamedTuple):
    """Inputs (H,) of a drive, their outputs (H,), and the first output sample that the inputs change."""

    inputs: Vec
    outputs: Vec
    first: int


@final
class Drive:
    """Dynamics of unit gain between an input and an output of the same unit.

    Args:
        operators: in series, at least one.
        facts: of the model whose command or angle they pass, for sample time and range.

    Attributes:
        predictor: of the dynamics alone; its state at rest is that of a constant input.
        delay_samples: delay of the output in whole samples.
    """

    def __init__(self, operators: Sequence[Operator], facts: ModelMetadata) -> None:
        operators = stored(operators, facts.dt_s)
        chain = Chain(operators[-1], before=operators[:-1])
        at = [np.asarray(chain.rest(u, u, chain.values)).ravel() for u in (0.0, 1.0)]
        rest = InitialRule(offset=tuple(at[0].tolist()), slope=tuple((at[1] - at[0]).tolist()))
        facts_of_drive = {"kind": "drive", "initial": rest, "conditioned": rest, "warmup_samples": 0, "noise": None}
        facts_of_drive |= {"chain": None, "connections": ()}
        self.predictor = CompiledPredictor(chain.transition, chain.values, facts.model_copy(update=facts_of_drive))
        self.size = chain.state_size
        self.delay_samples = sum(int(o.delay_s / facts.dt_s + _WHOLE) for o in operators if isinstance(o, Delay))

    def held(self, state: Vec, u: float, horizon: int) -> DriveFit:
        """Outputs (H,) for an input that stays at `u`, and the first sample that another input would change."""
        plan = np.full(horizon, u)
        outputs, response = self.predictor.linearise(state, plan)
        return DriveFit(plan, outputs, first_acting(response))

    def fit(self, state: Vec, wanted: Vec, u_last: float, reach: float) -> DriveFit:
        """Inputs whose outputs come closest to `wanted` (H,).

            min_m  sum_k (v_k(u) - w_k)^2 + eps sum_k m_k^2   s.t.  |m_k| <= reach,   u_k = u_{k-1} + m_k

        Exact for linear dynamics, by Gauss-Newton steps for others; each program by an active-set method for bounded
        least squares (Stark and Parker, Computational Statistics 10 (1995)).
        """
        inputs, moves = np.full(wanted.size, u_last), np.zeros(wanted.size)
        outputs, response = self.predictor.linearise(state, inputs)
        first = first_acting(response)
        for _ in range(_ROUNDS):
            by_move = np.cumsum(response[:, ::-1], axis=1)[:, ::-1].copy()
            solved = moves.copy()
            bounded_moves(by_move, wanted - outputs, solved, min(reach, _FREE), _MOVE_WEIGHT)
            promised, before = outputs + by_move @ (solved - moves), outputs
            moves, inputs = solved, u_last + np.cumsum(solved)
            outputs, response = self.predictor.linearise(state, inputs)
            change = np.max(np.abs(outputs - before))
            if np.max(np.abs(outputs - promised)) <= _LINEAR * max(1.0, change):
                break
        return DriveFit(inputs, outputs, first)


class DrivenParts(NamedTuple):
    """States of the inverted model, of the drive before it and of the drive behind it; empty where there is none."""

    middle: Vec
    front: Vec
    back: Vec


@final
class DrivenInverse(Inverse):
    """Static inverse of a model with dynamics before or behind it: the command that brings it to rest at the angle.

    Args:
        front: drive between command and travel; None for none. Its state precedes the model's.
        back: dynamics between the inverted model's angle and the tip's; None for none. Its state follows the model's.
    """

    def __init__(
        self, inner: Inverse, predictor: Predictor, front: Drive | None = None, back: Drive | None = None
    ) -> None:
        self.inner, self.predictor, self.front, self.back = inner, predictor, front, back
        self.delay_samples = sum(drive.delay_samples for drive in (front, back) if drive)

    def parts(self, state: Vec) -> DrivenParts:
        """Parts of the state (S,) of the whole model."""
        ahead = self.front.size if self.front else 0
        cut = state.size - (self.back.size if self.back else 0)
        return DrivenParts(state[ahead:cut], state[:ahead], state[cut:])

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        return self.inner.command(self.parts(state).middle, theta, u_last)


@njit(cache=True, error_model="numpy", nogil=True)
def first_acting(response: Any) -> int:
    """First sample that an input changes: rows of the response (H, H) before it are zero."""
    most = np.max(np.abs(response))
    for k in range(response.shape[0]):
        for j in range(k + 1):
            if abs(response[k, j]) > _ACTS * most:
                return k
    return int(response.shape[0])


@njit(cache=True, error_model="numpy", nogil=True)
def bounded_moves(by_move: Any, off: Any, moves: Any, reach: float, weight: float) -> None:
    """Solve argmin over |m_k| <= reach of |G (m - m_0) - e|^2 + w |m|^2, in place from m_0 (H,); `off`: e (H,)."""
    size = moves.size
    hessian, linear = np.zeros((size, size)), np.zeros(size)
    for k in range(size):
        for i in range(k + 1):
            slope = by_move[k, i]
            linear[i] += slope * off[k]
            for j in range(k + 1):
                hessian[i, j] += slope * by_move[k, j]
    for i in range(size):
        for j in range(size):
            linear[i] += hessian[i, j] * moves[j]
    for i in range(size):
        hessian[i, i] += weight
    lead_moves(hessian, linear, reach, moves)


@njit(cache=True, error_model="numpy", nogil=True)
def lead_moves(hessian: Any, linear: Any, reach: float, moves: Any) -> None:
    """Solve argmin over |m_k| <= reach of 1/2 m'P m - q'm (H,) in place by active sets, P positive definite."""
    size = moves.size
    side, wanted, factor = np.zeros(size), np.empty(size), np.empty((size, size))
    greatest = 0.0
    for k in range(size):
        greatest = max(greatest, abs(linear[k]))
    for _ in range(_CHANGES * size):
        free_optimum(hessian, linear, side, reach, factor, wanted)
        share, hit = first_bound(moves, wanted, side, reach)
        for k in range(size):
            moves[k] = min(max(moves[k] + share * (wanted[k] - moves[k]), -reach), reach)
        if hit >= 0:
            side[hit] = 1.0 if wanted[hit] > 0.0 else -1.0
            moves[hit] = side[hit] * reach
            continue
        worst = wrong_side(hessian, linear, side, moves, -_SIGN * greatest)
        if worst < 0:
            return
        side[worst] = 0.0


@njit(cache=True, error_model="numpy", nogil=True)
def free_optimum(hessian: Any, linear: Any, side: Any, reach: float, factor: Any, wanted: Any) -> None:
    """Minimum with the moves of a side (-1, 1) at that bound and the others free (H,), by Cholesky factorisation."""
    for i in range(side.size):
        total = linear[i]
        for k in range(side.size):
            total -= hessian[i, k] * side[k] * reach
        for j in range(i + 1):
            part = 0.0
            if side[i] == 0.0 and side[j] == 0.0:
                part = hessian[i, j]
                for k in range(j):
                    part -= factor[i, k] * factor[j, k]
            if i != j:
                factor[i, j] = part / factor[j, j]
                total -= factor[i, j] * wanted[j]
            else:
                factor[i, i] = math.sqrt(part) if side[i] == 0.0 else 1.0
        wanted[i] = total / factor[i, i] if side[i] == 0.0 else side[i] * reach
    for i in range(side.size - 1, -1, -1):
        if side[i] == 0.0:
            for k in range(i + 1, side.size):
                wanted[i] -= factor[k, i] * wanted[k]
            wanted[i] /= factor[i, i]


@njit(cache=True, error_model="numpy", nogil=True)
def first_bound(moves: Any, wanted: Any, side: Any, reach: float) -> Any:
    """Step fraction from `moves` to `wanted` (H,) where the first free move meets a bound, and its index or -1."""
    share, hit = 1.0, -1
    for k in range(moves.size):
        if side[k] == 0.0 and abs(wanted[k]) > reach:
            bound = reach if wanted[k] > 0.0 else -reach
            part = (bound - moves[k]) / (wanted[k] - moves[k])
            if hit < 0 or part < share:
                share, hit = part, k
    return share, hit


@njit(cache=True, error_model="numpy", nogil=True)
def wrong_side(hessian: Any, linear: Any, side: Any, moves: Any, least: float) -> int:
    """Index of the fixed move whose multiplier is the most below `least`; -1 for none."""
    worst = -1
    for k in range(side.size):
        if side[k] != 0.0:
            pull = linear[k]
            for i in range(side.size):
                pull -= hessian[k, i] * moves[i]
            if side[k] * pull < least:
                worst, least = k, side[k] * pull
    return worst
