"""Hand-made evidence of every verdict, on a device that creeps."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from hystmpc.ctrl.command import CommandLimits
from hystmpc.gap.diagnosis import (
    Detectable,
    DetectableSizes,
    Diagnosis,
    Gap,
    IdentifiedEffect,
    NextMotion,
    ResidualShare,
    RetunedParameter,
    Stability,
    Verdict,
)
from hystmpc.gap.logs.excitation import excitation_of
from hystmpc.gap.next.motion_design import MotionProposal, Noise, propose
from hystmpc.gap.next.motions import menu
from hystmpc.gap.report.report_data import CandidateRow, ReportData, Role, TrialRuns
from hystmpc.gap.residual import localise
from hystmpc.models.identify.uncertainty import ParameterRow
from hystmpc.trials.trial import Trial

from ..models.zoo import CHAINS, simulator
from .contenders import CREEP, DELAY, LAG, angle, baseline, creep

DT = 0.04
VERDICTS: tuple[Verdict, ...] = ("named", "one_of", "retuned", "unknown", "none", "too_little")
REASON = {
    "named": "Creep explains the gap: probability 93 %, and the held-out error falls by two thirds.",
    "one_of": "Lag and delay explain these trials equally well.",
    "retuned": "The same structure with other numbers explains the gap: gain 10.2 to 10.9 deg/mm.",
    "unknown": "A gap of 1.9 deg remains above the floor, and no effect of the library explains it.",
    "none": "Retuned, the simulator lies within the floor.",
    "too_little": "One sine of 10 s: too little to split, select and test.",
}
SIZES = DetectableSizes(
    0.33,
    (
        Detectable("lag", "tau_s", "s", 0.0277, 0.32),
        Detectable("drift", "offset_per_min", "deg/min", math.inf, math.nan, untestable=True),
        Detectable("creep", "share", "1", 0.068, 0.91),
    ),
)
_NAMES = ("creep", "drift", "lag", "delay", "first_flexure", "rate_dependence", "stick_slip", "slack")


def trial_evidence(k: int, role: Role, seconds: float = 30.0) -> TrialRuns:
    """One trial: steps and holds, or a decaying sine, of a device that creeps."""
    random, t = np.random.default_rng(k), np.arange(round(seconds / DT)) * DT
    if k % 2:
        motion, levels = "holds", random.uniform(0.5, 6.0, 8)
        command = np.interp(t, np.linspace(0, seconds, 17), np.r_[0, np.repeat(levels, 2)[:16]])
    else:
        motion = "sine"
        command = 3 * np.exp(-0.05 * t) * (1 - np.cos(2 * np.pi * (0.1 + 0.05 * (k % 3)) * t))
    truth = creep(0.18, 5.0)(command, DT)
    measured = truth + random.normal(0, 0.12, t.size)
    trial = Trial(t, command, measured, source=f"logs/day 2/{motion}_{k:02d}_{role}.csv")
    nominal = baseline(command, DT) * 0.93 + 2
    retuned = angle(0.88 * command) + 2.6
    return TrialRuns(trial, role, motion, nominal, retuned, creep(0.16, 4.6)(command, DT), 0.14)


def roles(count: int) -> list[Role]:
    """Fit, select and final in turns; one trial alone is for all of it."""
    cycle: tuple[Role, ...] = ("fit", "select", "final")
    return [cycle[k % 3] for k in range(count)] if count > 2 else ["fit"] * count


def gap_of(trials: tuple[TrialRuns, ...], closed: float) -> Gap:
    """Sizes from the trials themselves."""
    final = tuple(trial for trial in trials if trial.role == "final") or trials
    pooled = {s: float(np.sqrt(np.mean([t.rmse(s) ** 2 for t in final]))) for s in ("nominal", "retuned")}
    added = float(np.sqrt(np.mean([t.rmse("with_effects") ** 2 for t in final])))
    interval = (closed - 0.08, closed + 0.05)
    names = tuple(trial.name for trial in final)
    kind = "repeats" if len(trials) > 3 else "noise"
    return Gap(pooled["nominal"], pooled["retuned"], added, 0.14, kind, closed, 1 - closed, interval, names)


def effects_of(verdict: Verdict) -> tuple[IdentifiedEffect, ...]:
    """What was put into the simulator."""
    if verdict == "named":
        parameters = {"share": 0.16, "tau_s": 4.6}
        units = {"share": "1", "tau_s": "s"}
        return (IdentifiedEffect("creep", 0.93, 0.95, 0.71, (0.6, 0.8), 1.9, 0.6, parameters, units, ("tau_s",)),)
    if verdict == "one_of":
        return (IdentifiedEffect("lag", 0.48, 0.5, 0.8, (0.5, 0.9), 1.9, 0.7, {"tau_s": 0.1}, {"tau_s": "s"}),)
    return ()


def proposal_of(verdict: Verdict) -> MotionProposal | None:
    """What to record next."""
    if verdict in ("none", "retuned", "named"):
        return None
    pair = (LAG, DELAY) if verdict == "one_of" else (LAG, DELAY, CREEP)
    return propose(pair, menu(CommandLimits(0.0, 6.0, 12.0), DT), Noise(0.14))


def diagnosis_of(verdict: Verdict, trials: tuple[TrialRuns, ...], proposal: MotionProposal | None) -> Diagnosis:
    """A diagnosis of that verdict."""
    top = {"named": (0.93, 0.04), "one_of": (0.48, 0.46), "unknown": (0.2, 0.15), "none": (0.02, 0.01)}
    first, second = top.get(verdict, (0.0, 0.0))
    leading = ("lag", "delay") if verdict == "one_of" else ("creep", "drift")
    rest = [name for name in _NAMES if name not in leading]
    ranking = (*zip(leading, (first, second), strict=True), *((name, 0.01) for name in rest))
    closed = {"named": 0.9, "one_of": 0.8}.get(verdict, math.nan if verdict == "too_little" else 0.0)
    places = {
        "hold": ResidualShare(0.61, 2.1, (0.5, 0.7)),
        "loading": ResidualShare(0.2, 0.6, (0.13, 0.28)),
        "unloading": ResidualShare(0.15, 0.5, (0.1, 0.22)),
        "after_reversal": ResidualShare(0.04, 0.4, (0.01, 0.06)),
        "first_flexure": ResidualShare(0.09, 1.2, (0.02, 0.2)),
    }
    return Diagnosis(
        verdict,
        REASON[verdict],
        effects_of(verdict),
        (("lag", "delay"),) if verdict == "one_of" else (),
        () if verdict == "too_little" else ranking,
        gap_of(trials, closed),
        {"gain": (10.2, 10.9), "offset": (0.0, 2.6)},
        {} if verdict == "too_little" else places,
        ("Sampled at 25 Hz without gaps.", "No hold is longer than 10 s: drift and creep cannot be told apart."),
        None if proposal is None else NextMotion(**vars(proposal.summary())),
        stability=None if verdict == "too_little" else Stability(0.9, 20, (("unknown", 0.1),)),
        explainable_share=0.93 if verdict == "named" else None,
        moved=(RetunedParameter("gain", "deg/mm", 10.2, 10.9, (10.8, 11.0)),) if verdict == "retuned" else (),
        detectable=SIZES if len(trials) > 1 else DetectableSizes(math.nan, why_not="The least sizes are not computed."),
    )


@cache
def report_data(verdict: Verdict, count: int = 6) -> ReportData:
    """A whole body of evidence."""
    trials = tuple(trial_evidence(k, role) for k, role in enumerate(roles(count)))
    proposal = proposal_of(verdict)
    diagnosis = diagnosis_of(verdict, trials, proposal)
    chosen = {effect.name for effect in diagnosis.effects}
    excitation = excitation_of([trial.trial for trial in trials])
    return ReportData(
        diagnosis,
        "sim.yaml",
        trials,
        excitation,
        tuple(
            CandidateRow(name, "command", 1.9 - 0.15 * (7 - k), 0.15 * (6 - k), 0.08, p, name in chosen)
            for k, (name, p) in enumerate(diagnosis.ranking)
        ),
        (
            ParameterRow("baseline", "gain", 9.95, (-162.0, 182.0), flat=True, unit="deg/mm"),
            ParameterRow("creep", "share", 0.16, (0.12, 0.2), 0.0),
            ParameterRow("creep", "tau_s", 4.6, (2.0, 30.0), None, at_bound=True, flat=True, unit="s"),
        ),
        localise([t.trial for t in trials], [t.trial.angle - t.retuned for t in trials], 0.6),
        0.12,
        proposal,
        simulator(CHAINS["pi"]),
        {"effects.txt": "creep\n"},
        seconds={"check": 0.2, "which": 8.1},
    )
