"""Single assignments of a CasADi expression: every value has a number and is written once; conditions simplified."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, final

from .program import Instruction, instructions

_COMPARISONS = {"lt", "le", "eq", "ne", "or"}


@final
class Assignments:
    """Values of a dense SX function in the order of its instructions.

    Attributes:
        steps: the instruction that computes each value; beside those of `program` also `select`, c ? a : b.
        read: the values that each instruction reads.
        results: values of the function's outputs, output by output.
    """

    def __init__(self, function: Any) -> None:
        self.steps: list[Instruction] = []
        self.read: list[tuple[int, ...]] = []
        self.results: list[list[int]] = [[0] * function.numel_out(k) for k in range(function.n_out())]
        self._number(function)
        self._choose()
        self._simplify()

    def needs(self, argument: int, unless: Sequence[int] = ()) -> list[bool]:
        """Whether each value changes with an argument of the function, some of its entries left out."""
        needs: list[bool] = []
        for step, read in zip(self.steps, self.read, strict=True):
            if step.name == "input":
                needs.append(step.args[0] == argument and step.args[1] not in unless)
            else:
                needs.append(any(needs[a] for a in read))
        return needs

    def behind(self, values: Iterable[int]) -> list[bool]:
        """Whether each value is needed for some."""
        needed = [False] * len(self.steps)
        for v in values:
            needed[v] = True
        for v in range(len(self.steps) - 1, -1, -1):
            if needed[v]:
                for a in self.read[v]:
                    needed[a] = True
        return needed

    def _number(self, function: Any) -> None:
        """Number the values; equal constants and inputs are one value."""
        where: dict[int, int] = {}
        known: dict[Any, int] = {}
        for step in instructions(function):
            if step.name == "output":
                self.results[step.out[0]][step.out[1]] = where[step.args[0]]
                continue
            leaf = step.name in ("input", "const")
            key = (step.name, step.args, step.value) if leaf else None
            if key is None or key not in known:
                self.steps.append(step)
                self.read.append(() if leaf else tuple(where[a] for a in step.args))
                if key is not None:
                    known[key] = len(self.steps) - 1
            where[step.out[0]] = len(self.steps) - 1 if key is None else known[key]

    def _write(self, v: int, name: str, read: tuple[int, ...]) -> None:
        step = self.steps[v]
        self.steps[v], self.read[v] = Instruction(name, step.out, step.args), read

    def _choose(self) -> None:
        """One instruction for `c ? a : b`, which CasADi writes as `if_else_zero(c, a) + if_else_zero(not c, b)`.

        Where c compares a and b themselves that is the smaller or the greater of them.
        """
        for v, step in enumerate(self.steps):
            if step.name != "add":
                continue
            one, other = self.read[v]
            if self.steps[one].name != "if_else_zero" or self.steps[other].name != "if_else_zero":
                continue
            (c, a), (d, b) = self.read[one], self.read[other]
            if self.steps[c].name == "not" and self.read[c][0] == d:
                c, a, d, b = d, b, c, a
            if self.steps[d].name != "not" or self.read[d][0] != c:
                continue
            compared = self.read[c] if self.steps[c].name == "le" else ()
            if compared in ((a, b), (b, a)):
                self._write(v, "fmin" if compared == (a, b) else "fmax", (a, b))
            else:
                self._write(v, "select", (c, a, b))

    def _simplify(self) -> None:
        """Conditions are 1 or 0: `if_else_zero(c, 1)` is c, with -1 it is -c, with a condition it is their product."""
        same = list(range(len(self.steps)))
        condition = [False] * len(self.steps)
        for v, step in enumerate(self.steps):
            read = self.read[v] = tuple(same[a] for a in self.read[v])
            if step.name == "if_else_zero" and condition[read[0]]:
                chosen = self.steps[read[1]]
                if chosen.name == "const" and chosen.value == 1.0:
                    same[v] = read[0]
                elif chosen.name == "const" and chosen.value == -1.0:
                    self._write(v, "neg", read[:1])
                elif condition[read[1]]:
                    self._write(v, "and", read)
            name = self.steps[v].name
            condition[v] = name in _COMPARISONS or (name in ("not", "and") and all(condition[a] for a in self.read[v]))
        self.results = [[same[v] for v in result] for result in self.results]
