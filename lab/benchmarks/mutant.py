"""What a mutant is: one wrong line, and the tests that have to find it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    """One wrong line. One that can do no harm, since the code behaves the same, does not belong into a list.

    Attributes:
        name: what is wrong then.
        room: of the package, for the table.
        file: from the root of the checkout.
        old: text that occurs exactly once in the file.
        new: what stands there instead.
        tests: files or folders of tests that have to fail, from the root of the checkout.
    """

    name: str
    room: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


@dataclass(frozen=True)
class Mutated:
    """One file of a room and its tests; called with a name, the old and the new text it gives a mutant."""

    room: str
    file: str
    tests: tuple[str, ...]

    def __call__(self, name: str, old: str, new: str) -> Mutant:
        return Mutant(name, self.room, self.file, old, new, self.tests)


def mutated_file(room: str, file: str, *tests: str) -> Mutated:
    """A file and tests, each from its room's folder."""
    return Mutated(room, f"{room}/{file}", tuple(f"tests/{room}/{test}" for test in tests))
