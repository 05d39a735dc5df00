"""Public data set in the form of the study: settings, fitted trials, scored records, published figures."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np

from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.trials.errors import ConfigError, LogError, did_you_mean
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

from ..study import Figure, Result, StudySettings

DATA_SETS = {
    "boucwen": ("oscillator", "state_network"),
    "seals": ("maxwell_slip", "maxwell_slip_rate", "auto", "bouc_wen", "pi", "play_kernel"),
    "rig": ("auto", "backlash", "pi", "maxwell_slip"),
}
"""Data sets, and the kinds of model that are tried on each where none is named."""

_STEPS = {"state_network": 60}
_QUICK_STEPS = 4


class PublicSettings(StudySettings):
    """Settings of the study `public`.

    Attributes:
        dataset: name of the data set, see `DATA_SETS`.
        data: file that is identified from, or a folder of them.
        test: further files of the test.
        kinds: of model, by name; those of `DATA_SETS` where left out.
    """

    study: Literal["public"] = "public"
    dataset: str
    data: str
    test: tuple[str, ...] = ()
    kinds: tuple[str, ...]

    @classmethod
    def of(cls, **changes: Any) -> Self:
        """Settings of the study with some changes; None or an empty change keeps the default.

        Raises:
            ConfigError: on an unknown data set, or without a file.
        """
        if not changes.get("dataset") or not changes.get("data"):
            raise ConfigError(f"study public: expected a data set ({', '.join(DATA_SETS)}) and its file, --data FILE")
        name, test = str(changes["dataset"]), tuple(str(file) for file in changes.get("test") or ())
        if name not in DATA_SETS:
            raise ConfigError(f"study public: no data set {name!r}, {did_you_mean(name, DATA_SETS)}")
        changes["kinds"] = changes.get("kinds") or DATA_SETS[name]
        return super().of(**changes | {"data": str(changes["data"]), "test": test})

    def check_names(self) -> None:
        for kind in self.kinds:
            kind_named(kind)

    def steps(self, kind: str) -> int | None:
        """Greatest number of steps of a kind's fit; None for its own default."""
        return _QUICK_STEPS if self.quick else _STEPS.get(kind)


@dataclass(frozen=True)
class PublicJob:
    """One kind of model on one case."""

    case: str
    kind: str

    @property
    def key(self) -> str:
        """Name of its files."""
        words = re.sub(r"[^A-Za-z0-9.]+", "-", self.case).strip("-")
        return f"{words}-{self.kind}" if words else self.kind


@dataclass(frozen=True)
class Score:
    """Errors of a free run over one record, in the unit of the data set.

    Attributes:
        spread: the same less the mean error.
        span: range of the measured output where it counts.
    """

    rmse: Figure
    spread: Figure
    span: Figure


@dataclass(frozen=True)
class PublicResult(Result):
    """Outcome of one kind on one case.

    Attributes:
        fit_s: time of the identification [s].
        parameters: values of its readable form, with their labels; nothing of a network.
    """

    job: PublicJob
    fit_s: float = 0.0
    parameters: Mapping[str, Figure] = field(default_factory=dict)
    scores: Mapping[str, Score] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ScoredRecord:
    """Record of the test.

    Attributes:
        start: output from which a free run begins.
        periodic: one period of a steady state: a model runs over it several times, and the last time counts.
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
        """Prediction minus measurement of the samples that count, in the unit of the data set."""
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
    """Public data set with its cases and published figures.

    Attributes:
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
        """All input files.

        Raises:
            LogError: if there is none.
        """

    @abstractmethod
    def cases(self, settings: PublicSettings) -> Sequence[Case]:
        """Cases with fitted trials and scored records.

        Raises:
            LogError: if a file cannot be used.
        """


def files_in(path: Path | str, pattern: str) -> tuple[Path, ...]:
    """The given file, or the files in a folder that match a pattern, by name.

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
    """Number of samples at the start of a record that are not scored, since the earlier history is unknown."""
    return min(round(_LEAD_S / part.dt), len(part) // 2)


def withheld_end(parts: Sequence[Trial], share: float, name: str) -> tuple[list[Trial], list[ScoredRecord]]:
    """First share of a log for identification, and its end for the score, with a fresh start in each part.

    Args:
        parts: of one log, cut at its gaps.
        share: of its samples, that is seen.
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
