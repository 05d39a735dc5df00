"""Data of the report, collected from the findings of a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from hystmpc.models.identify.cross_validation import gain
from hystmpc.models.identify.simulators import corrected_simulator, network_effects
from hystmpc.models.identify.uncertainty import ParameterRow
from hystmpc.models.simulator import Simulator
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..decide.attribution import Findings
from ..diagnosis import Diagnosis
from ..logs.excitation import Excitation
from ..next.motion_design import MotionProposal
from ..residual import Localisation

Role = Literal["fit", "select", "final"]
Side = Literal["command", "output", "sensor", "trial"]
Stage = Literal["nominal", "retuned", "with_effects"]
STAGES: tuple[Stage, ...] = ("nominal", "retuned", "with_effects")


@dataclass(frozen=True, eq=False)
class TrialRuns:
    """One trial with its free runs.

    Attributes:
        role: fit, select or final (evaluated once).
        nominal, retuned, with_effects: simulated angles [deg], (T,), of the simulator as given, refitted, and refitted
            with the chosen effects; without any the last equals the second.
        floor_deg: irreducible RMSE of any simulator [deg].
    """

    trial: Trial
    role: Role
    motion: str
    nominal: Vec
    retuned: Vec
    with_effects: Vec
    floor_deg: float
    start: int = 0

    @property
    def name(self) -> str:
        """Name of the log without its folder."""
        return Path(self.trial.source).name

    def residual(self, stage: Stage) -> Vec:
        """Simulated minus measured angle over the samples that count [deg]."""
        return np.asarray(getattr(self, stage) - self.trial.angle)[self.start :]

    def rmse(self, stage: Stage) -> float:
        """Root mean square of the residual over the samples that count [deg]."""
        return float(np.sqrt(np.mean(self.residual(stage) ** 2)))


@dataclass(frozen=True)
class CandidateRow:
    """One candidate effect, added alone to the retuned simulator.

    Attributes:
        rmse_deg: on the selection trials [deg].
        gain_deg: retuned RMSE minus this [deg]; negative if the effect raises the error.
        standard_error_deg: of the gain [deg].
    """

    name: str
    side: Side
    rmse_deg: float
    gain_deg: float
    standard_error_deg: float
    probability: float
    chosen: bool = False


@dataclass(frozen=True, eq=False)
class TrackingCurve:
    """One motion in closed loop, (N,) each, under the first seed of the noise.

    Attributes:
        t: end of the sample [s].
        reference_deg, before_deg, after_deg: reference, and the true angle before and after the correction [deg].
    """

    name: str
    t: Vec
    reference_deg: Vec
    before_deg: Vec
    after_deg: Vec
    first: int


@dataclass(frozen=True, eq=False)
class ReportData:
    """Data of the report of a diagnosis.

    Attributes:
        localisation: of the retuned residual; None without a residual.
        noise_deg: white noise of the measured angle [deg]; not-a-number if unknown.
        proposal: next motion to record; None if no hypothesis is open.
        fixed: the corrected simulator, if it can be written as one.
        curves: closed loops before and after the correction; empty if not simulated.
        replays: commands for the user's own simulator to play; their source is the name of the file.
    """

    diagnosis: Diagnosis
    simulator: str
    trials: tuple[TrialRuns, ...]
    excitation: Excitation
    candidates: tuple[CandidateRow, ...] = ()
    parameters: tuple[ParameterRow, ...] = ()
    localisation: Localisation | None = None
    noise_deg: float = math.nan
    proposal: MotionProposal | None = None
    fixed: Simulator | None = None
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    seed: int = 1
    seconds: Mapping[str, float] = field(default_factory=dict)
    nominal: Simulator | None = None
    curves: tuple[TrackingCurve, ...] = ()
    replays: tuple[Trial, ...] = ()

    @property
    def final(self) -> tuple[TrialRuns, ...]:
        """Final trials; all trials without such a split."""
        return tuple(trial for trial in self.trials if trial.role == "final") or self.trials

    @property
    def stages(self) -> tuple[Stage, ...]:
        """Distinct simulators; without a chosen effect the retuned one is the last."""
        return STAGES if self.diagnosis.effects else STAGES[:2]

    @property
    def measured_on(self) -> str:
        """Name of the trials in `final`: final trials, or all trials."""
        return "final trials" if any(trial.role == "final" for trial in self.trials) else "trials"

    @property
    def command_unit(self) -> str:
        """Unit of the command: mm, bar or another."""
        return self.trials[0].trial.units.command

    @property
    def unit(self) -> str:
        """Unit of the output: deg or another."""
        return self.trials[0].trial.units.angle


def report_data(
    findings: Findings, diagnosis: Diagnosis, proposal: MotionProposal | None, parameters: tuple[ParameterRow, ...]
) -> ReportData:
    """Collect the data of the report from the findings."""
    prepared, simulator = findings.prepared, findings.simulator
    files: Mapping[str, str] = {}
    if not isinstance(simulator, Simulator):
        dt, chosen, last = prepared.checked.dt, findings.conclusion.chosen, prepared.everything[-1]
        files = network_effects(chosen, prepared.baseline, last, dt, "the network", prepared.decades)
    return ReportData(
        diagnosis=diagnosis,
        simulator="simulator" if prepared.stand_in_rmse_deg is None else "of your own",
        trials=_trials(findings, diagnosis.gap.floor_rmse_deg),
        excitation=prepared.checked.excitation,
        candidates=_candidates(findings, diagnosis),
        parameters=parameters,
        localisation=findings.localisation,
        noise_deg=prepared.decades.angle * findings.conclusion.floor.noise_deg,
        proposal=proposal,
        fixed=_fixed(findings),
        nominal=simulator if isinstance(simulator, Simulator) else None,
        files=files,
        seed=findings.seed,
        seconds=findings.seconds,
    )


def _fixed(findings: Findings) -> Simulator | None:
    """Corrected simulator; None for a network, or if no angle follows its command."""
    simulator, prepared = findings.simulator, findings.prepared
    if prepared.checked.unrelated or not isinstance(simulator, Simulator):
        return None
    chosen, checked = findings.conclusion.chosen, prepared.checked
    return corrected_simulator(
        simulator,
        chosen,
        prepared.everything,
        prepared.development,
        checked.trials,
        prepared.checked.given,
        prepared.decades,
        skip_first_flexure=not all(run.counts.all() for run in prepared.counted),
    )


def _trials(findings: Findings, floor_deg: float) -> tuple[TrialRuns, ...]:
    """Every trial with its free runs; for a trial cut in parts, the final part counts."""
    prepared, conclusion = findings.prepared, findings.conclusion
    retuned, chosen = findings.attribution.retuned, conclusion.chosen
    final = {run.name: int(np.flatnonzero(run.counts)[0]) for run in prepared.final}
    made, unit = [], prepared.decades.angle
    motions, starts = prepared.checked.excitation.motions, [int(np.argmax(run.counts)) for run in prepared.counted]
    errors = chosen.held_out_errors(prepared.everything)
    trials = zip(prepared.checked.trials, prepared.everything, motions, starts, errors, strict=True)
    for trial, run, motion, start, error in trials:
        role: Role = "final" if run.name in final else "fit"
        made.append(
            TrialRuns(
                trial=trial,
                role=role,
                motion=motion,
                nominal=unit * retuned.problem.angles(retuned.problem.as_given, run),
                retuned=unit * retuned.angles(run),
                with_effects=unit * (run.angle + error),
                floor_deg=floor_deg,
                start=final.get(run.name, start),
            )
        )
    return tuple(made)


def _candidates(findings: Findings, diagnosis: Diagnosis) -> tuple[CandidateRow, ...]:
    selection, decades = findings.attribution.selection, findings.prepared.decades
    probabilities, before = dict(diagnosis.ranking), selection.baseline
    chosen, retuned = {effect.name for effect in diagnosis.effects}, float(np.sqrt(before.mse))
    rows = []
    alone = [(min(names), judged) for names, judged in selection.tried.items() if len(names) == 1]
    for name, after in alone:
        (_, error), rmse = gain(before, after), float(np.sqrt(after.mse))
        effects = after.hypothesis.problem.effects
        side: Side = effects[0].side if effects else "trial"
        sizes = rmse, retuned - rmse, error / (rmse + retuned)
        row = CandidateRow(name, side, *sizes, probabilities.get(name, 0.0), name in chosen)
        rows.append(decades.log_sizes(row))
    for effect in diagnosis.effects:
        if effect.name == "sensor":
            mended = decades.angle * retuned
            raw = diagnosis.gap.retuned_rmse_deg
            rows.append(CandidateRow("sensor", "sensor", mended, raw - mended, 0.0, effect.probability, True))
    return tuple(sorted(rows, key=lambda row: (-row.probability, row.rmse_deg)))
