"""Operators that are a curve: what they show depends on their present input alone."""

from __future__ import annotations

from abc import abstractmethod

import casadi as ca

from .operator import Operator, Symbol


class Memoryless(Operator):
    """A static map y = curve(u).

    Every step of the contract has a state; here it is the last output, without effect.
    """

    @abstractmethod
    def curve(self, u: Symbol, p: Symbol) -> Symbol:
        """Output from input and parameters (P, 1)."""

    @property
    def states(self) -> tuple[str, ...]:
        return ("y",)

    def equation(self, x: Symbol, u: Symbol, p: Symbol, dt: Symbol) -> tuple[Symbol, Symbol]:
        del x, dt
        y = self.curve(u, p)
        return y, y

    def at_rest(self, u: Symbol, y: Symbol, p: Symbol) -> Symbol:
        del y, p
        return ca.vertcat(u)
