"""A round's verdict on all trials so far, what is open after it, and whether the investigation ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from hystmpc.commissioning.stages import Figure
from hystmpc.gap.diagnose import diagnose_trials
from hystmpc.gap.diagnosis import Diagnosis, Verdict
from hystmpc.gap.next.open_hypotheses import discrimination_task
from hystmpc.gap.report.words import closed_sentence, headline, tracking_sentence
from hystmpc.models.simulator import load_simulator
from hystmpc.trials.read import read_trials
from hystmpc.trials.types import Progress

from .config import InvestigateSettings
from .plan import Plan, least_seconds, plan_more, plan_next

Ending = Literal["", "named", "no_gap", "nothing_gained", "budget"]
DIAGNOSIS = "diagnosis"
_SURE = 2  # rounds in a row that name the same single effect
_STUCK = 4  # rounds in a row with the same result, from which on no motion is designed
_LONGER = 2
_OPEN = ("unknown", "one_of", "too_little")
_NO_GAP = ("none", "retuned")  # nothing is missing in the simulator, whatever its numbers
_STABLE = 3  # rounds in a row that name several: they may mend the simulator's form
_MOST_OF_IT = 0.5  # of the structural gap: a name that leaves more of it than it closes is not the whole answer


@dataclass(frozen=True)
class Judged:
    """What a diagnosis of all trials so far says.

    Attributes:
        verdict, effects, ambiguity, reason: of the diagnosis; effects by name, the most probable first.
        headline, closed: the verdict, and in words the closed share and the tracking error that is expected.
        probability: of the first effect; NaN without one.
        closed_share: of the structural gap on the final trials.
        flips: whether verdict and names come out on too few other splits of the trials.
        retuned_deg, left_deg: RMSE on the final trials without and with the effects [deg].
        trials: that were diagnosed.
        next: motions of the next round; None where the investigation ends.
        ended: why it ends, empty where it goes on.
        why: that in one sentence.
    """

    verdict: Verdict
    effects: tuple[str, ...]
    ambiguity: tuple[tuple[str, ...], ...]
    reason: str
    headline: str
    closed: str
    probability: Figure
    closed_share: Figure
    retuned_deg: Figure
    left_deg: Figure
    trials: int
    flips: bool = False
    next: Plan | None = None
    ended: Ending = ""
    why: str = ""

    @property
    def result(self) -> tuple[str, frozenset[str], frozenset[frozenset[str]]]:
        """Verdict, names and sets that could not be told apart: what has to stay the same.

        Without a gap it is the same whether numbers have moved: that is a matter of size.
        """
        verdict = _NO_GAP[0] if self.verdict in _NO_GAP else self.verdict
        return verdict, frozenset(self.effects), frozenset(frozenset(names) for names in self.ambiguity)


def judge(
    settings: InvestigateSettings,
    model: Path,
    files: Sequence[Path],
    before: Sequence[Judged],
    left_s: float,
    folder: Path,
    progress: Progress | None = None,
) -> Judged:
    """Diagnose all trials, write the diagnosis, and plan the next round where there is to be one.

    Args:
        model: simulator that is judged.
        files: recordings in their order.
        before: verdicts of earlier rounds.
        left_s: device time that is left [s].
        folder: of this stage.

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
    findings, judged = done.findings, judged_of(done.diagnosis, len(files))
    sought = judged.verdict in _OPEN or judged.verdict in _NO_GAP
    alike, number = _alike([*before, judged]), len(files) + 1
    longer = _LONGER ** (alike - 1) if sought else 1

    def planned() -> Plan | None:
        asked, recorded = discrimination_task(findings), {file.stem.partition("-")[2] for file in files}
        undecided = alike > 1  # the last motion was to decide, and did not
        if undecided and (more := plan_more(settings, simulator, left_s, number, recorded, asked, folder)):
            return more
        if asked is not None and alike < _STUCK:
            designed = plan_next(settings, asked, left_s, number, longer, folder)
            if designed is not None:
                return designed
        return None if undecided else plan_more(settings, simulator, left_s, number, recorded, asked, folder)

    return with_next(judged, before, planned, left_s, least_seconds(settings))


def judged_of(diagnosis: Diagnosis, trials: int) -> Judged:
    """A diagnosis as a round keeps it."""
    gap = diagnosis.gap
    return Judged(
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
    judged: Judged,
    before: Sequence[Judged],
    planned: Callable[[], Plan | None],
    left_s: float,
    least_s: float,
) -> Judged:
    """The verdict with what follows from it: an end and its reason, or the next round.

    Ends, in this order: the same effect named in two rounds in a row, or several in three, where they close at least
    half of the gap; no gap in four rounds in a row; too little device time for one more motion; no motion that tells
    enough. A verdict that flips between splits of the trials is not stable, however often it came.

    Args:
        before: verdicts of earlier rounds.
        planned: makes the plan of the next round; None where no motion tells enough.
        left_s: device time that is left [s].
        least_s: that the shortest round takes [s].
    """
    alike = _alike([*before, judged])
    names = " and ".join(name.replace("_", " ") for name in judged.effects)
    often = alike >= (_SURE if len(judged.effects) == 1 else _STABLE)
    if judged.verdict == "named" and often and not judged.flips and judged.closed_share >= _MOST_OF_IT:
        why = f"{names} named in {alike} rounds in a row, the last of which was to tell it from its neighbours"
        return replace(judged, ended="named", why=why)
    if judged.verdict in _NO_GAP and alike >= _STUCK and not judged.flips:
        moved = " with the simulator's numbers retuned" if judged.verdict == "retuned" else ""
        return replace(judged, ended="no_gap", why=f"no structural gap{moved} in {alike} rounds in a row")
    if left_s < least_s:
        why = f"{left_s:.0f} s of device time are left, one more motion takes {least_s:.0f} s or more"
        return replace(judged, ended="budget", why=why)
    plan = planned()
    if plan is None:
        why = "no motion within limits and device time is expected to tell more"
        if alike >= _STUCK:
            why = f"the same result in {alike} rounds in a row, and every kind of motion was recorded that is allowed"
        return replace(judged, ended="nothing_gained", why=why)
    return replace(judged, next=plan)


def _alike(verdicts: Sequence[Judged]) -> int:
    """How many of the last verdicts are equal."""
    count = 0
    for verdict in reversed(verdicts):
        if verdict.result != verdicts[-1].result:
            break
        count += 1
    return count
