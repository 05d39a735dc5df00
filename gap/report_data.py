"""Everything behind a diagnosis, as its report shows it."""

from __future__ import annotations

import numpy as np

from hystmpc.models.identify.corrected_simulator import corrected_simulator, network_effects
from hystmpc.models.identify.cross_validation import HeldOutErrors, gain
from hystmpc.models.identify.uncertainty import parameter_rows
from hystmpc.models.simulator import Simulator

from .confusable import Confusable, confusability
from .diagnosis import Diagnosis
from .findings import Findings
from .memory import explainable_share
from .next_motion import Proposal
from .report.evidence import CandidateRow, Evidence, Role, Side, TrialEvidence


def report_data(findings: Findings, diagnosis: Diagnosis, proposal: Proposal | None) -> Evidence:
    """Put together what the report shows; see `Evidence`.

    Args:
        findings: of every step.
        diagnosis: made of them.
        proposal: what to record next, if anything.
    """
    prepared, simulator = findings.prepared, findings.simulator
    chain_based = isinstance(simulator, Simulator)
    rows = confusability(prepared.checked.excitation)
    return Evidence(
        diagnosis=diagnosis,
        simulator="simulator",
        trials=_trials(findings),
        excitation=prepared.checked.excitation,
        candidates=_candidates(findings, diagnosis),
        confusable=rows,
        parameters=parameter_rows(
            findings.chosen, prepared.development, {e.name: e.parameters for e in diagnosis.effects}
        ),
        localisation=findings.places,
        noise_deg=findings.floor.noise_deg,
        ceiling_share=_ceiling(findings),
        proposal=proposal,
        cannot_show=tuple(_sentence(row) for row in rows if not row.separable and not row.one_class),
        fixed=_fixed(findings),
        files={}
        if chain_based
        else network_effects(
            findings.chosen, prepared.baseline, prepared.everything[-1], prepared.checked.dt, "the network"
        ),
        seed=findings.seed,
        seconds=findings.seconds,
    )


def _fixed(findings: Findings) -> Simulator | None:
    """The corrected simulator; none of a network, and none from angles that do not follow their commands."""
    simulator, prepared = findings.simulator, findings.prepared
    if prepared.unrelated or not isinstance(simulator, Simulator):
        return None
    return corrected_simulator(
        simulator,
        findings.chosen,
        prepared.everything,
        prepared.development,
        prepared.checked.trials,
        prepared.given,
    )


def _sentence(row: Confusable) -> str:
    names = " and ".join(name.replace("_", " ") for name in row.effects)
    return f"{names[:1].upper()}{names[1:]} cannot be told apart ({row.found}); {row.separated_by} would do it."


def _trials(findings: Findings) -> tuple[TrialEvidence, ...]:
    """Every trial with its free runs; of one that is cut in parts, the part that counts at the end."""
    prepared, retuned, chosen = findings.prepared, findings.retuned, findings.chosen
    final = {run.name: int(np.flatnonzero(run.counts)[0]) for run in prepared.final}
    nominal_q = retuned.problem.start(prepared.baseline.nominal, [])
    made = []
    for trial, run, motion in zip(
        prepared.checked.trials, prepared.everything, prepared.checked.excitation.motions, strict=True
    ):
        role: Role = "final" if run.name in final else "fit"
        made.append(
            TrialEvidence(
                trial=trial,
                role=role,
                motion=motion,
                nominal=retuned.problem.angles(nominal_q, run),
                retuned=retuned.problem.angles(retuned.q, run),
                with_effects=run.angle + chosen.problem.held_out_error(chosen.q, run),
                floor_deg=findings.far.gap.floor_rmse_deg,
                start=final.get(run.name, 0),
            )
        )
    return tuple(made)


def _candidates(findings: Findings, diagnosis: Diagnosis) -> tuple[CandidateRow, ...]:
    """Each effect that was judged alone, and a faulty sensor."""
    sure, before = dict(diagnosis.ranking), findings.selection.baseline
    chosen = {effect.name for effect in diagnosis.effects}
    rows = [
        _row(name, before, judged, sure.get(name, 0.0), name in chosen)
        for names, judged in findings.selection.tried.items()
        if len(names) == 1
        for name in names
    ]
    for effect in diagnosis.effects:
        if effect.name == "sensor":
            mended = float(np.sqrt(before.mse))
            raw = diagnosis.gap.retuned_rmse_deg
            rows.append(CandidateRow("sensor", "sensor", mended, raw - mended, 0.0, effect.probability, True))
    return tuple(sorted(rows, key=lambda row: (-row.probability, row.rmse_deg)))


def _row(name: str, before: HeldOutErrors, after: HeldOutErrors, probability: float, chosen: bool) -> CandidateRow:
    _, error = gain(before, after)
    rmse, retuned = float(np.sqrt(after.mse)), float(np.sqrt(before.mse))
    effects = after.hypothesis.problem.effects
    side: Side = effects[0].side if effects else "trial"
    return CandidateRow(name, side, rmse, retuned - rmse, error / (rmse + retuned), probability, chosen)


def _ceiling(findings: Findings) -> float | None:
    """Share of the structural gap that a flexible model of the command's past explains held out; None without a gap."""
    prepared, retuned = findings.prepared, findings.retuned
    errors = [run.angle - retuned.problem.angles(retuned.q, run) for run in prepared.everything]
    mse = float(np.mean(np.concatenate(errors) ** 2))
    structural = mse - findings.far.gap.floor_rmse_deg**2
    if structural <= 0 or findings.ruling.verdict == "none":
        return None
    explained = explainable_share(prepared.checked.trials, errors, findings.seed) * mse
    return float(np.clip(explained / structural, 0.0, 1.0))
