"""Settings, jobs and results of the studies on public data."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, Self

from pydantic import Field

from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.trials.errors import ConfigError, did_you_mean

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
        study: always `public`.
        dataset: name of the data set, see `DATA_SETS`.
        data: file that is identified from, or a folder of them.
        test: further files of the test.
        kinds: of model, by name; those of `DATA_SETS` where left out.
        seed: of everything drawn at random.
        quick: few steps, short tests: proves that everything runs, and nothing else.
    """

    study: Literal["public"] = "public"
    dataset: str
    data: str
    test: tuple[str, ...] = ()
    kinds: tuple[str, ...]
    seed: Annotated[int, Field(ge=0)] = 1
    quick: bool = False

    @classmethod
    def of(cls, **changes: Any) -> Self:
        """The study with some changes; a change that is None or empty keeps the default.

        Raises:
            ConfigError: on an unknown data set, or without a file.
            FitError: on an unknown kind of model.
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
        rmse: root mean square error.
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
        scores: by test record.
    """

    job: PublicJob
    fit_s: float = 0.0
    parameters: Mapping[str, Figure] = field(default_factory=dict)
    scores: Mapping[str, Score] = field(default_factory=dict)
