"""What of a finished study of S2 is compared: models trained and tested on one motion, in one direction."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hystmpc.trials.types import Vec

from ..statistics import SignedRank, pairwise
from .outcome import Outcome
from .result import JobResult
from .s2_plan import MOTIONS, split_tested_on

MOTION_NAMES = {"sin": "sinusoids", "p2p": "point-to-point"}
UNITS = {"forward": "deg", "inverse": "mm"}
BASELINE = "fnn"


@dataclass(frozen=True, eq=False)
class Matched:
    """The models that were trained and tested on one motion, in one direction, with one preset.

    Attributes:
        outcome: of the study.
        motion, direction, preset: which.
    """

    outcome: Outcome
    motion: str
    direction: str
    preset: str

    @cached_property
    def results(self) -> dict[str, JobResult]:
        """The better of both betas, by kind."""
        wanted = {"stage": "main", "direction": self.direction, "preset": self.preset, "train": self.motion}
        split = [split_tested_on(self.motion)]
        found = {kind: self.outcome.better(split, kind=kind, **wanted) for kind in self.outcome.kinds}
        return {kind: result for kind, result in found.items() if result is not None}

    def errors(self, kind: str, name: str = "rmse_deg") -> Vec:
        """One figure a test trial (N,)."""
        return self.results[kind].figures(name, [split_tested_on(self.motion)])

    def other_betas(self, kind: str) -> str:
        """Mean RMSE of the models that were not chosen, as text."""
        chosen, split = self.results[kind], [split_tested_on(self.motion)]
        wanted = {"stage": "main", "kind": kind, "direction": self.direction, "preset": self.preset}
        others = [r for r in self.outcome.matching(train=self.motion, **wanted) if r is not chosen]
        means = [f"{np.mean(r.figures('rmse_deg', split)):.4g} (beta {r.job.constancy:g})" for r in others]
        return ", ".join(means) or "-"

    @property
    def tests(self) -> tuple[SignedRank, ...]:
        """Signed-rank tests of the RMSE, models in the order of the paper's table."""
        return pairwise({kind: self.errors(kind) for kind in self.results})

    @property
    def suffix(self) -> str:
        """End of a table's name."""
        return f"{self.direction}_{self.motion}_{self.preset}"

    @property
    def where(self) -> str:
        """For captions."""
        return f"{self.direction} map, {MOTION_NAMES[self.motion]}, preset {self.preset}"


def matched(outcome: Outcome) -> list[Matched]:
    """Every combination that has results."""
    views = [
        Matched(outcome, motion, direction, preset)
        for preset in outcome.presets
        for direction in outcome.settings.directions
        for motion in MOTIONS
    ]
    return [view for view in views if view.results]
