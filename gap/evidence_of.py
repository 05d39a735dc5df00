"""Everything behind a diagnosis, as its report shows it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.contract.load import OnnxModel
from hystmpc.models.simulator import Simulator

from .confusable import confusability
from .diagnosis import Diagnosis
from .hypothesis import Hypothesis, Judged, gain
from .next_motion import Proposal
from .preparation import Prepared
from .report.evidence import CandidateRow, Evidence, ParameterRow, Side, TrialEvidence
from .select import Selection
from .where import Localisation

Vec = NDArray[np.float64]
_AT_BOUND = 1e-3


def evidence_of(
    prepared: Prepared,
    selection: Selection,
    retuned: Hypothesis,
    chosen: Hypothesis,
    diagnosis: Diagnosis,
    places: Localisation | None,
    proposal: Proposal | None,
    simulator: Simulator | OnnxModel,
    seed: int,
    seconds: float,
) -> Evidence:
    """Put together what the report shows; see `Evidence`."""
    sure = dict(diagnosis.ranking)
    rows = confusability(prepared.checked.excitation)
    return Evidence(
        diagnosis=diagnosis,
        simulator="simulator",
        trials=_trials(prepared, retuned, chosen, diagnosis.gap.floor_rmse_deg),
        excitation=prepared.checked.excitation,
        candidates=_candidates(selection, chosen, sure),
        confusable=rows,
        parameters=_parameters(chosen),
        proposal=proposal,
        cannot_show=tuple(
            f"{' and '.join(row.effects)}: {row.found}; {row.separated_by} would tell them apart"
            for row in rows
            if not row.separable and not row.one_class
        ),
        fixed=fixed_simulator(simulator, chosen, prepared) if isinstance(simulator, Simulator) else None,
        seed=seed,
        seconds={"diagnosis": seconds},
        **_localised(prepared, places),
    )


def fixed_simulator(simulator: Simulator, chosen: Hypothesis, prepared: Prepared) -> Simulator:
    """The simulator retuned and with its causes; its residuals are those on the development trials."""
    chain = chosen.problem.fitted_chain(chosen.q)
    note = f"{simulator.identification.method}; diagnosed: {chosen.label}"
    identification = replace_model(simulator, note)
    del prepared
    return replace(simulator, chain=chain, identification=identification)


def replace_model(simulator: Simulator, note: str) -> object:
    """The identification of a simulator with a note and without residuals, which were another chain's."""
    return simulator.identification.model_copy(update={"method": note, "residuals": (), "training_data_hash": ""})


def _trials(prepared: Prepared, retuned: Hypothesis, chosen: Hypothesis, floor_deg: float) -> tuple[TrialEvidence, ...]:
    final = {run.name for run in prepared.final}
    nominal_q = retuned.problem.start(prepared.baseline.nominal, [])
    made = []
    for trial, run, motion in zip(
        prepared.checked.trials, prepared.everything, prepared.checked.excitation.motions, strict=True
    ):
        made.append(
            TrialEvidence(
                trial=trial,
                role="final" if run.name in final else "fit",
                motion=motion,
                nominal=retuned.problem.angles(nominal_q, run),
                retuned=retuned.problem.angles(retuned.q, run),
                with_effects=run.angle + chosen.problem.held_out_error(chosen.q, run),
                floor_deg=floor_deg,
            )
        )
    return tuple(made)


def _candidates(selection: Selection, chosen: Hypothesis, sure: dict[str, float]) -> tuple[CandidateRow, ...]:
    """Each effect that was judged alone."""
    rows = []
    before = selection.baseline
    for names, judged in selection.tried.items():
        if len(names) == 1:
            (name,) = names
            rows.append(_row(name, before, judged, sure.get(name, 0.0), name in chosen.effects))
    return tuple(sorted(rows, key=lambda row: (-row.probability, row.rmse_deg)))


def _row(name: str, before: Judged, after: Judged, probability: float, chosen: bool) -> CandidateRow:
    _, error = gain(before, after)
    rmse, retuned = np.sqrt(after.mse), np.sqrt(before.mse)
    effects = after.hypothesis.problem.effects
    side: Side = effects[0].side if effects else "trial"
    return CandidateRow(
        name, side, float(rmse), float(retuned - rmse), float(error / (2 * retuned)), probability, chosen
    )


def _parameters(chosen: Hypothesis) -> tuple[ParameterRow, ...]:
    problem = chosen.problem
    rows = []
    plain = problem.plain(chosen.q)
    k = problem.size - sum(len(c.free) for c in problem.effects)
    for c in problem.effects:
        for freedom in c.free:
            edge = min(abs(chosen.q[k] - problem.lower[k]), abs(chosen.q[k] - problem.upper[k])) < _AT_BOUND
            rows.append(ParameterRow(c.effect, freedom.name, float(plain[k]), (np.nan, np.nan), at_bound=bool(edge)))
            k += 1
    return tuple(rows)


def _localised(prepared: Prepared, places: Localisation | None) -> dict[str, object]:
    del prepared, places
    return {}
