"""Replay: commands behind the effects of a diagnosis, which the user's own simulator plays to confirm the effects.

    r = a + b effects(u)
    confirmed = stand_in_with_effects(u) + simulated(r) - stand_in(r)

The diagnosis itself has `simulated(u) - stand_in(u)` in place of the last two terms: it takes from a stand-in how the
simulator answers the effects. After the replay this answer is the simulator's own. Effects on the command's side can be
replayed; those in the core or on the output leave the command as it is.

A gain that was identified with an effect, as with most creeps, is no part of the effect. So that the simulator needs
nothing else, a and b bring stand_in(r) nearest to stand_in_with_effects(u).

Source: Eldred, Giunta, Collis, AIAA 2004-4457, as `logs.simulated`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from hystmpc.models.identify.cross_validation import Hypothesis
from hystmpc.models.identify.problem import Problem
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .decide.attribution import Findings
from .decide.gap_closed import FinalErrors, final_blocks
from .diagnosis import ConfirmedShare
from .logs.preparation import PreparedTrials, output_corrections


@dataclass(frozen=True, eq=False)
class Replay:
    """One command to play.

    Attributes:
        effects: those behind which the command is; the others were identified again without the missing one.
        final: number of the final trial.
        trial: the command, in the unit of the log; its source is the name of the file, its angle the measured one.
    """

    effects: frozenset[str]
    final: int
    trial: Trial


@dataclass(frozen=True, eq=False)
class Replays:
    """All commands to play, with the simulators whose effects they contain.

    Attributes:
        hypotheses: by the names of their effects: all of them, and all but one.
        testable: effects that a replay tests.
        each: the commands; none where no effect is on the command's side.
    """

    hypotheses: Mapping[frozenset[str], Hypothesis]
    testable: tuple[str, ...]
    each: tuple[Replay, ...]

    @property
    def trials(self) -> tuple[Trial, ...]:
        """The commands as trials, in the order of `each`."""
        return tuple(one.trial for one in self.each)


def replays_of(findings: Findings) -> Replays:
    """Commands of the final trials behind the named effects, and behind all but one of those on the command's side."""
    prepared, chosen = findings.prepared, findings.conclusion.chosen
    names, validation = chosen.effects, findings.attribution.validation
    testable = tuple(_on_command(chosen))
    hypotheses = {names: chosen}
    for name in sorted(names) if testable else ():
        kept = names - {name}
        part = validation.polished(validation.without(chosen, {name})) if kept else findings.attribution.retuned
        hypotheses[kept] = part
    each, files, log = (
        [],
        _file_names([run.name for run in prepared.final]),
        {t.source: t for t in prepared.checked.trials},
    )
    for effects, hypothesis in hypotheses.items() if testable else ():
        if not _on_command(hypothesis):
            continue  # the recorded command, whose output is known
        commands = _with_gain(prepared, hypothesis)
        file = f".{'+'.join(_on_command(hypothesis))}.csv"
        for number, (run, stem) in enumerate(zip(prepared.final, files, strict=True)):
            command = prepared.decades.command * commands[number]
            each.append(
                Replay(effects, number, replace(log[run.name], command=command, source=stem + file, channels={}))
            )
    return Replays(hypotheses, testable, tuple(each))


def confirmed_shares(
    findings: Findings, replays: Replays, played: Sequence[Trial]
) -> tuple[dict[str, ConfirmedShare], float]:
    """Closed share of each replayed effect with the answers of the user's simulator, and the RMSE with all effects.

    Args:
        played: the trials of `replays` with the simulator's output as their angle, in the same order.

    Returns:
        Shares by effect, and the RMSE over the final trials [unit of the log].
    """
    prepared, decades = findings.prepared, findings.prepared.decades
    names = [run.name for run in prepared.everything]
    before = [prepared.checked.before[names.index(prepared.final[one.final].name)] for one in replays.each]
    corrections = output_corrections(
        prepared.baseline,
        findings.simulator,
        decades,
        decades.trials(list(played)),
        [b.scaled(1 / decades.command) for b in before],
    )
    runs = {effects: list(prepared.final) for effects in replays.hypotheses}
    for one, correction in zip(replays.each, corrections, strict=True):
        runs[one.effects][one.final] = replace(runs[one.effects][one.final], correction=correction)
    blocks = {kept: final_blocks(replays.hypotheses[kept], each) for kept, each in runs.items()}
    attribution, conclusion = findings.attribution, findings.conclusion
    sensor, jumps = conclusion.facts.sensor, attribution.jumps if conclusion.facts.jumps else None
    fitted = attribution.validation, attribution.retuned, conclusion.chosen
    errors = FinalErrors(prepared, *fitted, conclusion.floor, sensor, findings.seed, jumps)
    shares = errors.shares.of_causes(conclusion.chosen.effects, blocks.__getitem__)
    rmse = decades.angle * float(np.sqrt(blocks[conclusion.chosen.effects].mse))
    return {name: ConfirmedShare(*shares[name]) for name in replays.testable}, rmse


def _with_gain(prepared: PreparedTrials, hypothesis: Hypothesis) -> list[Vec]:
    """Commands (T,) of the final runs behind the effects, with the gain and offset that go with them [cmd]."""
    given, runs = Problem(prepared.baseline), prepared.final
    filtered = [hypothesis.problem.filtered(hypothesis.q, run) for run in runs]
    wanted = [hypothesis.problem.angles(hypothesis.q, run) - run.correction for run in runs]
    middle = float(np.mean(np.concatenate(filtered)))

    def moved(line: Vec, command: Vec) -> Vec:
        return middle + line[0] + line[1] * (command - middle)

    def errors(line: Vec) -> Vec:
        parts = []
        for run, command, angle in zip(runs, filtered, wanted, strict=True):
            u = moved(line, command)
            still = replace(run, command=u, rest_command=float(u[0]), rest_angle=float(angle[0]))
            alone = replace(still, lead=0, approach=(), correction=0.0 * u)
            parts.append((given.angles(given.as_given, alone) - angle)[run.counts])
        return np.concatenate(parts)

    line = least_squares(errors, np.array([0.0, 1.0]), x_scale=(0.1, 0.1), diff_step=1e-3, max_nfev=20).x
    return [moved(line, command) for command in filtered]


def _on_command(hypothesis: Hypothesis) -> list[str]:
    return sorted(c.effect for c in hypothesis.problem.effects if c.side == "command" and c.operators)


def _file_names(sources: Sequence[str]) -> list[str]:
    """Names of files without their ending: those of the logs, numbered where several are alike."""
    stems = [Path(source).stem for source in sources]
    alike = Counter(stems)
    return [stem if alike[stem] == 1 else f"{stem}_{k}" for k, stem in enumerate(stems, start=1)]
