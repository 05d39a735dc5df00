"""Diagnosis of the gap between a simulator and recorded trials, from the logs to the folder of results."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from hystmpc.models.effects.catalogue import EFFECTS, confounders, diagnosable
from hystmpc.models.identify.cross_validation import CrossValidation
from hystmpc.models.identify.least_squares import one_blas_thread
from hystmpc.models.identify.uncertainty import BASELINE_UNITS, ParameterRow, parameter_rows
from hystmpc.models.model import LoadedModel
from hystmpc.models.simulator import Simulator
from hystmpc.trials.errors import GapError, did_you_mean
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress, no_progress

from .decide.ambiguity import limited_by_inclusion, probability, ranking
from .decide.attribution import Findings, as_given_if_better, attribute, confirm
from .decide.retuning import moved_numbers, retuned_with
from .decide.stability import stability_of
from .decide.trial_differences import NAME, SHIFT, UNITS, Configuration, configuration_of, dependences_of
from .diagnosis import DetectableSizes, Diagnosis, IdentifiedEffect, InputDependence, Untestable
from .logs.detectable import smallest_detectable
from .logs.preparation import PreparedTrials, prepare
from .logs.simulated import as_simulated
from .logs.trial_choice import NEEDS_ORDER
from .next.open_hypotheses import next_step, unseparated, within_one_sample
from .residual import Localisation, explainable_share, localise

if TYPE_CHECKING:
    from .report.report_data import ReportData


Play: TypeAlias = Callable[[Sequence[Trial]], Sequence[Trial]]
"""Gives trials the output of the user's simulator for their commands as a channel, see `logs.simulated`."""

_STEPS, _CONCLUDED = 100, 97  # of the progress
_LEFT_BY_A_ROUND = 0.6  # of the progress of the selection
_STABILITY_UNKNOWN = 0.5
_NOTHING_TO_PLAY = (
    "No replay confirms this diagnosis: none of its effects acts on the command, so your simulator has nothing new to "
    "play."
)
_SURE_OF_NONE = 0.95  # probability that nothing is missing where every resample says so


@one_blas_thread
def find_causes(
    trials: Sequence[Trial],
    simulator: Simulator | LoadedModel,
    *,
    seed: int = 0,
    without: Sequence[str] = (),
    only: Sequence[str] | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
    ordered: bool = True,
    skip_first_flexure: bool = False,
) -> Findings:
    """Find the causes of the gap: check, retune, attribute, confirm on the final trials, and localise.

    Args:
        trials: of one device.
        simulator: a chain of operators or an exported model.
        without: effects left out of the library.
        only: the library itself; all effects if left out.
        progress: called with completed steps, total steps and the present step.
        say: called before the long part with a line on each omitted trial and on the expected duration.
        ordered: whether the caller knows that the trials are in recording order. If not, time stamps or a manifest may
            define it; otherwise the result does not depend on their order.
        skip_first_flexure: count each trial only from the command's first reversal on.

    Raises:
        LogError: if a trial is a proposed motion, or its command never turns and the first flexure is skipped.
        GapError: on unusable trials (`check_trials`), or an unknown effect.
        ModelError: if the simulator is an inverse map.
    """
    left_out = _left_out(without, only)
    progress = progress or no_progress
    clock = _StepTimes()
    progress(0, _STEPS, "checking the trials")
    prepared = prepare(trials, simulator, seed, ordered, skip_first_flexure)
    if say:
        for line in filter(None, (*prepared.checked.left_out, prepared.checked.workload.estimate)):
            say(line)
    detectable = smallest_detectable(prepared, left_out)
    validation = CrossValidation(prepared.baseline, prepared.development)
    prepared, validation, retuned = retuned_with(prepared, validation)
    clock.lap("check and retune")
    attribution = attribute(prepared, validation, retuned, left_out, seed, _selection_progress(progress))
    clock.lap("which")
    progress(88, _STEPS, "measuring the gap on the final trials")
    attribution = as_given_if_better(prepared, attribution)
    conclusion = confirm(prepared, attribution, seed)
    clock.lap("how far")
    stability = stability_of(prepared, attribution, conclusion, seed)
    clock.lap("how stable")
    progress(94, _STEPS, "where and what next")
    localisation = _localisation(prepared, seed)
    clock.lap("where")
    return Findings(
        simulator=simulator,
        prepared=prepared,
        detectable=detectable,
        attribution=attribution,
        conclusion=conclusion,
        localisation=localisation,
        stability=stability,
        left_out=left_out,
        seed=seed,
        seconds=clock.seconds,
    )


@one_blas_thread
def conclude(findings: Findings, progress: Progress | None = None) -> tuple[Diagnosis, ReportData]:
    """Conclude a diagnosis: its result with the next motion, and the data of its report."""
    from .report.report_data import report_data

    clock = _StepTimes()
    prepared = findings.prepared
    values = {name: cause.parameters for name, cause in findings.conclusion.closed.causes.items()}
    rows = parameter_rows(findings.conclusion.chosen, prepared.development, values)
    diagnosis = _diagnosis(findings, rows)
    proposal = next_step(findings)
    diagnosis = replace(diagnosis, next_motion=proposal.summary() if proposal else None)
    clock.lap("what next")
    findings = replace(findings, seconds={**findings.seconds, **clock.seconds})
    units, decades = prepared.checked.trials[0].units, prepared.decades
    shown = tuple(replace(row.times(decades.in_log(row.unit)), unit=units.named(row.unit) or "1") for row in rows)
    data = report_data(findings, diagnosis, proposal, shown)
    (progress or no_progress)(_CONCLUDED, _STEPS, diagnosis.verdict)
    return diagnosis, data


def detectable_in_logs(trials: Sequence[Trial], simulator: Simulator | LoadedModel) -> DetectableSizes:
    """Smallest detectable size of each effect on these trials, from their commands alone.

    Raises:
        GapError: on unusable trials (`check_trials`).
        ModelError: if the simulator is an inverse map.
    """
    return smallest_detectable(prepare(trials, simulator, ordered=False))


def _selection_progress(progress: Progress) -> Callable[[float, str], None]:
    """Progress of the selection, 5 to 85 %: each round, with a restarted count, takes 40 % of the rest."""
    rounds, last = 0, 0.0

    def advance(share: float, what: str) -> None:
        nonlocal rounds, last
        rounds, last = rounds + (share < last), share
        progress(85 - 80 * _LEFT_BY_A_ROUND ** (rounds + min(share, 1.0)), _STEPS, what)

    return advance


class _StepTimes:
    def __init__(self) -> None:
        self._last = time.perf_counter()
        self.seconds: dict[str, float] = {}

    def lap(self, step: str) -> None:
        now = time.perf_counter()
        self.seconds[step], self._last = now - self._last, now


def _left_out(without: Sequence[str], only: Sequence[str] | None) -> tuple[str, ...]:
    library = diagnosable()
    for name in (*without, *(only or ())):
        if name not in library:
            raise GapError(f"no effect {name!r} in the library, {did_you_mean(name, library)}")
    kept = library if only is None else tuple(only)
    return tuple(name for name in library if name in without or name not in kept)


def _localisation(prepared: PreparedTrials, seed: int) -> Localisation | None:
    """Localisation of the residual after retuning to all trials, for information only."""
    retuned = CrossValidation(prepared.baseline, prepared.counted).retuned()
    errors = prepared.scored(prepared.residuals(retuned))
    if not any(np.any(error) for error in errors):
        return None
    width = prepared.decades.command * prepared.baseline.loop_width(retuned.z)
    return localise(prepared.checked.trials, errors, max(width, 0.0), seed, prepared.order == "known")


def _diagnosis(findings: Findings, parameters: Sequence[ParameterRow]) -> Diagnosis:
    from .report.words import dependence_note, one_sample_note, reason_for

    prepared, attribution, conclusion = findings.prepared, findings.attribution, findings.conclusion
    decision, jumps, hypothesis = conclusion.decision, attribution.jumps, attribution.retuned
    grouped = configuration_of(conclusion.chosen, prepared.everything)
    follows = _dependences(findings)
    public = {SHIFT: NAME} if grouped else {}  # shifts of whole groups of trials are a configuration change
    probabilities = _probabilities(findings, public)
    effects = _effects(findings, probabilities, parameters, grouped)
    sets = sorted(decision.ambiguity, key=lambda names: -probabilities.get(names[0], 0.0))
    ambiguity = tuple(tuple(public.get(name, name) for name in names) for names in sets)
    decades, units = prepared.decades, prepared.checked.trials[0].units
    nominal, retuned = (
        {name: decades.log_value(v, BASELINE_UNITS[name]) for name, v in prepared.baseline.quantities(z).items()}
        for z in (prepared.baseline.nominal, hypothesis.z)
    )
    library = [name for name in diagnosable() if name not in findings.left_out]
    moved = moved_numbers(prepared, hypothesis, parameters) if decision.verdict == "retuned" else ()
    sizes, checked = decades.log_sizes(conclusion.closed.gap), prepared.checked
    rivals = decision.ambiguity or (unseparated(findings),)
    ranked = ranking(probabilities, attribution.inclusion, rivals, library, _unnamed_probability(findings))
    unusable, said = (prepared.too_little, checked.unrelated), replace(decision, ambiguity=ambiguity)
    reason = reason_for(said, effects, sizes, *unusable, moved, units.angle)
    return Diagnosis(
        verdict=decision.verdict,
        reason=reason,
        effects=effects,
        ambiguity=ambiguity,
        ranking=tuple((public.get(name, name), probability) for name, probability in ranked),
        gap=sizes,
        retuned={name: (nominal[name], retuned[name]) for name in nominal},
        where=dict(findings.localisation.places) if findings.localisation else {},
        notes=(
            *checked.notes,
            *([decades.log_sizes(jumps).note(units.angle)] if jumps else []),
            *([dependence_note(follows, units.angle)] if follows else []),
            *([one_sample_note(late, prepared.checked.dt)] if (late := within_one_sample(findings)) else []),
        ),
        order=prepared.order,
        untestable=_untestable(findings),
        stability=findings.stability,
        explainable_share=_explainable_share(findings),
        moved=moved,
        groups=grouped.groups if grouped else (),
        depends_on=follows,
        detectable=findings.detectable,
        unit=units.angle,
        command_unit=units.command,
        simulator="given" if prepared.stand_in_rmse_deg is None else "stand_in",
        stand_in_rmse_deg=prepared.stand_in_rmse_deg,
    )


def _dependences(findings: Findings) -> tuple[InputDependence, ...]:
    """Dependence of the differences between trials on a measured input, in units of the log."""
    prepared = findings.prepared
    return tuple(
        replace(one, slope=prepared.decades.log_value(one.slope, UNITS[one.parameter]))
        for one in dependences_of(findings.conclusion.chosen, prepared.everything)
    )


def _explainable_share(findings: Findings) -> float | None:
    """Share of the structural gap that a flexible model of the command's past explains held out; None without a gap."""
    prepared, conclusion = findings.prepared, findings.conclusion
    errors = prepared.scored(prepared.residuals(findings.attribution.retuned))
    mse = float(np.mean(np.concatenate(errors) ** 2))
    structural = mse - conclusion.closed.gap.floor_rmse_deg**2
    if structural <= 0 or conclusion.decision.case == "moved" or conclusion.decision.verdict == "none":
        return None
    explained = explainable_share(prepared.checked.trials, errors, findings.seed) * mse
    return float(np.clip(explained / structural, 0.0, 1.0))


def _untestable(findings: Findings) -> tuple[Untestable, ...]:
    """Effects that need the unknown order of recording, without those left out of the library."""
    if findings.prepared.order == "known":
        return ()
    return tuple(Untestable(name, why) for name, why in NEEDS_ORDER.items() if name not in findings.left_out)


def _probabilities(findings: Findings, public: Mapping[str, str]) -> dict[str, float]:
    """Probability of each identified effect; grouped shifts are less likely to imitate another effect."""
    causes, missing = findings.conclusion.closed.causes, set(findings.left_out)
    ambiguous = {name for names in findings.conclusion.decision.ambiguity for name in names}
    untestable_names = {untestable.name for untestable in _untestable(findings)}
    ambiguous |= {name for name in causes if untestable_names & set(EFFECTS[name].also_taken_for)}
    probabilities = {}
    for name, cause in causes.items():
        untried, stability = bool(confounders(name) & missing), _stability_share(findings)
        chance = probability(public.get(name, name), cause.share, name in ambiguous, stability, untried)
        probabilities[name] = limited_by_inclusion(chance, findings.attribution.inclusion.get(name, 1.0))
    return probabilities


def _unnamed_probability(findings: Findings) -> float:
    """Probability of effects outside the verdict; if the verdict is no gap, that of another verdict."""
    if findings.conclusion.decision.verdict not in ("none", "retuned"):
        return 1.0
    return 1 - _SURE_OF_NONE * _stability_share(findings)


def _stability_share(findings: Findings) -> float:
    return findings.stability.share if findings.stability else _STABILITY_UNKNOWN


def _effects(
    findings: Findings,
    probabilities: Mapping[str, float],
    parameters: Sequence[ParameterRow],
    grouped: Configuration | None,
) -> tuple[IdentifiedEffect, ...]:
    closed, decades, log = findings.conclusion.closed, findings.prepared.decades, findings.prepared.checked.trials[0]
    units = {
        name: dict(UNITS) if grouped and name == SHIFT else {r.name: r.unit for r in parameters if r.owner == name}
        for name in closed.causes
    }
    effects = (
        IdentifiedEffect(
            name=NAME if grouped and name == SHIFT else name,
            probability=probabilities[name],
            inclusion=findings.attribution.inclusion.get(name, 1.0),
            closed_share=cause.share,
            closed_ci90=cause.ci90,
            rmse_before_deg=cause.rmse_without_deg,
            rmse_after_deg=closed.gap.with_effects_rmse_deg,
            parameters={
                parameter: decades.log_value(value, units[name].get(parameter, "1"))
                for parameter, value in (grouped.sizes if grouped and name == SHIFT else cause.parameters).items()
            },
            units={parameter: log.units.named(unit) or "1" for parameter, unit in units[name].items()},
            undetermined=tuple(row.name for row in parameters if row.owner == name and row.flat),
        )
        for name, cause in sorted(closed.causes.items(), key=lambda item: (-probabilities[item[0]], -item[1].share))
    )
    return tuple(decades.log_sizes(effect) for effect in effects)


def _with_replays(findings: Findings, data: ReportData, play: Play | None) -> ReportData:
    """Data with the commands for the user's simulator to play and, where it has played them, what they confirm."""
    from .replay import confirmed_shares, replays_of

    if data.diagnosis.simulator == "given":
        return data
    replays, diagnosis = replays_of(findings), data.diagnosis
    diagnosis = replace(diagnosis, replay=tuple(trial.source for trial in replays.trials))
    if play is not None and replays.each:
        outputs = [as_simulated(trial) for trial in play(replays.trials)]
        shares, rmse = confirmed_shares(findings, replays, outputs)
        diagnosis = replace(diagnosis, confirmed=shares, confirmed_rmse_deg=rmse)
    elif play is not None and diagnosis.effects:
        diagnosis = replace(diagnosis, notes=(*diagnosis.notes, _NOTHING_TO_PLAY))
    return replace(data, diagnosis=diagnosis, replays=replays.trials)


@dataclass(frozen=True, eq=False)
class DiagnosisResult:
    """Result of a diagnosis with the results of its steps."""

    findings: Findings
    data: ReportData

    @property
    def diagnosis(self) -> Diagnosis:
        """Verdict, effects, gap and next motion."""
        return self.data.diagnosis

    def save(self, folder: Path | str, settings: Mapping[str, Any], models: Sequence[Path] = ()) -> Path:
        """Write the folder, see `save_diagnosis`."""
        from .report.folder import save_diagnosis

        return save_diagnosis(self.data, folder, settings, models=models)


def diagnose_trials(
    trials: Sequence[Trial],
    simulator: Simulator | LoadedModel,
    *,
    out: Path | str | None = None,
    called: Mapping[str, Any] | None = None,
    model: Path | None = None,
    seed: int = 1,
    without: Sequence[str] = (),
    only: Sequence[str] | None = None,
    ordered: bool = True,
    skip_first_flexure: bool = False,
    play: Play | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> DiagnosisResult:
    """Diagnose trials as `hystmpc diagnose` does: verdict, expected tracking error, and the folder of results.

    Args:
        out: folder for report, corrected simulator and next motion; nothing is written if left out.
        called: further facts on the call, stored in the folder with the arguments below.
        model: file of the simulator; the folder stores its SHA-256, the report its name.
        play: gives the output of the user's simulator for the commands of a replay, see `replay`.
        trials, simulator, seed, without, only, ordered, skip_first_flexure, progress, say: see `find_causes`.

    Raises:
        LogError, GapError, ModelError: see `find_causes`.
        ConfigError: if `out` holds anything but an older diagnosis, or cannot be written.
    """
    from .expected_tracking import with_tracking
    from .report.folder import require_free

    if out is not None:
        require_free(out)
    findings = find_causes(
        trials,
        simulator,
        seed=seed,
        without=without,
        only=only,
        progress=progress,
        say=say,
        ordered=ordered,
        skip_first_flexure=skip_first_flexure,
    )
    data = with_tracking(_with_replays(findings, conclude(findings, progress)[1], play), progress)
    if model is not None:
        stands_in = data.diagnosis.simulator == "stand_in"
        data = replace(data, simulator=f"of your own, stand-in {model.name}" if stands_in else model.name)
    if out is not None:
        settings: dict[str, Any] = {
            "logs": [trial.source for trial in trials],
            **(called or {}),
            "seed": seed,
            "without": list(without),
            "only": None if only is None else list(only),
            "ordered": ordered,
            "skip_first_flexure": skip_first_flexure,
        }
        (progress or no_progress)(100, 100, "writing the report")
        DiagnosisResult(findings, data).save(out, settings, () if model is None else (model,))
    return DiagnosisResult(findings, data)
