"""A diagnosis as the score reads it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hystmpc.trials.errors import LogError

from .regions import DENSE, REGIONS

VERDICTS = ("named", "one_of", "unknown", "none", "too_little")
FAILED = "failed"


@dataclass(frozen=True)
class Reading:
    """What a diagnosis said.

    Attributes:
        verdict: one of `VERDICTS`, or `failed` where it ended with an error.
        effects: names in its order.
        probabilities: of these.
        ambiguity: sets of names that it cannot tell apart.
        ranking: names with probabilities, most likely first.
        closed_share, closed_ci90: of the whole gap, with its interval where given.
        floor_deg: that the closed share counts from [deg], where given.
        densities: of the retuned error by region; None where it says nothing of that region.
        others: guesses of rules beside it, by name of the rule.
        final_trials: names of the trials that the closed share was measured on.
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

    @property
    def claims(self) -> tuple[str, ...]:
        """Names that it puts forward: none unless the verdict is `named` or `one_of`."""
        if self.verdict not in ("named", "one_of"):
            return ()
        if self.effects:
            return self.effects
        names = [name for name, _ in self.ranking] or sorted(name for group in self.ambiguity for name in group)
        return tuple(names[:1])

    @property
    def guess(self) -> str:
        """Its best single answer: the first name, or the verdict."""
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

    def may_be(self, name: str) -> bool:
        """Whether it leaves `name` open: named, or in a set that it cannot tell apart together with what it named."""
        return name in self.claims or any(name in group for group in self.ambiguity)

    @property
    def dense_regions(self) -> frozenset[str]:
        """Regions in which it says that the gap lies."""
        return frozenset(name for name, density in self.densities.items() if density >= DENSE)


def read_diagnosis(path: Path, others: Mapping[str, str] | None = None) -> Reading:
    """Read `diagnosis.json`.

    Raises:
        LogError: if the file cannot be read, or lacks what its format promises.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        return reading_of(data, others)
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise LogError(f"{path}: not a diagnosis ({type(error).__name__}: {error})") from None


def reading_of(data: Mapping[str, Any], others: Mapping[str, str] | None = None) -> Reading:
    """What the plain data of a diagnosis say.

    Raises:
        ValueError: on an unknown verdict.
        KeyError: if a field is missing.
    """
    verdict = data["verdict"]
    if verdict not in VERDICTS:
        raise ValueError(f"verdict {verdict!r}, expected one of {', '.join(VERDICTS)}")
    effects, gap = data["effects"], data["gap"]
    interval = gap.get("closed_ci90")
    return Reading(
        verdict,
        tuple(str(e["name"]) for e in effects),
        tuple(float(e["probability"]) for e in effects),
        tuple(frozenset(map(str, group)) for group in data["ambiguity"]),
        tuple((str(name), float(probability)) for name, probability in data["ranking"]),
        float(gap["closed_share"]) if gap.get("closed_share") is not None else None,
        (float(interval[0]), float(interval[1])) if interval else None,
        float(gap["floor_rmse_deg"]) if gap.get("floor_rmse_deg") is not None else None,
        {name: float(place["density"]) for name, place in data["where"].items() if name in REGIONS},
        {**data.get("baselines", {}), **(others or {})},
        tuple(str(name) for name in gap.get("final_trials", ())),
    )
