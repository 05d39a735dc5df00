"""Open hypotheses: explanations that the trials do not reject, as simulators of a further motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from hystmpc.ctrl.command import CommandLimits
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.effects.catalogue import confounders
from hystmpc.models.identify.cross_validation import Hypothesis
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.identify.problem import Problem
from hystmpc.models.identify.simulators import settled
from hystmpc.models.identify.timing import TIMING
from hystmpc.models.simulator import Simulator
from hystmpc.trials.types import Vec

from ..decide.attribution import Attribution, Findings, usable_effects
from ..logs.excitation import confusability
from ..logs.preparation import PreparedTrials
from ..logs.trial_choice import NEEDS_ORDER
from .motion_design import MotionProposal, Noise, OpenHypothesis, Simulate, propose
from .motions import menu

_STEP = 0.3  # of the unknowns' typical changes

_LEAST_NOISE_DEG = 1e-3
_TYPICAL = ("lag", "creep", "stick_slip", "contact")  # one of each family, where fewer than two effects were tried
NOTHING = "nothing"
"""Name of the hypothesis without any missing effect."""

_MOST = 4  # greatest number of hypotheses for an unexplained gap
# A motion has to take so much of the doubt: (K p - 1) / (K - 1) of K hypotheses, 0 by chance and 1 if one is certain.
_LEAST_HOPE = 1 / 3
_SETTLED = 0.6  # samples: a lag of second order and a delay up to this differ by less than 0.2 % of the command's range


def next_step(findings: Findings) -> MotionProposal | None:
    """Propose the next motion to record; None if no hypothesis is open, or no motion of the menu would decide.

    It shall separate, in this order: all effects that these trials cannot distinguish; a named effect and others that
    these motions cannot distinguish from it (`unseparated`); for a gap without explanation, effects of different
    families. If no angle follows its command, no motion is proposed; nor between a lag and a delay within one sample
    (`within_one_sample`), or if the best motion takes less than a third of the doubt.
    """
    task = discrimination_task(findings, confirm=False)
    if task is None or within_one_sample(findings):
        return None
    proposal = propose(task.hypotheses, menu(_limits(findings), findings.prepared.checked.dt), task.noise)
    return proposal if decides(proposal.chosen.probability, len(task.hypotheses)) else None


def decides(probability: float, count: int) -> bool:
    """Whether naming the right one of `count` hypotheses with this probability takes a third of the doubt."""
    return count * probability - 1 >= _LEAST_HOPE * (count - 1)


def within_one_sample(findings: Findings) -> float:
    """Time [s] of a lag or delay that these trials leave open, if no motion tells them apart; otherwise 0.

    Behind a command that runs straight between samples both are late by the same time once the lag has settled. A lag
    of second order with at most 0.6 samples has settled at the next sample, whatever the motion.
    """
    chosen, pair = findings.conclusion.chosen.problem, {"lag", "delay"}
    if not any(pair <= set(names) for names in findings.conclusion.decision.ambiguity):
        return 0.0
    values = zip(chosen.effects, chosen.effect_values(findings.conclusion.chosen.q), strict=True)
    times = [v for c, some in values if c.effect in TIMING for name, v in some.items() if name.endswith("_s")]
    late = max(times, default=0.0)
    return late if late <= _SETTLED * findings.prepared.checked.dt else 0.0


@dataclass(frozen=True, eq=False)
class DiscriminationTask:
    """Model discrimination task: the hypotheses that a further motion shall separate.

    Attributes:
        confirms: whether the trials decide already, so that the motion only tests their result.
    """

    hypotheses: tuple[OpenHypothesis, ...]
    noise: Noise
    confirms: bool = False


def discrimination_task(findings: Findings, confirm: bool = True) -> DiscriminationTask | None:
    """Hypotheses that remain open after these trials; if there are none, those that test the verdict.

    A named effect is tested against effects that it may be confused with, each fitted in its place; no gap is tested
    against a single effect of each family. None if no angle follows its command.
    """
    if findings.prepared.checked.unrelated:
        return None
    fitted = open_explanations(findings)
    confirms = len(fitted) < 2
    if confirms:
        fitted = _rivals(findings) if confirm else {}
    if len(fitted) < 2:
        return None
    made = tuple(open_hypothesis(name, hypothesis, findings.prepared) for name, hypothesis in fitted.items())
    return DiscriminationTask(made, _noise(findings), confirms)


def _rivals(findings: Findings) -> dict[str, Hypothesis]:
    chosen, attribution = findings.conclusion.chosen, findings.attribution
    if not chosen.effects:
        return {NOTHING: attribution.retuned, **_families(findings)}
    strongest = max(findings.conclusion.closed.causes.items(), key=lambda item: item[1].share, default=("", None))[0]
    name = strongest or min(chosen.effects)
    others = sorted((confounders(name) - chosen.effects) - set(findings.left_out))[:_MOST]
    rest = chosen.effects - {name}
    fitted = {name: chosen} | {other: _with_effect(findings, rest, other) for other in others}
    rivals = {other: hypothesis for other, hypothesis in fitted.items() if hypothesis is not None}
    return rivals if len(rivals) >= 2 else {NOTHING: attribution.retuned, name: chosen}


def open_explanations(findings: Findings) -> dict[str, Hypothesis]:
    """Open hypotheses, by the effect that distinguishes each from the others."""
    decision, attribution = findings.conclusion.decision, findings.attribution
    if decision.effects_unknown:
        return _families(findings)
    if not decision.ambiguity and not unseparated(findings):
        return {}
    made: dict[str, Hypothesis | None] = {}
    for effect, *others in decision.ambiguity or (unseparated(findings),):
        rest = findings.conclusion.chosen.effects - {effect}
        base = _fitted_with(attribution, rest)
        # The first hypothesis contains the chosen effects of the further sets.
        for name in others if made else (effect, *others):
            # In one further trial, an individual shift belongs to retuning.
            made.setdefault(name, base if name == "trial_shift" else _with_effect(findings, rest, name))
    return {name: hypothesis for name, hypothesis in made.items() if hypothesis is not None}


def unseparated(findings: Findings) -> tuple[str, ...]:
    """A named effect and the effects that these motions cannot separate from it, from the commands.

    They remain open, since a device's equations differ from the library's: the angles alone do not decide.
    """
    chosen = findings.conclusion.chosen.effects
    if findings.conclusion.decision.verdict != "named":
        return ()
    excluded = {*findings.left_out, *(NEEDS_ORDER if findings.prepared.order == "unknown" else ())}
    for row in confusability(findings.prepared.checked.excitation):
        named = [name for name in row.effects if name in chosen]
        if named and not row.separable and not row.one_class:
            others = [n for n in row.effects if n not in chosen and n not in excluded]
            if others:
                return (named[0], *others)
    return ()


def _with_effect(findings: Findings, rest: frozenset[str], name: str) -> Hypothesis | None:
    """Hypothesis of the causes `rest` and one more, from the selection or a new fit."""
    attribution, names = findings.attribution, rest | {name}
    if names == findings.conclusion.chosen.effects:
        return findings.conclusion.chosen
    if names in attribution.selection.tried:
        return attribution.selection.tried[names].hypothesis
    return _fit_with(findings, _fitted_with(attribution, rest), name)


def _fitted_with(attribution: Attribution, names: frozenset[str]) -> Hypothesis:
    known = attribution.selection.tried.get(names)
    return known.hypothesis if known else attribution.retuned


def _fit_with(findings: Findings, base: Hypothesis, name: str) -> Hypothesis | None:
    """Best variant of an effect added to a hypothesis; None if it is no operator."""
    validation = findings.attribution.validation
    library = usable_effects(findings.prepared, validation.baseline.effects, (), validation.runs)
    made = [validation.with_one_more(base, candidate) for candidate in library if candidate.effect == name]
    best = min(made, key=lambda h: h.mse, default=None)
    return best and validation.finished(best)


def _families(findings: Findings) -> dict[str, Hypothesis]:
    """Single tested effects, the best first; if fewer than two, one of each family, of typical size."""
    attribution, retuned = findings.attribution, findings.attribution.retuned
    singles = sorted((j for names, j in attribution.selection.tried.items() if len(names) == 1), key=lambda j: j.mse)
    tried = {next(iter(j.hypothesis.effects)): j.hypothesis for j in singles if j.hypothesis.problem.effects}
    if len(tried) >= 2:
        return dict(list(tried.items())[:_MOST])
    baseline, z = findings.prepared.baseline, retuned.z
    made: dict[str, Hypothesis] = {}
    for c in usable_effects(findings.prepared, (), findings.left_out, attribution.validation.runs):
        if c.effect in _TYPICAL and c.effect not in made:
            problem = Problem(baseline, (c,))
            made[c.effect] = Hypothesis(problem, problem.start(z, [c.starts[-1]]), np.nan)
    return made


def _noise(findings: Findings) -> Noise:
    """White noise of the sensor, and the error of the best explanation beyond it."""
    conclusion, decades = findings.conclusion, findings.prepared.decades
    rmse = max(conclusion.floor.noise_deg, _LEAST_NOISE_DEG)
    if conclusion.decision.effects_unknown:
        return decades.log_sizes(Noise(rmse))
    form = float(np.sqrt(max(conclusion.chosen.mse - rmse**2, 0.0)))
    return decades.log_sizes(Noise(rmse, white=1.0, form_deg=form))


def _limits(findings: Findings) -> CommandLimits:
    simulator, trials = findings.simulator, findings.prepared.checked.trials
    facts: ModelMetadata = simulator.metadata() if isinstance(simulator, Simulator) else simulator.metadata
    fastest = max(float(np.abs(np.diff(trial.command)).max()) / trial.dt for trial in trials)
    commands: Sequence[float] = [float(v) for t in trials for v in (t.command.min(), t.command.max())]
    return CommandLimits(min(commands), max(commands), max(fastest, facts.command_rate))


def open_hypothesis(name: str, hypothesis: Hypothesis, prepared: PreparedTrials) -> OpenHypothesis:
    """Convert a fitted hypothesis for `propose`, with one retuning for each unknown.

    Terms of single trials (`trial_shift`, the phase of a disturbance) are not simulated: in one further motion a shift
    belongs to retuning, and the phase is another one.
    """
    problem, q = hypothesis.problem, hypothesis.q
    nudges = [np.clip(q + _STEP * row, problem.lower, problem.upper) for row in np.eye(problem.size)]
    moved = [nudge for nudge in nudges if not np.array_equal(nudge, q)]
    return OpenHypothesis(name, _simulator(problem, q, prepared), [_simulator(problem, n, prepared) for n in moved])


def _simulator(problem: Problem, q: Vec, prepared: PreparedTrials) -> Simulate:
    """Free run of a chain from a settled start at the motion's first command, in the units of the log."""
    carried, runs, decades = {c.carries for c in problem.effects}, prepared.everything, prepared.decades
    last = runs[-1]
    bent = max(last.bent_before, float(last.command.max())) if "bend" in carried else -np.inf
    clock = last.clock_s + last.command.size * last.dt_s if "clock" in carried else 0.0
    chain, rest = decades.log_chain(problem.fitted_chain(q)), decades.angle * runs[0].rest_angle
    return free_run(chain, rest, decades.command * bent, clock)


def free_run(chain: Chain, rest_angle: float, bent: float = -np.inf, clock_s: float = 0.0) -> Simulate:
    """Free run of a chain after a long rest, given rest angle [deg], greatest past command, and clock [s]."""

    @cache  # every motion of a menu has one sample time and starts at one command
    def rested(dt: float, first: float) -> tuple[StagedChain, Vec]:
        there = chain.at_sample_time(dt, dt)
        return StagedChain(there), settled(there, first, rest_angle, bent, clock_s)

    def simulate(command: Vec, dt: float) -> Vec:
        staged, state = rested(dt, float(command[0]))
        return np.asarray(staged.simulate(command[:, None], dt, state[:, None])[0][:, 0])

    return simulate
