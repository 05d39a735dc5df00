"""Dynamics before or behind an inverted model: inputs over a preview whose outputs follow a path."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from hystmpc.core.structs import Struct, struct
from hystmpc.trials.types import Vec

from ..chain import Chain
from ..contract.metadata import InitialRule, ModelMetadata
from ..fronts import EngineInverse
from ..model import Inverse, Predictor, kind_of
from ..operators.dynamics import Delay, stored
from ..operators.operator import Operator
from ..prediction.compiled import CompiledPredictor

_WHOLE = 1e-9  # share of a sample by which a delay of whole samples may be short of them


class DriveFit(NamedTuple):
    """Inputs (H,) of a drive and their outputs (H,)."""

    inputs: Vec
    outputs: Vec


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

    def fit(self, state: Vec, wanted: Vec, u_last: float, reach: float) -> DriveFit:
        """Inputs whose outputs come closest to `wanted` (H,).

            min_m  sum_k (v_k(u) - w_k)^2 + eps sum_k m_k^2   s.t.  |m_k| <= reach,   u_k = u_{k-1} + m_k

        Exact for linear dynamics, by Gauss-Newton steps for others; each program by an active-set method for bounded
        least squares (Stark and Parker, Computational Statistics 10 (1995)).
        """
        return DriveFit(*self.predictor.run.lead(state, wanted, u_last, reach))


@final
class DrivenInverse(EngineInverse):
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

    @property
    def state_size(self) -> int:
        return self.predictor.state_size + sum(drive.size for drive in (self.front, self.back) if drive)

    @cached_property
    def part(self) -> Struct:
        front, back = (drive and drive.predictor.part for drive in (self.front, self.back))
        kind, predictor = kind_of("DRIVEN"), self.predictor.part
        return struct("hystmpc_inverse", kind=kind, predictor=predictor, inner=self.inner.part, front=front, back=back)
