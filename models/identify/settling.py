"""Where a chain's runs begin: every operator held at a command until it rests, the last showing an angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from hystmpc.trials.types import Index, Mask, Vec

from ..kernels.chain_kernels import DIRECTIONS, StageKernels
from ..rest import FLAT, nearest_shown

Stage = tuple[StageKernels, slice, slice]
"""Compiled operator, and where its states and its parameters stand among those of the chain."""


@dataclass(frozen=True, eq=False)
class HeldRows:
    """N rows held at their commands; D directions, the last of them the angle that the core was told to show.

    Attributes:
        state, slope: (S, N), and its derivative (S, N, D).
        signal, by_signal: what the last operator so far hands on one sample later (N,), and its derivative (N, D).
        core: angle that the core shows then (N,) [deg]; the one it was told where it can hold it.
    """

    state: Vec
    slope: Vec
    signal: Vec
    by_signal: Vec
    core: Vec

    def rows(self, n: Index) -> HeldRows:
        """A copy of some rows."""
        return HeldRows(self.state[:, n], self.slope[:, n], self.signal[n], self.by_signal[n], self.core[n])

    def put(self, n: Index, other: HeldRows) -> None:
        """Take rows n from another."""
        self.state[:, n], self.slope[:, n] = other.state, other.slope
        self.signal[n], self.by_signal[n], self.core[n] = other.signal, other.by_signal, other.core

    @property
    def moves(self) -> Vec:
        """Derivative of what is shown by the core's angle (N,)."""
        return self.by_signal[:, -1]

    @property
    def leads(self) -> Mask:
        """Rows in which that derivative leads anywhere (N,)."""
        return ~(np.abs(self.moves) < FLAT)


@final
@dataclass(frozen=True, eq=False)
class Settling:
    """One parameter point at which rows are settled; see `StagedChain.settled`.

    Attributes:
        stages: operators in the order of the signal.
        core: number of the core.
        values: parameters (P, 1).
        kept: of every operator, what follows from parameters and sample time.
        seeds: derivative of the parameters in each direction (P, D); zero in the last, the core's angle.
    """

    stages: Sequence[Stage]
    core: int
    values: Vec
    kept: Sequence[Vec]
    seeds: Vec

    def rows(self, command: Vec, angle: Vec) -> HeldRows:
        """Rows (N,) held at commands [cmd] that show angles [deg], or the nearest that they can."""
        before = self._before(command)
        return nearest_shown(angle, lambda n, at: self._held(before.rows(n), at))

    def _before(self, command: Vec) -> HeldRows:
        """What stands before the core, held at commands (N,)."""
        states, count = self.stages[-1][1].stop, self.seeds.shape[1]
        x, m = np.empty((states, command.size)), np.zeros((states, command.size, count))
        signal, moving = command.copy(), np.zeros((command.size, count))
        for k in range(self.core):
            self._pass(k, x, m, signal, moving, signal.copy(), moving.copy())
        return HeldRows(x, m, signal, moving, np.empty(command.size))

    def _held(self, before: HeldRows, core_angle: Vec) -> HeldRows:
        """Whole rows; what stands before the core does not depend on the core's angle, and is found once."""
        x, m = np.array(before.state, order="C"), np.array(before.slope, order="C")
        signal, moving = before.signal.copy(), before.by_signal.copy()
        by_shown = np.zeros_like(moving)
        by_shown[:, -1] = 1.0
        self._pass(self.core, x, m, signal, moving, core_angle, by_shown)
        core = signal.copy()
        for k in range(self.core + 1, len(self.stages)):
            self._pass(k, x, m, signal, moving, signal.copy(), moving.copy())
        return HeldRows(x, m, signal, moving, core)

    def _pass(self, k: int, x: Vec, m: Vec, signal: Vec, moving: Vec, seen: Vec, by_seen: Vec) -> None:
        """One operator further: its states at rest at what it sees, and what it hands on, in place of what came."""
        kernels, states, columns = self.stages[k]
        state, slope, seeds = x[states], m[states], self.seeds[columns]
        kernels.rest(signal, moving, seen, by_seen, self.values[columns], kernels.constants[2], seeds, state, slope)
        room = np.empty((len(state) + len(seeds)) * DIRECTIONS)
        kernels.differentiate(state, slope, signal, moving, seeds, self.kept[k], np.arange(signal.size + 1), room)
