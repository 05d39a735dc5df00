"""Whether a diagnosis depends on the order of the files, where the order of recording is unknown."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Progress

from .bars import orders_bar
from .measures import Rate
from .reading import orders_said
from .run import ORDERS, DiagnosisJob, diagnose_all
from .sealed import read_manifest


def run_orders(
    folder: Path, cases: int = 20, orders: int = 10, jobs: int = 1, seed: int = 0, progress: Progress | None = None
) -> int:
    """Diagnose some cases in random orders of their files, the order of recording unknown; resumable.

    Args:
        folder: made by `make_blind`.
        cases: how many; the first ones, which are drawn at random.
        orders: of each.

    Returns:
        Diagnoses that failed, in this call.

    Raises:
        LogError: if the folder holds no blind check.
        ConfigError: on a count below 1, or if a worker process died.
    """
    if cases < 1 or orders < 1:
        raise ConfigError(f"orders: got {orders} of {cases} cases, expected at least 1 of 1")
    manifest = read_manifest(folder)
    todo = [
        DiagnosisJob(folder, name, seed, manifest.without.get(name, ()), (), f"{ORDERS}/{k:02d}", k)
        for name in manifest.cases[:cases]
        for k in range(orders)
    ]
    return diagnose_all(todo, jobs, progress)


@dataclass(frozen=True)
class CaseOrders:
    """One case in several orders of its files.

    Attributes:
        sets: each set of names with the number of orders that gave it, in words.
    """

    case: str
    orders: int
    sets: str


@dataclass(frozen=True)
class Orders:
    """All cases that were diagnosed in other orders of their files.

    Attributes:
        rate: share of the diagnoses that name the most frequent set of their case.
        goal: of it, in words.
    """

    rows: tuple[CaseOrders, ...]
    rate: Rate
    goal: str


def orders_of(folder: Path) -> Orders:
    """What was said in each order, by case; the answers stay sealed.

    Raises:
        LogError: if the folder holds no blind check, or a diagnosis is damaged.
    """
    said = {name: orders_said(folder, name) for name in read_manifest(folder).cases}
    told = {name: sets for name, sets in said.items() if sets}
    rows = tuple(CaseOrders(name, len(sets), _words(sets)) for name, sets in told.items())
    found, rate = orders_bar(told)
    return Orders(rows, rate, found.goal)


def _words(sets: tuple[frozenset[str], ...]) -> str:
    counts = Counter(sets).most_common()
    return "; ".join(f"{' + '.join(sorted(names)) or 'no name'} {count}" for names, count in counts)
