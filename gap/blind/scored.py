"""Cases with their answers and what was said about them: what the measures take."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hystmpc.models.effects.catalogue import confusable
from hystmpc.trials.errors import LogError

from .answer import Answer
from .reading import FAILED, Reading, read_diagnosis
from .run import BESIDE, DIAGNOSIS, FAILURE
from .sealed import open_answers

LARGE = 3.0
"""Gap in floors from which on the bars hold."""


@dataclass(frozen=True)
class Scored:
    """One case.

    Attributes:
        name: of its folder.
        answer: the truth.
        reading: the blind diagnosis.
        followed: the diagnosis after the proposed motion was recorded, if it was.
        oracle: closed share of a diagnosis that was told the classes, if one was made.
        seconds: that the diagnosis took, if known.
        again: share that the causes close in another session of the device, if it had one.
    """

    name: str
    answer: Answer
    reading: Reading
    followed: Reading | None = None
    oracle: float | None = None
    seconds: float | None = None
    again: float | None = None

    @property
    def right(self) -> bool:
        """Whether the verdict is right.

        With nothing to find: `none`. With a foreign cause: `unknown` or `too_little`. Else the first name is the
        largest cause, or either of a pair; on motions that cannot tell it from its twins, leaving it open or
        `too_little` is right too.
        """
        truth, said = self.answer.truth, self.reading
        if truth == "none":
            return said.verdict == "none"
        if truth == "unknown":
            return said.verdict in ("unknown", "too_little")
        if said.guess == truth or said.guess in self.answer.labels:
            return True
        return not self.answer.separable and (
            said.verdict == "too_little" or (bool(said.claims) and said.may_be(truth))
        )

    @property
    def right_family(self) -> bool:
        """Whether the verdict is right, or names a twin of the truth."""
        return self.right or confusable(self.reading.guess, self.answer.truth)


def load_scored(folder: Path, partial: bool = False) -> list[Scored]:
    """Open the answers and set the diagnoses beside them.

    Args:
        folder: of the blind check, with its diagnoses.
        partial: leave out cases without a diagnosis instead of refusing.

    Raises:
        LogError: if the answers are not those sealed, a diagnosis is damaged, or one is missing.
    """
    answers = open_answers(folder)
    done = {name: folder / "diagnoses" / name for name in answers}
    missing = [n for n, path in done.items() if not any((path / f).is_file() for f in (DIAGNOSIS, FAILURE))]
    if missing and not partial:
        raise LogError(
            f"{folder}: {len(missing)} of {len(answers)} cases have no diagnosis (first: {missing[0]}), expected all; "
            "`hystmpc gap blind run` makes them"
        )
    found = [_one(folder, name, answers[name]) for name in answers if name not in missing]
    if not found:
        raise LogError(f"{folder}: no case has a diagnosis, expected at least one")
    return found


def _one(folder: Path, name: str, answer: Answer) -> Scored:
    path, seconds, again = folder / "diagnoses" / name, None, None
    others: dict[str, str] = {}
    if not (path / DIAGNOSIS).is_file():
        return Scored(name, answer, Reading(FAILED))
    if (path / BESIDE).is_file():
        beside = json.loads((path / BESIDE).read_text(encoding="utf-8"))
        seconds, others, again = beside.get("seconds"), beside.get("others", {}), beside.get("closed_again")
    followed = folder / "follow_up_diagnoses" / name / DIAGNOSIS
    oracle = folder / "oracle" / name / DIAGNOSIS
    return Scored(
        name,
        answer,
        read_diagnosis(path / DIAGNOSIS, others),
        read_diagnosis(followed) if followed.is_file() else None,
        read_diagnosis(oracle).closed_share if oracle.is_file() else None,
        seconds,
        again,
    )


def of_suites(cases: Sequence[Scored], *suites: str) -> list[Scored]:
    """Cases of some suites."""
    return [case for case in cases if case.answer.suite in suites]


def large(cases: Sequence[Scored]) -> list[Scored]:
    """Cases whose largest cause leaves a gap of `LARGE` floors or more."""
    return [case for case in cases if case.answer.ratio >= LARGE]
