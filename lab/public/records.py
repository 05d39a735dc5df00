"""A public data set as the study has it: what is fitted together, what is scored, the figures of others."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hystmpc.trials.errors import LogError
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

from .settings import PublicSettings


@dataclass(frozen=True, eq=False)
class ScoredRecord:
    """A record of the test.

    Attributes:
        start: output from which a free run begins.
        periodic: one period of a steady state: a model runs over it several times, and the last time counts.
        simulated: whether it was simulated here.
        first: first sample that counts.
        height: by which the record was divided, so that the training could be; errors are multiplied by it.
    """

    name: str
    trial: Trial
    start: float
    periodic: bool = False
    simulated: bool = False
    first: int = 0
    height: float = 1.0

    def errors(self, predicted: Vec) -> Vec:
        """Prediction less measurement where it counts, in the unit of the data set."""
        return self.height * (predicted - self.trial.angle)[self.first :]

    @property
    def span(self) -> float:
        """Range of the measured output where it counts, in the unit of the data set."""
        return self.height * float(np.ptp(self.trial.angle[self.first :]))


@dataclass(frozen=True, eq=False)
class Case:
    """Trials that a model is identified from, and the records it is scored on.

    Attributes:
        name: such as a file; empty where a data set is one case.
        facts: what to know of it, in the unit of the data set.
    """

    name: str
    training: Sequence[Trial]
    tests: Sequence[ScoredRecord]
    facts: Mapping[str, float | str] = field(default_factory=dict)


@dataclass(frozen=True)
class Published:
    """A figure of others: root mean square error on a test, in the unit of the data set."""

    model: str
    test: str
    rmse: float


class PublicData(ABC):
    """One data set.

    Attributes:
        title, about: of the page.
        units: of its command and output.
        published: figures of others; empty where none is known.
        note: what the published figures are of, or that there are none.
    """

    title: str
    about: str
    units: Units
    published: tuple[Published, ...] = ()
    note: str

    @abstractmethod
    def files(self, settings: PublicSettings) -> tuple[Path, ...]:
        """All files that are read.

        Raises:
            LogError: if there is none.
        """

    @abstractmethod
    def cases(self, settings: PublicSettings) -> Sequence[Case]:
        """What is fitted and scored.

        Raises:
            LogError: if a file cannot be used.
        """


def files_in(path: Path | str, pattern: str) -> tuple[Path, ...]:
    """The file, or those of a folder that fit a pattern, by name.

    Raises:
        LogError: if there is none.
    """
    place = Path(path)
    found = (place,) if place.is_file() else tuple(sorted(place.glob(pattern)))
    if not found:
        raise LogError(f"{place}: no such file, or a folder without {pattern}")
    return found


_LEAD_S = 5.0


def unsettled(part: Trial) -> int:
    """Samples at the start of a record that are not scored: how the device came there is not known."""
    return min(round(_LEAD_S / part.dt), len(part) // 2)


def withheld_end(parts: Sequence[Trial], share: float, name: str) -> tuple[list[Trial], list[ScoredRecord]]:
    """The first share of a log to identify from, and its end to score; a model runs from the start of each part.

    Args:
        parts: of one log, cut at its gaps.
        share: of its samples, that is seen.
        name: of the test.
    """
    seen, left = [], []
    open_samples = round(share * sum(map(len, parts)))
    for part in parts:
        cut = min(open_samples, len(part))
        open_samples -= cut
        if cut > 1:
            seen.append(part.select(0, cut))
        if cut < len(part):
            first = cut or unsettled(part)
            left.append(ScoredRecord(name, part, float(part.angle[0]), first=first))
    if len(left) > 1:
        left = [ScoredRecord(f"{name}, {k}", r.trial, r.start, first=r.first) for k, r in enumerate(left, 1)]
    return seen, left
