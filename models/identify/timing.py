"""Distinction of lag, delay and rate dependence, by errors on parts of all trials and by their fast components."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hystmpc.trials.types import Vec

from ..effects.effect import Candidate
from .cross_validation import CrossValidation, HeldOutErrors, Hypothesis, InParts, fit_problem, sureness
from .least_squares import side_by_side
from .runs import Blocks, Run, blocks_of, whitened, whitening

TIMING = frozenset({"lag", "delay", "rate_dependence"})
"""Effects that leave a slow motion alone and keep the angle behind a fast one."""
_PART_S = 3.0
_FORMS = 2  # compared forms of each effect, those that fit best
# The form error is the same in each block, so that no scatter shows it: this share of its energy counts as an error.
_DOUBT = 0.1
_FEW = 2  # free numbers; a form with more of them mends the simulator's form error as well


def timing_rivals(
    validation: CrossValidation,
    candidates: Sequence[Candidate],
    chosen: Hypothesis,
    rest: Hypothesis | None,
    floor_mse: float = 0.0,
    form_share: float = 0.0,
) -> dict[str, tuple[Hypothesis, InParts]]:
    """Hypotheses with a lag, a delay and a rate dependence in place of the chosen one; empty unless just one is chosen.

    Each has two errors:

    1. On every other part of 3 s of all trials, by a fit to the parts between. Trials held out whole are harder where
       a single trial has the fast steps, whose speed is then an extrapolation.
    2. Whitened training errors (generalised least squares). These effects differ for a few samples after a change of
       direction of the command; the model-form error is slow.

    Args:
        rest: fit without the effect of timing, if there is one.
        floor_mse, form_share: see `InParts`.
    """
    names = chosen.effects & TIMING
    values = list(zip(chosen.problem.effects, chosen.problem.effect_values(chosen.q), strict=True))
    delays = [v for c, v in values if c.effect in TIMING and c.free]
    if len(names) != 1 or len(delays) != 1:
        return {}
    late_s = next(v for name, v in delays[0].items() if name.endswith("_s"))
    others = rest or chosen
    kept = [(c, v) for c, v in zip(others.problem.effects, others.values, strict=True) if c.effect not in TIMING]

    def fit(candidate: Candidate) -> Hypothesis:
        effects = (*(c for c, _ in kept), candidate)
        starts = [[*(v for _, v in kept), start] for start in (candidate.starts[0], _late(candidate, late_s))]
        return validation.with_causes(effects, chosen.problem.terms, others.z, starts, validation.search_tolerance)

    floor = floor_mse, form_share

    def compared(form: tuple[Candidate, Hypothesis]) -> tuple[Hypothesis, InParts]:
        candidate, h = form[0], validation.finished(form[1])
        return h, InParts(_held_out(validation, h), _quick(validation, h, white), len(candidate.free), *floor)

    tried = [candidate for candidate in candidates if candidate.effect in TIMING and candidate.free]
    fitted: dict[str, list[tuple[Candidate, Hypothesis]]] = {}
    for candidate, made in zip(tried, side_by_side(fit, tried), strict=True):
        fitted.setdefault(candidate.effect, []).append((candidate, made))
    best = min((h for forms in fitted.values() for _, h in forms), key=lambda h: h.mse)
    white = whitening([best.error(run) for run in validation.runs])
    hypotheses = {}
    for effect, forms in fitted.items():
        forms = sorted(forms, key=lambda form: form[1].mse)[:_FORMS]
        pairs = list(side_by_side(compared, forms))
        hypothesis, parts = min(pairs, key=lambda pair: float(pair[1].held_out.sum()))
        quickest = min((pair for _, pair in pairs), key=lambda pair: pair.expected)
        hypotheses[effect] = hypothesis, replace(quickest, held_out=parts.held_out)
    return hypotheses


def _late(candidate: Candidate, late_s: float) -> tuple[float, ...]:
    """First start of a candidate, with the known delay of the device."""
    first = candidate.starts[0]
    named = [f.name in ("tau_s", "delay_s", "tau_up_s", "tau_down_s") for f in candidate.free]
    return tuple(late_s if late else value for late, value in zip(named, first, strict=True))


def _held_out(validation: CrossValidation, hypothesis: Hypothesis) -> Vec:
    """Energy of errors on each part by a fit to the others, in blocks (B,)."""
    problem, runs = hypothesis.problem, validation.runs
    errors = [np.zeros(run.counts.size) for run in runs]
    for seen in (0, 1):
        fitted, judged = ([_parts(run, odd) for run in runs] for odd in (seen, 1 - seen))
        usable = [run for run in fitted if run.counts.any()]
        q = fit_problem(problem, usable, hypothesis.q, validation.evaluations, 1e-3).q
        scored = [(error, run) for error, run in zip(errors, judged, strict=True) if run.counts.any()]
        for (error, run), left in zip(scored, problem.held_out_errors(q, [run for _, run in scored]), strict=True):
            error[run.counts] = left
    return blocks_of([e[run.counts] for e, run in zip(errors, runs, strict=True)], runs).energy


def _parts(run: Run, odd: int) -> Run:
    part = np.arange(run.counts.size) * run.dt_s // _PART_S % 2 == odd
    return replace(run, counts=run.counts & part)


def _quick(validation: CrossValidation, hypothesis: Hypothesis, white: Vec) -> Vec:
    """Energy of the whitened training errors, in blocks (B,)."""
    problem, runs = hypothesis.problem, validation.runs
    q = fit_problem(problem, runs, hypothesis.q, validation.evaluations, 1e-4, white).q
    return blocks_of([whitened(problem.error(q, run)[0], white) for run in runs], runs).energy


def by_timing(
    chosen: HeldOutErrors, tried: Mapping[frozenset[str], HeldOutErrors], sure_errors: float
) -> HeldOutErrors:
    """Select among the chosen hypothesis and those with another effect of timing.

    Of those whose error, held out in parts, is at most so many standard errors above the least, the one with the least
    expected whitened errors; one with more than two free numbers only if others are as many errors worse in these.
    """
    names = chosen.hypothesis.effects
    if len(names & TIMING) != 1 or chosen.parts is None:
        return chosen
    rivals = [tried[made] for name in sorted(TIMING) if (made := names - TIMING | {name}) in tried]
    compared = [(rival, rival.parts) for rival in rivals if rival.parts is not None]
    best = min(compared, key=lambda pair: float(pair[1].held_out.sum()))[0]
    tied = [pair for pair in compared if timing_errors(pair[0], best)[0] <= sure_errors]
    quickest = min(tied, key=lambda pair: pair[1].expected)[0]
    near = [pair for pair in tied if pair[0] is quickest or timing_errors(pair[0], quickest)[1] <= sure_errors]
    least_work, parts = min(near, key=lambda pair: (pair[1].free > _FEW, pair[1].expected))
    if least_work.hypothesis.effects == names or least_work.energy.sum() < chosen.energy.sum():
        return least_work
    return replace(least_work, energy=parts.held_out)  # held out by trials it was extrapolated


def timing_errors(before: HeldOutErrors, after: HeldOutErrors) -> tuple[float, float]:
    """Standard errors by which the second is better, held out in parts and in whitened errors; 0 if not compared.

        (max(E_1, F) - max(E_2, F)) / sqrt(s^2 + (0.1 f F)^2)

    with the error s by the scatter of blocks. F is the energy of noise and model form, f the part of the form in it. Of
    whitened errors the lesser takes the place of F in the divisor, and none that of F above. They do not speak for a
    form of many numbers where a simpler one leaves no more than F: it mends the model form.
    """
    if before.parts is None or after.parts is None:
        return 0.0, 0.0
    one, other = before.parts, after.parts
    floor, quick = one.floor_mse * float(before.samples.sum()), min(float(one.quick.sum()), float(other.quick.sum()))
    doubt, mends = _DOUBT * one.form_share, one.free <= _FEW < other.free and float(one.held_out.sum()) <= floor
    in_parts = _sure(before, one.held_out, other.held_out, floor, doubt * floor)
    return in_parts, 0.0 if mends else _sure(before, one.quick, other.quick, 0.0, doubt * quick)


def _sure(blocks: Blocks, before: Vec, after: Vec, floor: float, doubt: float) -> float:
    """Standard errors by which an energy falls in these blocks, as far as it is above a floor."""
    sure = sureness(Blocks(before, blocks.samples, blocks.run), Blocks(after, blocks.samples, blocks.run))
    one, other = float(before.sum()), float(after.sum())
    error = np.hypot((one - other) / sure, doubt) if sure else 0.0
    return float(np.copysign((max(one, floor) - max(other, floor)) / error, sure)) if error else 0.0
