"""Trials and simulator made ready: checked, repaired, split, the nominal simulator run and given its freedom."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from hystmpc.models.chain import Chain
from hystmpc.models.contract.load import OnnxModel
from hystmpc.models.contract.metadata import Range
from hystmpc.models.identify.baseline import Baseline, FreeCoreBaseline, ScaledBaseline, baseline_of
from hystmpc.models.identify.chain_kinds import prandtl_ishlinskii_starts
from hystmpc.models.identify.least_squares import fit_problem
from hystmpc.models.identify.problem import Problem
from hystmpc.models.identify.runs import Run, runs_of
from hystmpc.models.prediction.build import predictor_for
from hystmpc.models.simulator import Identification, Simulator
from hystmpc.trials.segments import segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .check import Checked, check_trials
from .form_error import form_error_mse, nominal_noise_deg
from .sensor import SensorSigns, repaired, sensor_signs
from .split import split_runs

_LEAST_S, _LEAST_TURNS = 15.0, 3
_STAND_IN_PLAYS, _EVALUATIONS, _TOLERANCE = 8, 40, 1e-5


@dataclass(frozen=True, eq=False)
class Prepared:
    """What the selection works on.

    Attributes:
        given: trials as recorded, those that are diagnosed.
        checked: trials at one rate, and what their commands excite.
        signs: of the sensor.
        baseline: the nominal simulator and what retuning may change.
        development, final: runs to choose on, and runs that are opened once.
        everything: all runs in recording order, every sample counted.
        raw: angles as measured, before the sensor's faults were repaired (T,) each [deg].
        form_mse: what model form alone explains [deg^2].
        lacks: what these trials lack for any conclusion, in words; empty where they suffice.
        unrelated: why their angles say nothing on a simulator, see `Checked`.
        excess_mse: energy of the sensor's noise beyond what it had when the simulator was identified [deg^2]; zero
            where that is unknown.
    """

    given: tuple[Trial, ...]
    checked: Checked
    signs: SensorSigns
    baseline: Baseline
    development: tuple[Run, ...]
    final: tuple[Run, ...]
    everything: tuple[Run, ...]
    raw: tuple[Vec, ...]
    form_mse: float
    lacks: str = ""
    unrelated: str = ""
    excess_mse: float = 0.0


def prepare(trials: Sequence[Trial], simulator: Simulator | OnnxModel, seed: int = 0) -> Prepared:
    """Check, resample, repair, split.

    Args:
        trials: of one device, in recording order.
        simulator: a chain of operators or an exported model.
        seed: of the choice among more trials than can be diagnosed.

    Raises:
        GapError: on unusable trials, see `check_trials`.
        ModelError: if the simulator is an inverse map.
    """
    chain_based = isinstance(simulator, Simulator)
    checked = check_trials(trials, simulator if isinstance(simulator, Simulator) else simulator.metadata, seed)
    identification = simulator.identification if isinstance(simulator, Simulator) else Identification(method="network")
    nominal = nominal_noise_deg(identification)
    signs = sensor_signs(checked.recorded, nominal)
    mended = [repaired(trial, signs) for trial in checked.trials]
    command = Range(
        lower=min(float(t.command.min()) for t in mended), upper=max(float(t.command.max()) for t in mended)
    )
    if chain_based:
        assert isinstance(simulator, Simulator)
        baseline, corrections = baseline_of(simulator.chain, command), None
    else:
        assert isinstance(simulator, OnnxModel)
        baseline, corrections = _stand_in(simulator, mended, command)
    runs = runs_of(mended, corrections, checked.before)
    motions = checked.excitation.motions
    development, final = split_runs(runs, motions)
    return Prepared(
        checked.given,
        checked,
        signs,
        baseline,
        development,
        final,
        runs,
        tuple(trial.angle for trial in checked.trials),
        form_error_mse(identification, trials, motions, _sample_time(simulator)),
        lacking(checked.trials),
        checked.unrelated,
        max(signs.energy - nominal**2, 0.0) if nominal is not None and (signs.noisy or signs.coarse) else 0.0,
    )


def lacking(trials: Sequence[Trial]) -> str:
    """What trials lack to hold some back and choose causes on the others, in words; empty where nothing.

    A third of a single turn is no motion to test on: all together they have to last, and to turn, a few times.
    """
    seconds = sum(trial.duration_s for trial in trials)
    turns = sum(segment(trial).reversals.size for trial in trials)
    if seconds < _LEAST_S:
        return f"{seconds:.3g} s in all, expected {_LEAST_S:g} s or more"
    if turns < _LEAST_TURNS:
        return f"the command turns {turns} times in all, expected {_LEAST_TURNS} or more"
    return ""


def _sample_time(simulator: Simulator | OnnxModel) -> float:
    return simulator.dt_s if isinstance(simulator, Simulator) else simulator.metadata.dt_s


def _stand_in(model: OnnxModel, trials: Sequence[Trial], command: Range) -> tuple[Baseline, list[Vec]]:
    """Plays that stand for a network on these commands, and what the network says beyond them.

    Effects change the network's angle by what they change the plays': exact without effects, first order with them.
    """
    predictor = predictor_for(model)
    said = []
    for trial in trials:
        state = predictor.initial(float(trial.angle[0]), float(trial.command[0]))
        said.append(predictor.rollout(state, trial.command[None])[0])
    copies = [replace(trial, angle=y) for trial, y in zip(trials, said, strict=True)]
    baseline = ScaledBaseline(_plays(copies, command), command)
    problem = Problem(baseline)
    start = problem.start(baseline.nominal, [])
    return baseline, [y - problem.angles(start, run) for y, run in zip(said, runs_of(trials), strict=True)]


def _plays(copies: Sequence[Trial], command: Range) -> Chain:
    """Plays fitted to a network's own free runs; their widths do not depend on the rate."""
    runs, found = runs_of(copies), []
    for start in prandtl_ishlinskii_starts(copies, _STAND_IN_PLAYS):
        values = [0.0 if p.name == "beta" else v for p, v in zip(start.parameters, start.values, strict=True)]
        baseline = FreeCoreBaseline(start.with_values(values), command)
        problem = Problem(baseline)
        found.append(
            (problem, fit_problem(problem, runs, problem.start(baseline.nominal, []), _EVALUATIONS, _TOLERANCE))
        )
    problem, best = min(found, key=lambda pair: pair[1].mse)
    return problem.fitted_chain(best.q)
