"""The diagnosis: check, split, retune, where, which, how far, verdict, next."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hystmpc.models.contract.load import OnnxModel
from hystmpc.models.effects.catalogue import DIAGNOSABLE, confounders
from hystmpc.models.identify.cross_validation import CrossValidation, Hypothesis
from hystmpc.models.simulator import Simulator
from hystmpc.trials.errors import GapError, did_you_mean
from hystmpc.trials.trial import Trial

from .attribution import DiagnosisSettings, confirmed, decide, residual_ratio
from .diagnosis import Diagnosis, FoundEffect, NextMotion, Verdict
from .findings import Findings
from .floor import Floor, find_floor
from .gap_closed import measure
from .localise import Localisation, localise
from .next_step import next_step
from .preparation import Prepared, prepare
from .probability import probability, ranking
from .reason import reason_for
from .report.evidence import Evidence
from .report_data import report_data

Progress = Callable[..., None]

LIBRARY = DIAGNOSABLE
_STEPS = 100  # of the progress


DEFAULT_SETTINGS = DiagnosisSettings()


def diagnose(
    trials: Sequence[Trial],
    simulator: Simulator | OnnxModel,
    *,
    seed: int = 0,
    without: Sequence[str] = (),
    only: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Say where a simulator departs from its device, which effects cause it and how far they close the gap.

    Args:
        trials: of one device, in recording order.
        simulator: a chain of operators or an exported model.
        seed: of every resampling.
        without: effects left out of the library.
        only: the library itself, where it is to be another than all effects.
        progress: called with steps done, steps in all and what is done.

    Raises:
        GapError: on unusable trials (`check_trials`), or an unknown effect.
        ModelError: if the simulator is an inverse map.
    """
    findings = investigate(trials, simulator, seed=seed, without=without, only=only, progress=progress)
    return conclude(findings, progress)[0]


def investigate(
    trials: Sequence[Trial],
    simulator: Simulator | OnnxModel,
    *,
    seed: int = 0,
    without: Sequence[str] = (),
    only: Sequence[str] | None = None,
    progress: Progress | None = None,
    settings: DiagnosisSettings = DEFAULT_SETTINGS,
    say: Callable[[str], None] | None = None,
) -> Findings:
    """Check, split, retune, which, how far, where; see `diagnose`.

    `say` is told before the long part which trials are left out and what the others will cost, a line each.
    """
    left_out = _left_out(without, only)
    told = progress or _silent
    clock = _Clock()
    told(0, _STEPS, "checking the trials")
    prepared = prepare(trials, simulator, seed)
    if say:
        for line in filter(None, (*prepared.checked.left_out, prepared.checked.workload.estimate)):
            say(line)
    validation = CrossValidation(prepared.baseline, prepared.development)
    retuned = validation.retuned()
    clock.lap("check and retune")
    which = decide(prepared, validation, retuned, left_out, settings, seed, _advance(told))
    clock.lap("which")
    told(88, _STEPS, "measuring the gap on the final trials")
    chosen = validation.polished(which.selection.chosen.hypothesis) if which.explained else retuned
    floor = _floor(prepared, chosen)
    far = measure(prepared, validation, retuned, chosen, floor, which.sensor, seed)
    if which.explained and not confirmed(
        which, far.gap, residual_ratio(far.gap, prepared.form_mse, floor), settings.verdict
    ):
        which, chosen, floor = which.unexplained(), retuned, _floor(prepared, retuned)
        far = measure(prepared, validation, retuned, retuned, floor, which.sensor, seed)
    if which.jumps:
        far = far.joined_by("stick_slip", which.jumps.parameters)
    clock.lap("how far")
    told(94, _STEPS, "where and what next")
    places = _places(prepared, retuned, seed)
    clock.lap("where")
    judged = which.selection, which.ruling, retuned, chosen, floor, which.floor_mse, far, places, which.jumps
    return Findings(simulator, prepared, validation, *judged, left_out, seed, settings, clock.seconds)


def conclude(findings: Findings, progress: Progress | None = None) -> tuple[Diagnosis, Evidence]:
    """What next, the verdict, and everything that a report shows, from the findings of all earlier steps."""
    told, clock = progress or _silent, _Clock()
    proposal, motion = next_step(findings)
    clock.lap("what next")
    findings = replace(findings, seconds={**findings.seconds, **clock.seconds})
    diagnosis = _diagnosis(findings, motion)
    evidence = report_data(findings, diagnosis, proposal)
    told(_STEPS, _STEPS, diagnosis.verdict)
    return diagnosis, evidence


def _silent(done: int, total: int, note: str = "") -> None:
    """No progress to tell."""


def _advance(told: Progress) -> Callable[[float, str], None]:
    """The selection's part of the progress; every round counts its candidates anew, so that it only ever grows."""
    done = [5]

    def advance(share: float, what: str) -> None:
        done[0] = max(done[0], 5 + int(80 * share))
        told(done[0], _STEPS, what)

    return advance


class _Clock:
    """Time of each step."""

    def __init__(self) -> None:
        self._last = time.perf_counter()
        self.seconds: dict[str, float] = {}

    def lap(self, step: str) -> None:
        now = time.perf_counter()
        self.seconds[step], self._last = now - self._last, now


def _left_out(without: Sequence[str], only: Sequence[str] | None) -> tuple[str, ...]:
    for name in (*without, *(only or ())):
        if name not in LIBRARY:
            raise GapError(f"no effect {name!r} in the library, {did_you_mean(name, LIBRARY)}")
    kept = LIBRARY if only is None else tuple(only)
    return tuple(name for name in LIBRARY if name in without or name not in kept)


def _floor(prepared: Prepared, chosen: Hypothesis) -> Floor:
    errors = [run.angle - chosen.problem.angles(chosen.q, run) for run in prepared.everything]
    return find_floor(prepared.checked.trials, errors, prepared.checked.dt, prepared.checked.excitation.repeats)


def _places(prepared: Prepared, retuned: Hypothesis, seed: int) -> Localisation | None:
    errors = [run.angle - retuned.problem.angles(retuned.q, run) for run in prepared.everything]
    if not any(np.any(error) for error in errors):
        return None
    z = retuned.problem.retuned(retuned.q)
    width = max(prepared.baseline.quantities(z)["backlash_width"], 0.0)
    return localise(prepared.checked.trials, errors, width, seed)


def _diagnosis(findings: Findings, motion: NextMotion | None) -> Diagnosis:
    ruling, far, prepared = findings.ruling, findings.far, findings.prepared
    sure = _sure(findings)
    effects = _effects(findings, sure)
    verdict = _verdict(findings)
    z = far.retuned.problem.retuned(far.retuned.q)
    nominal, retuned = prepared.baseline.quantities(prepared.baseline.nominal), prepared.baseline.quantities(z)
    library = [name for name in LIBRARY if name not in findings.left_out]
    return Diagnosis(
        verdict=verdict,
        reason=reason_for(verdict, effects, ruling, far.gap, prepared.lacks, prepared.unrelated),
        effects=effects,
        ambiguity=ruling.ambiguity,
        ranking=ranking(sure, ruling.inclusion, ruling.ambiguity, library),
        gap=far.gap,
        retuned={name: (nominal[name], retuned[name]) for name in nominal},
        where=dict(findings.places.places) if findings.places else {},
        notes=(*prepared.checked.notes, *([findings.jumps.note] if findings.jumps else [])),
        next_motion=motion,
    )


def _verdict(findings: Findings) -> Verdict:
    """The ruling; but a faulty sensor is a name too where it explains enough."""
    verdict, far = findings.ruling.verdict, findings.far
    if "sensor" not in far.shares or verdict != "unknown":
        return verdict
    return "named" if far.gap.closed_share >= findings.settings.verdict.least_closed else verdict


def _sure(findings: Findings) -> dict[str, float]:
    """Probability of each effect found."""
    shares, open_names = findings.far.shares, {name for names in findings.ruling.ambiguity for name in names}
    several, missing = len(shares) > 1, set(findings.left_out)
    return {
        name: probability(name, share, several, name in open_names, bool(confounders(name) & missing))
        for name, share in shares.items()
    }


def _effects(findings: Findings, sure: Mapping[str, float]) -> tuple[FoundEffect, ...]:
    """What was found, largest share first."""
    far = findings.far
    return tuple(
        FoundEffect(
            name=name,
            probability=sure[name],
            inclusion=findings.ruling.inclusion.get(name, 1.0),
            closed_share=far.shares[name],
            closed_ci90=far.intervals[name],
            rmse_before_deg=far.before_deg[name],
            rmse_after_deg=far.gap.with_effects_rmse_deg,
            parameters=far.parameters[name],
        )
        for name in sorted(far.shares, key=lambda n: -far.shares[n])
    )
