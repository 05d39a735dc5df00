"""Attribution: selection of the causes of a gap on the development trials, and their test on the final ones."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hystmpc.models.effects.catalogue import candidates
from hystmpc.models.effects.effect import Candidate, Scale
from hystmpc.models.identify.cross_validation import CrossValidation, Hypothesis
from hystmpc.models.identify.runs import Run
from hystmpc.models.identify.selection import OF_SINGLE_TRIALS, Selection, SelectionSettings, select
from hystmpc.models.model import LoadedModel
from hystmpc.models.simulator import Simulator

from ..diagnosis import DetectableSizes, Stability
from ..logs.detectable import NO_GAP
from ..logs.noise_floor import NoiseFloor
from ..logs.preparation import PreparedTrials
from ..logs.sensor import white_noise
from ..logs.trial_choice import NEEDS_ORDER
from ..residual import Localisation
from .ambiguity import ambiguity_of, drift_is_significant, inclusion_shares
from .gap_closed import FinalErrors, GapClosed, measured_blocks
from .remaining_structure import Jumps, find_jumps, structure_left
from .retuning import Retuning, reidentified_share, retuning_of, width_grown
from .verdict import AT_FLOOR, WIDTH_GROWN, FinalFacts, VerdictDecision, VerdictFacts, decide_verdict, residual_ratio

_PREDICTABLE = 0.5  # of the retuned error: largest part of it that jumps may add to the floor of the selection
_NOISE_SHARE, _MENDED_SHARE = 0.3, 0.1  # of the remaining error: noise and resolution, outliers and dropouts, to count
# Least share of the retuned error for naming new steps of the readings without another gap: the log itself proves them.
_STEP_SHARE = 0.005


@dataclass(frozen=True, eq=False)
class Attribution:
    """Causes selected on the development trials.

    Attributes:
        validation: development runs, on which hypotheses are fitted and compared.
        inclusion: share of block resamples in which each effect is selected; 1 for a stick-slip named by its jumps.
        jumps: of the tip in steady motion, if they indicate stick-slip.
    """

    validation: CrossValidation
    retuned: Hypothesis
    selection: Selection
    inclusion: dict[str, float]
    jumps: Jumps | None
    facts: VerdictFacts


@dataclass(frozen=True, eq=False)
class Conclusion:
    """Verdict, and the errors on the final trials.

    Attributes:
        facts: without the causes that did not significantly lower the error of the final trials.
        chosen: the corrected simulator; the retuned one if no effect is the explanation.
        floor: from repeats or noise, with the corrected simulator.
    """

    decision: VerdictDecision
    facts: VerdictFacts
    chosen: Hypothesis
    floor: NoiseFloor
    closed: GapClosed


def attribute(
    prepared: PreparedTrials,
    validation: CrossValidation,
    retuned: Hypothesis,
    left_out: Sequence[str],
    seed: int,
    advance: Callable[[float, str], None],
) -> Attribution:
    """Select the causes on the development trials, without the effects `left_out`.

    `advance` is called with the share of the present round of the selection and the effect under test.
    """
    jumps = find_jumps(prepared.everything, retuned, prepared.signs)
    unusable = bool(prepared.too_little or prepared.checked.unrelated)
    jumping = jumps.seen and "stick_slip" not in left_out and not unusable
    noise_mse = max(white_noise(prepared.residuals(retuned)), prepared.rounding_deg) ** 2
    # The sensor's fault and the form of the simulator are independent: their squares add up.
    floor_mse = max(noise_mse, prepared.form_mse + (prepared.excess_mse if prepared.form_mse else 0.0))
    if jumping:
        floor_mse = max(floor_mse, min(jumps.mse, _PREDICTABLE * retuned.mse))
    library = usable_effects(prepared, prepared.baseline.effects, left_out, prepared.development)
    if jumps.absent:  # friction in the core can be greater at rest without a jump
        library = tuple(c for c in library if c.effect != "stick_slip" or not c.operators)
    without = (*left_out, "trial_shift") if jumping or _within_a_step(prepared, retuned) else tuple(left_out)
    if prepared.checked.unrelated:  # nothing to explain: only the baseline is evaluated
        library, without = (), (*left_out, *OF_SINGLE_TRIALS)
    form_share = 1 - noise_mse / floor_mse if prepared.form_mse and floor_mse else 0.0
    faults_mse = prepared.excess_mse
    selection = select(validation, library, SelectionSettings(), floor_mse, without, advance, faults_mse, form_share)
    baseline, grown = selection.baseline, width_grown(selection.chosen.hypothesis)
    inclusion = inclusion_shares(selection, floor_mse, faults_mse, seed)
    if jumping:
        inclusion["stick_slip"] = 1.0  # its jumps show in the log itself, as a sensor's faults do
    step_mse = prepared.signs.quantisation_deg**2 / 12.0
    retuning = Retuning() if unusable else retuning_of(prepared, retuned, baseline.mse)
    if not unusable and grown >= WIDTH_GROWN:
        retuning = replace(retuning, reidentified_share=reidentified_share(prepared, validation, baseline, floor_mse))
    return Attribution(
        validation=validation,
        retuned=retuned,
        selection=selection,
        inclusion=inclusion,
        jumps=jumps if jumping else None,
        facts=VerdictFacts(
            effects=selection.chosen.hypothesis.effects,
            retuned_mse=baseline.mse,
            chosen_mse=selection.chosen.mse,
            retuned_fit_mse=baseline.hypothesis.mse,
            floor_mse=floor_mse,
            form_mse=prepared.form_mse or floor_mse,
            structure_left=structure_left(selection, validation.runs, prepared.everything, floor_mse),
            ambiguity=ambiguity_of(selection, drift_test(validation)),
            sensor="sensor" not in without and _sensor_matters(prepared, selection),
            sensor_gap=_is_gap(prepared, prepared.excess_mse + _repair_mse(prepared)),
            excess_mse=prepared.excess_mse,
            new_step="sensor" not in without and prepared.new_step and step_mse >= _STEP_SHARE * baseline.mse,
            jumps=jumping,
            too_little=bool(prepared.too_little),
            unrelated=bool(prepared.checked.unrelated),
            retuning=retuning,
            width_grown=grown,
        ),
    )


def usable_effects(
    prepared: PreparedTrials, in_core: Iterable[str], left_out: Sequence[str], runs: Sequence[Run]
) -> tuple[Candidate, ...]:
    """Candidate effects that these trials can test; without recording order none that depends on it.

    Args:
        in_core: effects with a parameter in the core of the nominal simulator.
        runs: runs from which the sizes of the effects are estimated.
    """
    made = candidates(Scale.of(runs), in_core, left_out)
    if prepared.order == "known":
        return made
    return tuple(c for c in made if not c.carries and c.effect not in NEEDS_ORDER)


def drift_test(validation: CrossValidation) -> Callable[[Hypothesis], bool]:
    """Test for a significant drift within trials that fits each hypothesis only once."""
    return functools.cache(lambda h: drift_is_significant(validation, h))


def confirm(prepared: PreparedTrials, attribution: Attribution, seed: int) -> Conclusion:
    """Evaluate the final trials with the selected causes, drop causes without confirmation, and decide the verdict.

    A cause is dropped if the interval of its closed share contains zero on the final trials; all are dropped if that of
    their common closed share does.
    """
    retuned, facts = attribution.retuned, attribution.facts
    provisional = decide_verdict(facts)
    chosen = retuned
    if provisional.explained:
        chosen = attribution.validation.polished(attribution.selection.chosen.hypothesis)
    facts = replace(facts, sensor=provisional.sensor)
    facts, chosen, floor, closed = _confirmed_causes(prepared, attribution, facts, chosen, seed)
    repeatable = floor_of(prepared, retuned)
    final = FinalFacts(
        closed.gap.closed_share,
        residual_ratio(closed.gap.with_effects_rmse_deg**2, prepared.form_mse, floor.noise_deg**2),
        unproven=provisional.explained and bool(attribution.facts.effects) and not chosen.effects,
        at_floor=_at_floor(closed, repeatable.noise_deg),
        moved=closed.moved,
        everywhere=facts.closed_everywhere(_final_mse(closed), prepared.final_part),
    )
    decision = decide_verdict(replace(facts, final=final))
    if (chosen.effects and not decision.explained) or (decision.sensor and not facts.sensor):
        facts = replace(facts, sensor=facts.sensor or decision.sensor)
        facts, chosen, floor, closed = _confirmed_causes(prepared, attribution, facts, retuned, seed)
        decision = decide_verdict(replace(facts, final=final))
    if decision.verdict == "unknown" and repeatable.kind == "repeats" and _at_floor(closed, repeatable.rmse_deg):
        # The differences between repeats are the gap, not its floor.
        floor = NoiseFloor(repeatable.noise_deg, "noise", repeatable.noise_deg)
        closed = FinalErrors(prepared, attribution.validation, retuned, retuned, floor, decision.sensor, seed).closed()
    differ_deg = repeatable.rmse_deg if repeatable.kind == "repeats" else math.nan
    form_deg = math.sqrt(prepared.form_mse) if prepared.form_mse else math.nan
    closed = replace(closed, gap=replace(closed.gap, repeats_rmse_deg=differ_deg, model_form_rmse_deg=form_deg))
    return Conclusion(decision, facts, chosen, floor, closed)


def as_given_if_better(prepared: PreparedTrials, attribution: Attribution) -> Attribution:
    """Return to the simulator as given if retuning raises the error of the final trials."""
    problem = attribution.retuned.problem
    given = Hypothesis(problem, problem.as_given, math.nan)
    given = replace(given, mse=attribution.validation.fitted_errors(given).mse)
    worse = measured_blocks(prepared, given).mse < measured_blocks(prepared, attribution.retuned).mse
    return replace(attribution, retuned=given) if worse else attribution


def _confirmed_causes(
    prepared: PreparedTrials, attribution: Attribution, facts: VerdictFacts, chosen: Hypothesis, seed: int
) -> tuple[VerdictFacts, Hypothesis, NoiseFloor, GapClosed]:
    """Facts, simulator, floor and errors after removal of causes that do not significantly lower the final error."""
    while True:
        floor, jumps = floor_of(prepared, chosen), attribution.jumps if facts.jumps else None
        fitted = attribution.validation, attribution.retuned, chosen
        closed = FinalErrors(prepared, *fitted, floor, facts.sensor, seed, jumps).closed()
        weakest = closed.unproven({names[0] for names in facts.ambiguity})
        weakest = weakest or next(iter(chosen.effects & facts.form_like), "")
        if not weakest:
            return replace(facts, jumps="stick_slip" in closed.causes and facts.jumps), chosen, floor, closed
        facts, chosen = _without_cause(attribution, facts, chosen, weakest)


def _final_mse(closed: GapClosed) -> tuple[float, float]:
    return closed.gap.retuned_rmse_deg**2, closed.gap.with_effects_rmse_deg**2


def _at_floor(closed: GapClosed, floor_deg: float) -> bool:
    return closed.gap.retuned_rmse_deg**2 < AT_FLOOR * floor_deg**2


def _without_cause(
    attribution: Attribution, facts: VerdictFacts, chosen: Hypothesis, dropped: str
) -> tuple[VerdictFacts, Hypothesis]:
    if dropped not in chosen.effects:
        if dropped == "sensor":
            return replace(facts, sensor=False, new_step=False), chosen
        return replace(facts, jumps=False), chosen
    kept, validation = chosen.effects - {dropped}, attribution.validation
    if not kept:
        return facts, attribution.retuned
    reduced = validation.polished(validation.without(chosen, {dropped}))
    judged = attribution.selection.tried.get(kept) or validation.judge(reduced)
    return facts.with_only(kept, judged.mse, width_grown(reduced)), reduced


def _sensor_matters(prepared: PreparedTrials, selection: Selection) -> bool:
    """Whether sensor faults dominate the remaining error or exceed the model-form error; noise may be a disturbance."""
    signs, left, mended = prepared.signs, selection.chosen.mse, _repair_mse(prepared)
    noise = signs.energy if signs.noisy or (signs.coarse and prepared.excess_mse > 0) else 0.0
    good_part = noise > _NOISE_SHARE * left or mended > _MENDED_SHARE * left
    return good_part or _is_gap(prepared, mended + (prepared.excess_mse if signs.coarse else 0.0))


def _repair_mse(prepared: PreparedTrials) -> float:
    """Mean square change of the angle by the repair of outliers and held values [deg^2]."""
    mended = np.concatenate([raw - run.angle for raw, run in zip(prepared.raw, prepared.everything, strict=True)])
    return float(np.mean(mended**2))


def _within_a_step(prepared: PreparedTrials, retuned: Hypothesis) -> bool:
    """Whether the mean error of every trial is below half of a coarse step: in a hold rounding is as far off."""
    half = 0.5 * prepared.signs.quantisation_deg
    return prepared.signs.coarse and all(abs(float(error.mean())) < half for error in prepared.residuals(retuned))


def _is_gap(prepared: PreparedTrials, mse: float) -> bool:
    return 0 < (NO_GAP - 1) * prepared.form_mse <= mse


def floor_of(prepared: PreparedTrials, hypothesis: Hypothesis) -> NoiseFloor:
    """Noise floor of the residual, at least its rounding, after correction by shifts and phases of single trials."""
    problem = hypothesis.problem
    residuals = prepared.residuals(hypothesis)
    if problem.terms.names:
        residuals = [-error for error in problem.held_out_errors(hypothesis.q, prepared.everything)]
    floor, least = prepared.floor(residuals), prepared.rounding_deg
    return replace(floor, rmse_deg=max(floor.rmse_deg, least), noise_deg=max(floor.noise_deg, least))


@dataclass(frozen=True, eq=False)
class Findings:
    """Results of all steps of a diagnosis.

    Attributes:
        detectable: smallest detectable size of each effect, from the commands alone.
        localisation: of the retuned residual; None without one.
        stability: of the verdict over resampled splits; None if the trials allow no choice.
        left_out: effects excluded from the library.
        seconds: duration of each step [s].
    """

    simulator: Simulator | LoadedModel
    prepared: PreparedTrials
    detectable: DetectableSizes
    attribution: Attribution
    conclusion: Conclusion
    localisation: Localisation | None
    stability: Stability | None
    left_out: tuple[str, ...]
    seed: int
    seconds: Mapping[str, float]
