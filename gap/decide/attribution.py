"""Attribution: the causes of a gap, selected on the development trials and confirmed on the final ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hystmpc.models.effects.catalogue import candidates
from hystmpc.models.effects.effect import Scale
from hystmpc.models.identify.cross_validation import CrossValidation, Hypothesis
from hystmpc.models.identify.selection import OWN_TO_TRIALS, Selection, SelectionSettings, select

from ..logs.noise_floor import Floor, find_floor
from ..logs.preparation import PreparedTrials
from ..logs.sensor import white_noise
from .ambiguity import ambiguity_of, inclusion_shares
from .gap_closed import GapClosed, measure
from .jumps import Jumps, find_jumps
from .lack_of_fit import structure_left
from .verdict import FinalFacts, Ruling, VerdictFacts, VerdictSettings, decide_verdict

_LEAST_MSE = 1e-9
_PREDICTABLE = 0.5  # of the retuned error: largest part of it that jumps may add to the floor of the selection


@dataclass(frozen=True)
class DiagnosisSettings:
    """Frozen thresholds of the diagnosis.

    Attributes:
        selection: of the causes.
        verdict: of the verdict.
    """

    selection: SelectionSettings = field(default_factory=SelectionSettings)
    verdict: VerdictSettings = field(default_factory=VerdictSettings)


@dataclass(frozen=True, eq=False)
class Attribution:
    """Causes selected on the development trials.

    Attributes:
        validation: development runs, on which hypotheses are fitted and compared.
        retuned: the simulator refitted, without causes.
        selection: every hypothesis that was tried, and the best.
        inclusion: share of block resamples in which each effect is chosen.
        jumps: of the tip in steady motion, where they are the sign of stick-slip.
        facts: what the verdict depends on, but for the final trials.
    """

    validation: CrossValidation
    retuned: Hypothesis
    selection: Selection
    inclusion: dict[str, float]
    jumps: Jumps | None
    facts: VerdictFacts


@dataclass(frozen=True, eq=False)
class Conclusion:
    """The ruling, and the sizes on the final trials that belong to it.

    Attributes:
        ruling: verdict and its case.
        chosen: the corrected simulator; the retuned one where no effect is the explanation.
        floor: from repeats or noise, with the corrected simulator.
        closed: sizes of the gap and what each cause closes.
    """

    ruling: Ruling
    chosen: Hypothesis
    floor: Floor
    closed: GapClosed


def attribute(
    prepared: PreparedTrials,
    validation: CrossValidation,
    retuned: Hypothesis,
    left_out: Sequence[str],
    settings: DiagnosisSettings,
    seed: int,
    advance: Callable[[float, str], None],
) -> Attribution:
    """Select the causes on the development trials.

    Args:
        prepared: trials and the baseline.
        validation: development runs.
        retuned: the simulator refitted.
        left_out: effects that the library goes without.
        settings: thresholds.
        seed: of the resamples.
        advance: called with the share of the present round of the selection and the effect that is tried.
    """
    jumps = find_jumps(prepared.everything, retuned, prepared.signs)
    unusable = bool(prepared.too_little or prepared.checked.unrelated)
    jumping = jumps.seen and "stick_slip" not in left_out and not unusable
    floor_mse = max(white_noise(prepared.residuals(retuned)) ** 2, prepared.form_mse)
    if jumping:
        floor_mse = max(floor_mse, min(jumps.mse, _PREDICTABLE * retuned.mse))
    library = candidates(
        Scale.of(prepared.development),
        prepared.baseline.effects,
        (*left_out, "stick_slip") if jumps.absent else left_out,
    )
    without = left_out
    if prepared.checked.unrelated:  # nothing to explain: only the baseline is evaluated
        library, without = (), (*left_out, *OWN_TO_TRIALS)
    selection = select(validation, library, settings.selection, floor_mse, without, advance)
    return Attribution(
        validation=validation,
        retuned=retuned,
        selection=selection,
        inclusion=inclusion_shares(selection, floor_mse, settings.verdict, seed),
        jumps=jumps if jumping else None,
        facts=VerdictFacts(
            effects=selection.chosen.hypothesis.effects,
            retuned_mse=selection.baseline.mse,
            chosen_mse=selection.chosen.mse,
            retuned_fit_mse=selection.baseline.hypothesis.mse,
            floor_mse=floor_mse,
            form_mse=prepared.form_mse or floor_mse,
            structure_left=structure_left(selection, validation.runs, floor_mse, settings.verdict),
            ambiguity=ambiguity_of(selection, validation, settings.verdict),
            sensor="sensor" not in without and _sensor_matters(prepared, selection, settings.verdict),
            jumps=jumping,
            too_little=bool(prepared.too_little),
            unrelated=bool(prepared.checked.unrelated),
        ),
    )


def confirm(prepared: PreparedTrials, attribution: Attribution, settings: VerdictSettings, seed: int) -> Conclusion:
    """Evaluate the final trials with the causes selected, and decide; without them, where they are not confirmed.

    Args:
        prepared: trials and the baseline.
        attribution: causes selected on the development trials.
        settings: thresholds.
        seed: of the resampling.
    """
    validation, retuned = attribution.validation, attribution.retuned
    provisional = decide_verdict(attribution.facts, settings)
    chosen = retuned
    if provisional.explained:
        chosen = validation.polished(attribution.selection.chosen.hypothesis)
    floor = _floor(prepared, chosen)
    closed = measure(prepared, validation, retuned, chosen, floor, provisional.sensor, seed)
    final = FinalFacts(closed.gap.closed_share, _residual_ratio(closed, prepared.form_mse, floor))
    ruling = decide_verdict(replace(attribution.facts, final=final), settings)
    if provisional.explained and not ruling.explained:
        chosen, floor = retuned, _floor(prepared, retuned)
        closed = measure(prepared, validation, retuned, retuned, floor, ruling.sensor, seed)
    if attribution.jumps:
        closed = closed.with_jumps(attribution.jumps.parameters)
    return Conclusion(ruling, chosen, floor, closed)


def _sensor_matters(prepared: PreparedTrials, selection: Selection, settings: VerdictSettings) -> bool:
    """Whether the sensor's faults are a good part of the error that the chosen causes leave."""
    signs, left = prepared.signs, selection.chosen.mse
    noise = signs.energy if signs.noisy or signs.coarse else 0.0
    mended = np.concatenate([raw - run.angle for raw, run in zip(prepared.raw, prepared.everything, strict=True)])
    return noise > settings.noise_share * left or float(np.mean(mended**2)) > settings.mended_share * left


def _floor(prepared: PreparedTrials, hypothesis: Hypothesis) -> Floor:
    checked = prepared.checked
    return find_floor(checked.trials, prepared.residuals(hypothesis), checked.dt, checked.excitation.repeats)


def _residual_ratio(closed: GapClosed, form_mse: float, floor: Floor) -> float:
    """RMSE with all causes over noise and model-form error; 1 where the model-form error is unknown."""
    if form_mse <= 0:
        return 1.0
    return closed.gap.with_effects_rmse_deg / math.sqrt(max(form_mse, floor.noise_deg**2, _LEAST_MSE))
