"""Rounds of an investigation: recordings, verdict on all trials so far, and the rule for another round."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from hystmpc.gap.decide.attribution import Findings
from hystmpc.gap.diagnose import diagnose_trials
from hystmpc.gap.diagnosis import Diagnosis, Verdict
from hystmpc.gap.next.open_hypotheses import discrimination_task, within_one_sample
from hystmpc.gap.report.words import closed_sentence, headline, tracking_sentence
from hystmpc.models.simulator import load_simulator
from hystmpc.trials.brief import brief, in_brief
from hystmpc.trials.json_text import plain
from hystmpc.trials.read import read_trials
from hystmpc.trials.types import Progress

from .config import InvestigateSettings
from .round_plan import PlanePlan, RoundPlan, RoundPlanner, least_seconds
from .stages import DIAGNOSIS, Figure

Ending = Literal["", "named", "no_gap", "nothing_gained", "budget"]
FORMAT, PLANE_FORMAT = "hystmpc-investigation/1", "hystmpc-two-axis-investigation/1"
FIRST = "first"
"""Folder of the first motions."""

_SURE = 2  # rounds in a row that name the same single effect
_STUCK = 4  # rounds in a row with the same result, from which on no motion is designed
_LONGER = 2
_OPEN = ("unknown", "one_of", "too_little")
_NO_GAP = ("none", "retuned")  # nothing is missing in the simulator, whatever its numbers
_STABLE = 3  # rounds in a row that name several: they may mend the simulator's form
_MOST_OF_IT = 0.5  # of the structural gap: a name that leaves more of it than it closes is not the whole answer


@dataclass(frozen=True)
class RoundVerdict:
    """Verdict of a round: the diagnosis of all trials so far, and the decision on a further round."""

    verdict: Verdict
    effects: tuple[str, ...]  # names, the most probable first
    ambiguity: tuple[tuple[str, ...], ...]
    reason: str
    headline: str  # the verdict in words
    closed: str  # the closed share and the expected tracking error, in words
    probability: Figure  # of the first effect; NaN without one
    closed_share: Figure  # of the structural gap on the final trials
    retuned_deg: Figure  # RMSE on the final trials without the effects [deg]
    left_deg: Figure  # RMSE on the final trials with the effects [deg]
    trials: int
    flips: bool = False  # whether other splits of the trials give another verdict
    next: RoundPlan | None = None  # motions of the next round; None where the investigation ends
    ended: Ending = ""  # reason of the end; empty where it goes on
    why: str = ""  # the same in one sentence

    @property
    def result(self) -> tuple[str, frozenset[str], frozenset[frozenset[str]]]:
        """Verdict, effects and indistinguishable sets, for the comparison of rounds; `none` equals `retuned`."""
        verdict = _NO_GAP[0] if self.verdict in _NO_GAP else self.verdict
        return verdict, frozenset(self.effects), frozenset(frozenset(names) for names in self.ambiguity)

    def summary(self) -> dict[str, Any]:
        """Plain data of the verdict, as in `diagnosis.json`."""
        return {
            "verdict": self.verdict,
            "effects": list(self.effects),
            "ambiguity": [list(names) for names in self.ambiguity],
            "reason": self.reason,
        }


@dataclass(frozen=True)
class JoinVerdict:
    """Verdict of a round on what joins two axes.

    Attributes:
        effects: names of the effects between the axes.
        ambiguity: sets of effects that the recordings cannot tell apart.
        headline: the verdict in words.
        unclear: whether an effect that is not sure lowers the error.
        next: motion of both axes to record; empty where none follows.
        ended: reason of the end; empty where it goes on.
    """

    effects: tuple[str, ...]
    ambiguity: tuple[tuple[str, ...], ...]
    headline: str
    unclear: bool = False
    next: str = ""
    ended: Ending = ""
    why: str = ""

    @property
    def result(self) -> tuple[frozenset[str], frozenset[frozenset[str]], bool]:
        """Effects, indistinguishable sets and whether it is unclear, for the comparison of rounds."""
        return frozenset(self.effects), frozenset(frozenset(names) for names in self.ambiguity), self.unclear


@dataclass(frozen=True)
class PlaneVerdict:
    """Verdict of a round of two axes: what joins them, and each axis as a device of one."""

    joins: JoinVerdict
    x: RoundVerdict
    y: RoundVerdict
    trials: int
    next: PlanePlan | None = None  # motions of the next round; None where the investigation ends
    ended: Ending = ""  # reason of the end; empty where it goes on
    why: str = ""  # the same in one sentence

    @property
    def axes(self) -> tuple[RoundVerdict, RoundVerdict]:
        """Verdicts of x and of y."""
        return self.x, self.y

    @property
    def headline(self) -> str:
        """The three verdicts in words."""
        return f"{self.joins.headline}. Axis x: {self.x.headline}. Axis y: {self.y.headline}"

    @property
    def reason(self) -> str:
        """Reasons of the verdicts of both axes."""
        return f"x: {self.x.reason}; y: {self.y.reason}"

    @property
    def retuned_deg(self) -> float:
        """RMSE of the tip on the final trials without the effects of the axes, what joins them corrected [deg]."""
        return math.hypot(self.x.retuned_deg, self.y.retuned_deg)

    @property
    def left_deg(self) -> float:
        """RMSE of the tip on the final trials with all effects [deg]."""
        return math.hypot(self.x.left_deg, self.y.left_deg)

    def summary(self) -> dict[str, Any]:
        """Plain data of the three verdicts."""
        joins = {
            "effects": list(self.joins.effects),
            "ambiguity": [list(names) for names in self.joins.ambiguity],
            "headline": self.joins.headline,
        }
        return {"joins": joins, "x": self.x.summary(), "y": self.y.summary()}


@dataclass(frozen=True)
class RecordedRound:
    """Names of the played motions, and the device time used since the beginning [s]."""

    names: tuple[str, ...]
    device_s: Figure


@dataclass(frozen=True)
class Round:
    """One round of an investigation: number from 1, plan, recordings, verdict."""

    number: int
    plan: RoundPlan | PlanePlan
    recorded: RecordedRound
    judged: RoundVerdict | PlaneVerdict
    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Investigated:
    """Result of an investigation."""

    folder: Path
    rounds: tuple[Round, ...]
    ended: Ending  # reason of the end
    why: str  # the same in one sentence
    model: Path
    fixed: Path | None  # simulator corrected by the effects of the diagnosis; None where there is none
    report: Path
    device_s: float  # device time used, interrupted motions included [s]
    budget_s: float  # device time allowed [s]

    def __repr__(self) -> str:
        last = self.verdict
        said = last.verdict if isinstance(last, RoundVerdict) else f"{last.x.verdict}, {last.y.verdict}"
        return in_brief(self, f"{said} after {len(self.rounds)} rounds, {self.device_s:.4g} s: {last.reason}")

    @property
    def verdict(self) -> RoundVerdict | PlaneVerdict:
        """Verdict of the last round."""
        return self.rounds[-1].judged

    def as_json(self) -> dict[str, Any]:
        """Plain data of the format `hystmpc-investigation/1`, or `hystmpc-two-axis-investigation/1`."""
        last = self.verdict
        return {
            "format": FORMAT if isinstance(last, RoundVerdict) else PLANE_FORMAT,
            **last.summary(),
            "ended": self.ended,
            "why": self.why,
            "device_s": round(self.device_s, 3),
            "budget_s": self.budget_s,
            "model": str(self.model),
            "corrected": None if self.fixed is None else self.fixed.relative_to(self.folder).as_posix(),
            "diagnosis": f"{round_folder(self.folder, len(self.rounds)).name}/diagnose/{DIAGNOSIS}",
            "rounds": plain([asdict(one) for one in self.rounds]),
        }


def round_folder(root: Path, number: int) -> Path:
    """Folder of a round."""
    return root / f"round-{number}"


def judge_round(
    settings: InvestigateSettings,
    model: Path,
    files: Sequence[Path],
    before: Sequence[RoundVerdict],
    left_s: float,
    folder: Path,
    progress: Progress | None = None,
) -> RoundVerdict:
    """Diagnose all trials, write the diagnosis, and plan the next round where one follows.

    Args:
        left_s: device time left [s].

    Raises:
        GapError: if the recordings cannot be compared with the simulator.
        KeyboardInterrupt: if the user ended it; nothing of this stage is kept.
    """
    seed = settings.investigate.seed
    simulator = load_simulator(model)
    done = diagnose_trials(
        read_trials(files),
        simulator,
        out=folder / DIAGNOSIS,
        called={"sim": str(model)},
        model=model,
        seed=seed,
        progress=progress,
    )
    judged = round_verdict(done.diagnosis, len(files))
    planner = RoundPlanner(settings, simulator, left_s, folder)
    recorded = {file.stem.partition("-")[2] for file in files}
    least_s = least_seconds(settings)
    return judged_next(planner, done.findings, judged, before, len(files) + 1, recorded, left_s, least_s)


def judged_next(
    planner: RoundPlanner,
    findings: Findings,
    judged: RoundVerdict,
    before: Sequence[RoundVerdict],
    number: int,
    recorded: Collection[str],
    left_s: float,
    least_s: float,
) -> RoundVerdict:
    """Add its consequence to a verdict, see `with_next`.

    Args:
        planner: of the next motion, within the device time left.
        number: of the recording of that motion.
        recorded: kinds of motion that were recorded.
        left_s, least_s: device time left, and that of the shortest round [s].
    """
    sought = judged.verdict in _OPEN or judged.verdict in _NO_GAP
    repeats = _equal_count([*before, judged])
    longer = _LONGER ** (repeats - 1) if sought else 1

    def planned() -> RoundPlan | None:
        if within_one_sample(findings) and repeats > 1:
            return None
        question = discrimination_task(findings)
        undecided = repeats > 1  # the last motion was to decide, and did not
        if undecided and (further := planner.further(question, number, recorded)):
            return further
        if question is not None and repeats < _STUCK:
            designed = planner.designed(question, number, longer)
            if designed is not None:
                return designed
        return None if undecided else planner.further(question, number, recorded)

    return with_next(judged, before, planned, left_s, least_s)


def round_verdict(diagnosis: Diagnosis, trials: int) -> RoundVerdict:
    """What one round of recordings has shown, by its diagnosis."""
    gap = diagnosis.gap
    return RoundVerdict(
        verdict=diagnosis.verdict,
        effects=tuple(effect.name for effect in diagnosis.effects),
        ambiguity=diagnosis.ambiguity,
        reason=diagnosis.reason,
        headline=headline(diagnosis),
        closed=" ".join(filter(None, (closed_sentence(diagnosis), tracking_sentence(diagnosis)))),
        probability=diagnosis.effects[0].probability if diagnosis.effects else float("nan"),
        closed_share=gap.closed_share,
        retuned_deg=gap.retuned_rmse_deg,
        left_deg=gap.with_effects_rmse_deg,
        trials=trials,
        flips=diagnosis.stability is not None and diagnosis.stability.flips,
    )


def with_next(
    judged: RoundVerdict,
    before: Sequence[RoundVerdict],
    planned: Callable[[], RoundPlan | None],
    left_s: float,
    least_s: float,
) -> RoundVerdict:
    """Add the consequence to a verdict: the end of the investigation and its reason, or the next round.

    Ends, in this order: the same effect named in two rounds in a row, or several in three, where they close at least
    half of the gap; no gap in four rounds in a row; too little device time for one more motion; no informative motion.
    A verdict that flips between splits of the trials is not stable, whatever its count.

    Args:
        planned: makes the plan of the next round; None where no motion is informative enough.
        left_s, least_s: device time left, and that of the shortest round [s].
    """
    repeats = _equal_count([*before, judged])
    names = " and ".join(name.replace("_", " ") for name in judged.effects)
    often = repeats >= (_SURE if len(judged.effects) == 1 else _STABLE)
    if judged.verdict == "named" and often and not judged.flips and judged.closed_share >= _MOST_OF_IT:
        why = f"{names} named in {repeats} rounds in a row, the last of which was to tell it from its neighbours"
        return replace(judged, ended="named", why=why)
    if judged.verdict in _NO_GAP and repeats >= _STUCK and not judged.flips:
        moved = " with the simulator's numbers retuned" if judged.verdict == "retuned" else ""
        return replace(judged, ended="no_gap", why=f"no structural gap{moved} in {repeats} rounds in a row")
    if left_s < least_s:
        why = f"{left_s:.0f} s of device time are left, one more motion takes {least_s:.0f} s or more"
        return replace(judged, ended="budget", why=why)
    plan = planned()
    if plan is None:
        why = "no motion within limits and device time is expected to tell more"
        if repeats >= _STUCK:
            why = f"the same result in {repeats} rounds in a row, and every kind of motion was recorded that is allowed"
        return replace(judged, ended="nothing_gained", why=why)
    return replace(judged, next=plan)


def _equal_count(verdicts: Sequence[RoundVerdict]) -> int:
    """Number of last verdicts with the same result."""
    count = 0
    for verdict in reversed(verdicts):
        if verdict.result != verdicts[-1].result:
            break
        count += 1
    return count
