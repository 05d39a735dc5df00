"""The tracking gap of a diagnosis: motions within what its trials covered, or why nothing can be said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hystmpc.models.simulator import Simulator
from hystmpc.trajectories.drawn import CountedMotion, drawn_motions
from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.types import Progress

from ..diagnosis import FLIPS, Diagnosis, TrackingGap
from ..report.report_data import Evidence, TrackingCurve, TrialEvidence
from .expected import SEEDS, UnexplainedPlant, expected_tracking

SCANS_HZ = {"scan": 0.2}
LEAST_CLOSED = 0.8
"""Share of the structural gap that has to be closed; with more left open a loop can do what no simulation shows."""

_MOVES = 3
_COVERED = (0.02, 0.98)  # quantiles of the simulated angles: what was reached by accident is no motion
_FASTEST, _SPEED_SHARE = 0.99, 0.5  # quantile of the simulated speed, and how much of it a reference takes
_FAST_DT_S = 0.019  # below it a second seed would take too long


def with_tracking(evidence: Evidence, progress: Progress | None = None) -> Evidence:
    """The evidence, and its diagnosis, with the expected fall of the closed-loop tracking error.

    References are drawn from the seed of the diagnosis. They stay within the angles that the trials covered, as the
    simulator with its effects has them, and within half of the greatest speed there.

    Args:
        progress: called as the step begins and as it ends.
    """
    told = progress or _untold
    told(98, 100, "closed loop before and after")
    curves: tuple[TrackingCurve, ...] = ()
    why_not = _why_not(evidence)
    found = TrackingGap(why_not=why_not)
    if not why_not and evidence.nominal is not None and evidence.fixed is not None:
        seeds = SEEDS if evidence.nominal.dt_s > _FAST_DT_S else SEEDS[:1]
        try:
            motions = covered_motions(evidence.trials, evidence.fixed, evidence.seed)
            found, curves = expected_tracking(
                evidence.nominal, evidence.fixed, motions, seeds=seeds, floor_deg=evidence.diagnosis.gap.floor_rmse_deg
            )
        except HystmpcError as error:
            found = TrackingGap(why_not=f"the closed loop could not be simulated ({error})")
    told(100, 100, evidence.diagnosis.verdict)
    return replace(evidence, diagnosis=replace(evidence.diagnosis, tracking=found), curves=curves)


def _untold(done: float, total: float, note: str = "", /) -> None:
    """No progress is shown."""


def covered_motions(trials: Sequence[TrialEvidence], fixed: Simulator, seed: int) -> tuple[CountedMotion, ...]:
    """Point to point with holds and a scan, within the angles and half of the speed that the trials covered.

    Raises:
        TrajectoryError: if the angle hardly moved in the trials.
    """
    angles = [trial.with_effects for trial in trials]
    low, high = np.quantile(np.concatenate(angles), _COVERED)
    speeds = [np.abs(np.diff(trial.with_effects)) / trial.trial.dt for trial in trials]
    speed = _SPEED_SHARE * float(np.quantile(np.concatenate(speeds), _FASTEST))
    rest = UnexplainedPlant(fixed, seed).true_angle
    random = np.random.default_rng([seed, 3])
    return drawn_motions(random, rest, (float(low), float(high)), speed, SCANS_HZ, moves=_MOVES)


def _why_not(evidence: Evidence) -> str:
    """Why no fall can be said, in one sentence; empty where it can."""
    diagnosis: Diagnosis = evidence.diagnosis
    if evidence.unit != "deg":
        return f"the controllers follow angles in deg, and the output of this device is in {evidence.unit}"
    if evidence.nominal is None:
        return "the simulator is a network, of which a diagnosis makes no corrected simulator"
    if diagnosis.verdict == "too_little":
        return "these logs do not allow a diagnosis"
    if diagnosis.verdict == "unknown" or evidence.fixed is None:
        return "the gap has a cause that is not known, so that no simulator stands for the device"
    if diagnosis.relies_on_its_split:
        return FLIPS
    closed = diagnosis.gap.closed_share
    if diagnosis.verdict not in ("none", "retuned") and not closed >= LEAST_CLOSED:
        return (
            f"the corrected simulator closes {100 * closed:.0f} % of the structural gap, expected "
            f"{100 * LEAST_CLOSED:.0f} % or more for it to stand for the device in a closed loop"
        )
    return ""
