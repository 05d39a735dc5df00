"""What next: the motion that separates the explanations that these trials leave open."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.ctrl.limits import CommandLimits
from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.effects.catalogue import candidates
from hystmpc.models.effects.effect import Scale
from hystmpc.models.identify.cross_validation import CrossValidation, Hypothesis
from hystmpc.models.identify.problem import Problem
from hystmpc.models.identify.selection import Selection
from hystmpc.models.simulator import Simulator

from .confusable import confusability
from .diagnosis import NextMotion
from .findings import Findings
from .motion_menu import menu
from .next_motion import Noise, Proposal, propose
from .predicted_response import contender_of

_LEAST_NOISE_DEG = 1e-3
_TYPICAL = ("lag", "creep", "stick_slip", "contact")  # one of each family, where nothing is left to choose between
_MOST = 4  # contenders of a gap that nothing explains


def next_step(findings: Findings) -> tuple[Proposal | None, NextMotion | None]:
    """A motion for what is open; none where nothing is.

    First comes a set of effects that stand for one another on these trials. Without one, an effect that was named
    although these motions cannot tell it from another (`confusability`) is put beside that other. Where a gap has no
    explanation, the motion is proposed on which effects of different families differ most; where the angles do not
    follow the commands at all, none is.

    Args:
        findings: of all earlier steps.
    """
    fitted = {} if findings.prepared.unrelated else _open(findings)
    if len(fitted) < 2:
        return None, None
    prepared = findings.prepared
    contenders = [contender_of(name, hypothesis, prepared) for name, hypothesis in fitted.items()]
    proposal = propose(contenders, menu(_limits(findings), prepared.checked.dt), _noise(findings))
    return proposal, proposal.summary()


def _open(findings: Findings) -> dict[str, Hypothesis]:
    """The answers that are left, fitted."""
    ruling, chosen = findings.ruling, findings.chosen
    if ruling.verdict in ("unknown", "too_little"):
        return _families(findings)
    rivals = ruling.ambiguity[0] if ruling.ambiguity else _unseparated(findings)
    if not rivals:
        return {}
    rest = chosen.effects - {rivals[0]}
    known = findings.selection.tried.get(frozenset(rest))
    base = known.hypothesis if known else findings.retuned
    # In one more trial a shift of its own is a matter of retuning.
    fitted = {name: base if name == "trial_shift" else _with(findings, rest, name) for name in rivals}
    return {name: hypothesis for name, hypothesis in fitted.items() if hypothesis is not None}


def _unseparated(findings: Findings) -> tuple[str, ...]:
    """A named effect and what these motions cannot tell it from, by their commands."""
    if findings.ruling.verdict != "named":
        return ()
    for row in confusability(findings.prepared.checked.excitation):
        named = [name for name in row.effects if name in findings.chosen.effects]
        if named and not row.separable and not row.one_class:
            others = [n for n in row.effects if n not in findings.chosen.effects and n not in findings.left_out]
            if others:
                return (named[0], *others)
    return ()


def _with(findings: Findings, rest: frozenset[str], name: str) -> Hypothesis | None:
    """The causes `rest` and one more; as it was judged, else fitted now."""
    names = rest | {name}
    if names == findings.chosen.effects:
        return findings.chosen
    if names in findings.selection.tried:
        return findings.selection.tried[names].hypothesis
    kept = findings.selection.tried.get(rest)
    base = kept.hypothesis if kept else findings.retuned
    return _fitted(findings.validation, base, name)


def _fitted(validation: CrossValidation, base: Hypothesis, name: str) -> Hypothesis | None:
    """The best variant of an effect added to a hypothesis; None where it is no operator."""
    problem = base.problem
    z, there = problem.retuned(base.q), [list(values.values()) for values in problem.effect_values(base.q)]
    library = candidates(Scale.of(validation.runs), validation.baseline.effects)
    made = [
        validation.with_causes((*problem.effects, c), problem.terms, z, [[*there, start] for start in c.starts])
        for c in library
        if c.effect == name
    ]
    return min(made, key=lambda h: h.mse, default=None)


def _families(findings: Findings) -> dict[str, Hypothesis]:
    """Single effects that were judged, the best first; without two of them, one of each family at a typical size."""
    tried = _singles(findings.selection)
    if len(tried) >= 2:
        return dict(list(tried.items())[:_MOST])
    baseline, z = findings.prepared.baseline, findings.retuned.problem.retuned(findings.retuned.q)
    made: dict[str, Hypothesis] = {}
    for c in candidates(Scale.of(findings.validation.runs), (), findings.left_out):
        if c.effect in _TYPICAL and c.effect not in made:
            problem = Problem(baseline, (c,))
            made[c.effect] = Hypothesis(problem, problem.start(z, [c.starts[-1]]), np.nan)
    return made


def _singles(selection: Selection) -> dict[str, Hypothesis]:
    judged = sorted((j for names, j in selection.tried.items() if len(names) == 1), key=lambda j: j.mse)
    return {next(iter(j.hypothesis.effects)): j.hypothesis for j in judged if j.hypothesis.problem.effects}


def _noise(findings: Findings) -> Noise:
    """White noise of the sensor, and what the best explanation leaves beyond it."""
    white = max(findings.floor.noise_deg, _LEAST_NOISE_DEG)
    if findings.ruling.verdict in ("unknown", "too_little"):
        return Noise(white)
    return Noise(white, white=1.0, form_deg=float(np.sqrt(max(findings.chosen.mse - white**2, 0.0))))


def _limits(findings: Findings) -> CommandLimits:
    """Commands that were recorded, and no others; as fast as was recorded or as the simulator's file allows."""
    simulator, runs = findings.simulator, findings.prepared.everything
    facts: ModelMetadata = simulator.metadata() if isinstance(simulator, Simulator) else simulator.metadata
    fastest = max(float(np.abs(np.diff(run.command)).max()) / run.dt_s for run in runs)
    commands: Sequence[float] = [float(v) for run in runs for v in (run.command.min(), run.command.max())]
    return CommandLimits(min(commands), max(commands), max(fastest, facts.command_rate))
