"""Statements of a diagnosis in the form used by the score, and the cases with their answers."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hystmpc.gap.residual import MOTION_PARTS
from hystmpc.trials.errors import LogError

from .generators import CONFIGURATION
from .run import BESIDE, DIAGNOSIS, FAILURE, ORDERS
from .sealed import DENSE, Answer, open_answers

VERDICTS = ("named", "one_of", "retuned", "unknown", "none", "too_little")
FAILED = "failed"
TRIAL = re.compile(r"trial_(\d+)")
"""Number of a trial in the name of its file."""
_DISTURBANCE, _CLAIMED = "periodic_disturbance", 0.3
LARGE = 3.0
"""Gap in floors from which on the bars hold."""


@dataclass(frozen=True)
class DiagnosisReading:
    """Statements of one diagnosis.

    Attributes:
        verdict: one of `VERDICTS`, or `failed` after an error.
        effects, probabilities: named effects, largest closed share first, since the truth's largest cause is required.
        ranking: names with probabilities, most likely first.
        closed_share, closed_ci90: of the whole gap, with its interval where given.
        floor_deg: origin of the closed share [deg], where given.
        densities: of the retuned error by region; None without a statement on that region.
        others: answers of simple rules, by name of the rule.
        final_trials: names of the trials on which the closed share was measured.
        groups: numbers of the trials of each configuration.
    """

    verdict: str
    effects: tuple[str, ...] = ()
    probabilities: tuple[float, ...] = ()
    ambiguity: tuple[frozenset[str], ...] = ()
    ranking: tuple[tuple[str, float], ...] = ()
    closed_share: float | None = None
    closed_ci90: tuple[float, float] | None = None
    floor_deg: float | None = None
    densities: Mapping[str, float] = field(default_factory=dict)
    others: Mapping[str, str] = field(default_factory=dict)
    final_trials: tuple[str, ...] = ()
    closed_shares: tuple[float, ...] = ()
    groups: tuple[frozenset[int], ...] = ()

    @property
    def claims(self) -> tuple[str, ...]:
        """Claimed names: none unless the verdict is `named` or `one_of`."""
        if self.verdict not in ("named", "one_of"):
            return ()
        if self.effects:
            return self.effects
        names = [name for name, _ in self.ranking] or sorted(name for group in self.ambiguity for name in group)
        return tuple(names[:1])

    @property
    def guess(self) -> str:
        """Best single answer: the first name, or the verdict."""
        claims = self.claims
        return claims[0] if claims else self.verdict

    @property
    def confidence(self) -> float:
        """Probability of the first name; 0 without a name."""
        if not self.claims:
            return 0.0
        if self.effects:
            return self.probabilities[0]
        return dict(self.ranking).get(self.guess, 0.0)

    def probability_of(self, name: str) -> float:
        """Greatest probability of a name, as an effect or in the ranking; 0 if it is in neither."""
        return max(
            (p for n, p in (*zip(self.effects, self.probabilities, strict=True), *self.ranking) if n == name),
            default=0.0,
        )

    def may_be(self, name: str) -> bool:
        """Whether `name` is possible: named, or in a set that is indistinguishable together with the named effects."""
        return name in self.claims or any(name in group for group in self.ambiguity)

    @property
    def dense_regions(self) -> frozenset[str]:
        """Regions in which the diagnosis locates the gap."""
        return frozenset(name for name, density in self.densities.items() if density >= DENSE)


def read_diagnosis(path: Path, others: Mapping[str, str] | None = None) -> DiagnosisReading:
    """Read `diagnosis.json`.

    Raises:
        LogError: if the file cannot be read, or lacks what its format promises.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        return reading_of(data, others)
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise LogError(f"{path}: not a diagnosis ({type(error).__name__}: {error})") from None


def reading_of(data: Mapping[str, Any], others: Mapping[str, str] | None = None) -> DiagnosisReading:
    """Extract the statements from the plain data of a diagnosis.

    Raises:
        ValueError: on an unknown verdict.
    """
    verdict = data["verdict"]
    if verdict not in VERDICTS:
        raise ValueError(f"verdict {verdict!r}, expected one of {', '.join(VERDICTS)}")
    effects, gap = sorted(data["effects"], key=lambda e: -float(e.get("closed_share") or 0.0)), data["gap"]
    interval = gap.get("closed_ci90")
    return DiagnosisReading(
        verdict,
        tuple(str(e["name"]) for e in effects),
        tuple(float(e["probability"]) for e in effects),
        tuple(frozenset(map(str, group)) for group in data["ambiguity"]),
        tuple((str(name), float(probability)) for name, probability in data["ranking"]),
        float(gap["closed_share"]) if gap.get("closed_share") is not None else None,
        (float(interval[0]), float(interval[1])) if interval else None,
        float(gap["floor_rmse_deg"]) if gap.get("floor_rmse_deg") is not None else None,
        {name: float(place["density"]) for name, place in data["where"].items() if name in MOTION_PARTS},
        {**data.get("baselines", {}), **(others or {})},
        tuple(str(name) for name in gap.get("final_trials", ())),
        tuple(float(e.get("closed_share", 0.0)) for e in effects),
        tuple(_numbers(names) for names in data.get("groups", ())),
    )


def _numbers(names: Sequence[str]) -> frozenset[int]:
    return frozenset(int(found.group(1)) for name in names if (found := TRIAL.search(name)))


@dataclass(frozen=True)
class ScoredCase:
    """One case with its answer and its diagnoses.

    Attributes:
        followed: the diagnosis after the proposed motion was recorded, if any.
        oracle: closed share of a diagnosis that was given the classes, if any.
        again: closed share of the causes in another session of the device, if any.
        confirmed: closed share of each replayed effect, as said and as the user's own simulator confirms it.
        orders: names in each other order of the files, if any.
    """

    name: str
    answer: Answer
    reading: DiagnosisReading
    followed: DiagnosisReading | None = None
    oracle: float | None = None
    seconds: float | None = None
    again: float | None = None
    confirmed: tuple[tuple[float, float], ...] = ()
    orders: tuple[frozenset[str], ...] = ()

    @property
    def right(self) -> bool:
        """Whether the verdict is right.

        With nothing to find: `none`, or `retuned`, as devices are off their nominal numbers. With a foreign cause:
        `unknown` or `too_little`. Else the first name is the largest cause, or either of a pair; on motions that do not
        separate it from its confounders, leaving it open or `too_little` is right too. A change of configuration needs
        its groups beside its name. Of an aliased case anything is right but a periodic disturbance above 0.3.
        """
        truth, said = self.answer.truth, self.reading
        if self.answer.suite == "aliased":
            return said.verdict != FAILED and said.probability_of(_DISTURBANCE) <= _CLAIMED
        if self.answer.suite == "configuration":
            return said.guess == CONFIGURATION and set(said.groups) == self._groups()
        if truth == "none":
            return said.verdict in ("none", "retuned")
        if truth == "unknown":
            return said.verdict in ("unknown", "too_little")
        if said.guess == truth or said.guess in self.answer.labels:
            return True
        return not self.answer.separable and (
            said.verdict == "too_little" or (bool(said.claims) and said.may_be(truth))
        )

    def _groups(self) -> set[frozenset[int]]:
        told, second = frozenset[int]().union(*self.reading.groups), frozenset(self.answer.second)
        return {told - second, told & second}


def load_scored(folder: Path, partial: bool = False) -> list[ScoredCase]:
    """Read the diagnoses with their opened answers.

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


def _one(folder: Path, name: str, answer: Answer) -> ScoredCase:
    path, beside = folder / "diagnoses" / name, dict[str, Any]()
    if not (path / DIAGNOSIS).is_file():
        return ScoredCase(name, answer, DiagnosisReading(FAILED))
    if (path / BESIDE).is_file():
        beside = json.loads((path / BESIDE).read_text(encoding="utf-8"))
    followed = folder / "follow_up_diagnoses" / name / DIAGNOSIS
    oracle = folder / "oracle" / name / DIAGNOSIS
    return ScoredCase(
        name,
        answer,
        read_diagnosis(path / DIAGNOSIS, beside.get("others", {})),
        read_diagnosis(followed) if followed.is_file() else None,
        read_diagnosis(oracle).closed_share if oracle.is_file() else None,
        beside.get("seconds"),
        beside.get("closed_again"),
        tuple((said, confirmed) for said, confirmed in beside.get("confirmed", ())),
        orders_said(folder, name),
    )


def orders_said(folder: Path, name: str) -> tuple[frozenset[str], ...]:
    """Names given for a case in each other order of its files."""
    return tuple(frozenset(read_diagnosis(p).claims) for p in sorted((folder / ORDERS).glob(f"*/{name}/{DIAGNOSIS}")))


def of_suites(cases: Sequence[ScoredCase], *suites: str) -> list[ScoredCase]:
    """Cases of the given suites."""
    return [case for case in cases if case.answer.suite in suites]


def large(cases: Sequence[ScoredCase]) -> list[ScoredCase]:
    """Cases whose largest cause leaves a gap of `LARGE` floors or more."""
    return [case for case in cases if case.answer.ratio >= LARGE]
