"""What a search hands over between processes: which trial is to be done, and what became of all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

State = Literal["done", "pruned", "failed", "elsewhere"]


@dataclass(frozen=True)
class Ticket:
    """One trial of a search, to be done by whoever comes first.

    Attributes:
        slot: number of the trial; slot 0 has the settings as they were given.
        storage: where the search is kept, as Optuna names it.
        study: name of the search in it.
        settings: of the tuning, as JSON.
    """

    slot: int
    storage: str
    study: str
    settings: str


@dataclass(frozen=True)
class Outcome:
    """What became of a ticket; `elsewhere` is being done by another process."""

    slot: int
    state: State
    message: str = ""


@dataclass(frozen=True)
class Trial:
    """A trial of a search.

    Attributes:
        slot: number.
        state: `done` or `pruned`.
        value: robust objective over the plants that it has seen [deg].
        values: what was searched, by path.
        error_deg: robust objective of the bare errors [deg].
        travel: mean command travel over the need.
        plants: that it has seen.
    """

    slot: int
    state: State
    value: float
    values: Mapping[str, Any]
    error_deg: float
    travel: float
    plants: int


def pareto_front(trials: Sequence[Trial]) -> tuple[Trial, ...]:
    """Trials than which no other has both less error and less travel, from the least error on; pruned ones left out."""
    front: list[Trial] = []
    for trial in sorted((t for t in trials if t.state == "done"), key=lambda t: (t.error_deg, t.travel)):
        if not front or trial.travel < front[-1].travel:
            front.append(trial)
    return tuple(front)
