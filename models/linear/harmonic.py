"""First harmonic of a model over amplitude and frequency: closed form behind linear drives, else settled cycles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from hystmpc.trials.types import Vec

from ..model import Predictor
from ..operators.operator import Operator
from .describing import Complex, closed_form, settled_cycle, whole_cycle
from .systems import linear_part

_LENGTHS = (2000.0, 2.0 + 1e-9), (400.0, 3.02), (120.0, 3.02)
"""Most and least samples a period: with a closed form, of operators, of a network, whose roll-outs take long."""
_FREQUENCIES = 400, 40, 24
_PERIODS = 3  # of a cycle, so that short periods are no whole numbers of samples


@final
@dataclass(frozen=True, eq=False)
class HarmonicModel:
    """Describing function of a model in a loop.

        N(A, omega) = G_after(z) N_op(|G_before(z)| A) G_before(z),   z = exp(i omega dt)

    where one operator with a closed form stands between linear ones; that of settled cycles otherwise.

    Attributes:
        predictor: of the whole.
        operators: that the whole consists of, in series; none of a network.
        centre: mean of the command.
    """

    predictor: Predictor
    operators: Sequence[Operator]
    centre: float

    @property
    def effort(self) -> int:
        """0 with a closed form, 1 of other operators, 2 of a network: what one value costs."""
        return 0 if self.parts is not None else 1 if self.operators else 2

    @property
    def slowest_s(self) -> float:
        """Longest period that is seen [s]."""
        return _LENGTHS[self.effort][0] * self.predictor.dt

    @cached_property
    def frequencies(self) -> Vec:
        """Frequencies (F,) [rad/s] over which a loop is evaluated, rising."""
        lengths = np.geomspace(*_LENGTHS[self.effort], _FREQUENCIES[self.effort])
        if self.parts is not None:
            return np.asarray(2.0 * np.pi / (lengths * self.predictor.dt))
        cycles = dict.fromkeys(whole_cycle(2.0 * np.pi / length, _PERIODS) for length in lengths)
        turns = sorted(2.0 * np.pi * periods / samples for samples, periods in cycles)
        return np.array(turns) / self.predictor.dt

    def response(self, amplitudes: Vec) -> Complex:
        """N (F, A) at the frequencies for amplitudes of the command (A,); loops around one model share it."""
        key = amplitudes.tobytes()
        if key not in self._known:
            self._known[key] = self._response(amplitudes)
        return self._known[key]

    @cached_property
    def _known(self) -> dict[bytes, Complex]:
        return {}

    def _response(self, amplitudes: Vec) -> Complex:
        if self.parts is None:
            dt, at = self.predictor.dt, self.centre
            cycles = [whole_cycle(omega * dt, _PERIODS) for omega in self.frequencies]
            return np.array([settled_cycle(self.predictor, at, amplitudes, *cycle).first for cycle in cycles])
        before, after = self._drives
        forms = [closed_form(self.parts[1], abs(g) * amplitudes, self.centre) for g in before]
        return np.array(forms, dtype=np.complex128) * (before * after)[:, None]

    @cached_property
    def _drives(self) -> tuple[Complex, Complex]:
        """Frequency responses (F,) of what is linear before and behind the operator."""
        assert self.parts is not None
        z = np.exp(1j * self.frequencies * self.predictor.dt)
        return through(self.parts[0], z, self.predictor.dt), through(self.parts[2], z, self.predictor.dt)

    @cached_property
    def parts(self) -> tuple[Sequence[Operator], Operator, Sequence[Operator]] | None:
        """Linear operators before the one with a closed form, that one, linear ones behind it; None of any other."""
        dt = self.predictor.dt
        bent = [k for k, operator in enumerate(self.operators) if linear_part(operator, dt) is None]
        if len(bent) != 1:
            return None
        operator = self.operators[bent[0]]
        widest = np.array([1e-3, 1e3])
        if closed_form(operator, widest, self.centre) is None:
            return None
        return self.operators[: bent[0]], operator, self.operators[bent[0] + 1 :]


def through(operators: Sequence[Operator], z: Complex, dt_s: float) -> Complex:
    """Response of linear operators in series at points z of any shape."""
    total = np.ones(z.shape, dtype=np.complex128)
    for operator in operators:
        part = linear_part(operator, dt_s)
        assert part is not None
        inner = np.linalg.solve(z[..., None, None] * np.eye(len(part.a)) - part.a, part.b.astype(np.complex128))
        total *= (part.c @ inner + part.d)[..., 0, 0]
    return total
