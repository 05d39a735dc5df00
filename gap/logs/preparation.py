"""Preparation: trials checked, resampled, repaired and split; the nominal simulator run and its model-form error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.decades import Decades
from hystmpc.models.evaluate import free_run, started
from hystmpc.models.identify.baseline import Baseline, FreeCoreBaseline, ScaledBaseline, baseline_of
from hystmpc.models.identify.cross_validation import Hypothesis, fit_problem
from hystmpc.models.identify.problem import Problem
from hystmpc.models.identify.runs import Run, fingerprint, runs_of
from hystmpc.models.model import LoadedModel
from hystmpc.models.simulator import Identification, Simulator
from hystmpc.models.start import motion_line, search_box
from hystmpc.trials.command_noise import remove_command_noise
from hystmpc.trials.errors import GapError, LogError
from hystmpc.trials.segments import first_flexure_end, segment
from hystmpc.trials.trial import Trial, Units, parts_at_gaps
from hystmpc.trials.types import Vec

from ..diagnosis import Order
from .as_given import (
    common_rest,
    corrected_to_simulator_rate,
    evaluated_mse,
    evaluation_notes,
    resampled_or_none,
    starts_at_simulator_rate,
)
from .check import CheckedTrials, check_trials
from .noise_floor import NoiseFloor, find_floor
from .sensor import SensorSigns, repaired, sensor_signs, white_noise
from .trial_choice import in_recording_order, split_runs

_LEAST_S, _LEAST_TURNS = 15.0, 3
_COARSER = 1.5  # times the step that the readings had at identification
_PLAYS, _EVALUATIONS, _TOLERANCE = 8, 40, 1e-5


@dataclass(frozen=True, eq=False)
class PreparedTrials:
    """Trials and nominal simulator, ready for the attribution.

    Trials are in the units of the log. All else is in working units, in which the simulator has the size of a tendon
    catheter: thresholds and bounds are stated for that size. There `deg` and `cmd` stand for a working unit.

    Attributes:
        decades: the working units.
        given: diagnosed trials as recorded.
        checked: trials at one rate, and what their commands excite.
        signs: of the sensor.
        baseline: the nominal simulator and the freedom of retuning.
        development, final: runs for the choice of causes, and runs that are evaluated once.
        everything: all runs, every sample counted; in recording order where it is known, else by content.
        counted: the same, each from its first sample that is scored on.
        raw: angles as measured, before the sensor's faults were repaired (T,) each [deg].
        form_mse: model-form error [deg^2]; zero where unknown.
        too_little: why the trials do not allow a diagnosis, in words; empty where they do.
        excess_mse: energy of the sensor's noise beyond its noise at identification [deg^2]; where that is unknown, of
            its rounding.
        new_step: whether the sensor's readings have coarse steps that they did not have at identification.
        order: whether the order of recording is known.
    """

    decades: Decades
    given: tuple[Trial, ...]
    checked: CheckedTrials
    signs: SensorSigns
    baseline: Baseline
    development: tuple[Run, ...]
    final: tuple[Run, ...]
    everything: tuple[Run, ...]
    counted: tuple[Run, ...]
    raw: tuple[Vec, ...]
    form_mse: float
    too_little: str
    excess_mse: float
    order: Order = "known"
    new_step: bool = False

    @property
    def rounding_deg(self) -> float:
        """RMS error of readings on a grid; 0 where they lie on none [deg]."""
        return self.signs.quantisation_deg / math.sqrt(12.0)

    def residuals(self, hypothesis: Hypothesis) -> list[Vec]:
        """Measured less simulated angle of every run (T,) each [deg]."""
        return [run.angle - hypothesis.problem.angles(hypothesis.q, run) for run in self.everything]

    def floor(self, residuals: Sequence[Vec]) -> NoiseFloor:
        """Noise floor of residuals (T,) of every run [deg]."""
        return find_floor(self.checked.trials, residuals, self.checked.dt, self.checked.excitation.repeats)

    def scored(self, residuals: Sequence[Vec]) -> list[Vec]:
        """Residuals (T,) of every run with zeros where it does not count [deg]."""
        return [np.where(run.counts, error, 0.0) for run, error in zip(self.counted, residuals, strict=True)]


def prepare(
    trials: Sequence[Trial],
    simulator: Simulator | LoadedModel,
    seed: int = 0,
    ordered: bool = True,
    skip_first_flexure: bool = False,
) -> PreparedTrials:
    """Check, resample, repair and split trials, and derive the baseline of the simulator.

    Args:
        trials: of one device.
        simulator: a chain of operators or an exported model.
        seed: of the choice among more trials than can be diagnosed.
        ordered: whether the trials are known to stand in the order of recording, see `in_recording_order`.
        skip_first_flexure: count each trial only from the command's first reversal on.

    Raises:
        LogError: if the first flexure is to be skipped and the command of a trial never turns.
        GapError: on unusable trials, see `check_trials` and `in_recording_order`.
        ModelError: if the simulator is an inverse map.
    """
    trials, order = in_recording_order(trials, ordered)
    known, facts = order == "known", simulator.metadata() if isinstance(simulator, Simulator) else simulator.metadata
    checked = check_trials(trials, simulator if isinstance(simulator, Simulator) else facts, seed, known)
    decades = Decades.of_ranges(facts.trained_command, facts.trained_angle)
    if isinstance(simulator, Simulator):
        _require_size(simulator, decades)
    identification = _identification(simulator, decades)
    nominal = nominal_noise_deg(identification, _known_step(identification, decades))
    signs = sensor_signs(decades.trials(checked.given), nominal)
    in_working_units = decades.trials(checked.trials)
    baseline, runs = _baseline_and_runs(simulator, checked, signs, decades)
    motions = checked.excitation.motions
    form_mse = model_form_mse(identification, trials, motions, facts.dt_s)
    runs = counted = common_rest(runs, form_mse)
    begun = [f"{motion_line(Path(run.name).name, run.start, run.dt_s)}." for run in runs if run.lead]
    checked = replace(checked, notes=(*checked.notes, *begun))
    if skip_first_flexure:
        counted = tuple(_from_first_reversal(r, t) for r, t in zip(runs, in_working_units, strict=True))
    if isinstance(simulator, Simulator):
        errors = _given_errors(baseline, counted, in_working_units, decades)
        notes = _evaluation_notes(simulator, errors, checked, skip_first_flexure)
        checked = replace(checked, notes=(*checked.notes, *notes))
    development, final = split_runs(counted, motions, known)
    new_step = signs.coarse and signs.quantisation_deg > _COARSER * _known_step(identification, decades)
    return PreparedTrials(
        decades=decades,
        given=checked.given,
        checked=checked,
        signs=signs,
        baseline=baseline,
        development=development,
        final=final,
        everything=tuple(replace(run, counts=np.ones_like(run.counts)) for run in runs),
        counted=counted,
        raw=tuple(trial.angle for trial in in_working_units),
        form_mse=form_mse,
        too_little=shortage(checked.trials),
        excess_mse=_excess_mse(signs, nominal, new_step),
        order=order,
        new_step=new_step,
    )


def _baseline_and_runs(
    simulator: Simulator | LoadedModel, checked: CheckedTrials, signs: SensorSigns, decades: Decades
) -> tuple[Baseline, tuple[Run, ...]]:
    """The nominal simulator at the sample time of the trials, and these as runs, faults of the sensor repaired."""
    trials, given = decades.trials(checked.trials), decades.trials(checked.given)
    repaired_trials = [repaired(trial, signs) for trial in trials]
    command = Range(
        lower=min(float(t.command.min()) for t in repaired_trials),
        upper=max(float(t.command.max()) for t in repaired_trials),
    )
    before = [b.scaled(1 / decades.command) for b in checked.before]
    if isinstance(simulator, Simulator):
        simulator_chain, chain = (decades.chain(s.chain) for s in (simulator, simulator.at_sample_time(checked.dt)))
        baseline = baseline_of(chain, command)
        starts = starts_at_simulator_rate([repaired(trial, signs) for trial in given], simulator.dt_s, checked.dt)
        runs = _with_starts(baseline, runs_of(repaired_trials, None, before, starts), simulator, decades)
        runs = corrected_to_simulator_rate(runs, given, chain, simulator_chain, simulator.dt_s)
    else:
        baseline, corrections = _network_baseline(simulator, repaired_trials, command, decades)
        runs = runs_of(repaired_trials, corrections, before)
    if signs.spikes or signs.drops:
        problem, pairs = Problem(baseline), zip(runs, trials, strict=True)
        runs = tuple(replace(r, angle=repaired(t, signs, problem.angles(problem.as_given, r)).angle) for r, t in pairs)
    return baseline, runs


def _with_starts(baseline: Baseline, runs: Sequence[Run], simulator: Simulator, decades: Decades) -> tuple[Run, ...]:
    """Runs with the initial states that the simulator as given finds, as `evaluate` does (`models.start`)."""
    u, y = simulator.trained_command, simulator.trained_angle_deg
    box = search_box(
        Range(lower=u.lower / decades.command, upper=u.upper / decades.command),
        Range(lower=y.lower / decades.angle, upper=y.upper / decades.angle),
    )
    problem = Problem(baseline)
    return tuple(problem.begun(problem.as_given, run, box) for run in runs)


def _evaluation_notes(
    simulator: Simulator, errors: Sequence[Vec], checked: CheckedTrials, skip_first_flexure: bool
) -> tuple[str, ...]:
    """Note where `evaluate` finds another error than these (C,) each, in the unit of the log."""
    sizes = float(np.mean(np.concatenate(errors) ** 2)), white_noise(errors) ** 2
    evaluated = evaluated_mse(simulator, checked.given, skip_first_flexure)
    return evaluation_notes(simulator, *sizes, evaluated, checked.given, checked.dt)


def _given_errors(baseline: Baseline, runs: Sequence[Run], measured: Sequence[Trial], decades: Decades) -> list[Vec]:
    """Errors of the simulator as given against the angles as measured (C,) each, in the unit of the log."""
    problem, pairs = Problem(baseline), zip(runs, measured, strict=True)
    return [decades.angle * (problem.angles(problem.as_given, run) - trial.angle)[run.counts] for run, trial in pairs]


def _from_first_reversal(run: Run, trial: Trial) -> Run:
    """A run that counts from the first reversal of its command on, as `fit` and `evaluate` skip a first flexure."""
    return replace(run, counts=run.counts & (np.arange(len(trial)) >= first_flexure_end(trial)))


def _excess_mse(signs: SensorSigns, nominal_deg: float | None, new_step: bool) -> float:
    """Energy of a faulty sensor's noise beyond its noise at identification; that of new steps is read off them."""
    rounding = signs.quantisation_deg**2 / 12.0 if new_step else 0.0
    if nominal_deg is None or not (signs.noisy or signs.coarse):
        return rounding
    return max(signs.energy - nominal_deg**2, rounding)


def _known_step(identification: Identification, decades: Decades) -> float:
    """Step of the sensor's readings at identification, in working units; 0 where there was none, or it is unknown."""
    return 0.0 if identification.noise is None else identification.noise.sensor_resolution_deg / decades.angle


def _require_size(simulator: Simulator, decades: Decades) -> None:
    """Require parameters within the bounds of their operators, which are stated in working units."""
    units, chain = Units(simulator.command_unit, simulator.angle_unit), decades.chain(simulator.chain)
    for name, parameter, value in zip(chain.labels, chain.parameters, chain.values, strict=True):
        if not parameter.lower <= value <= parameter.upper:
            size, low, high = (decades.log_value(v, parameter.unit) for v in (value, parameter.lower, parameter.upper))
            raise GapError(
                f"simulator: {name} is {size:.4g} {units.named(parameter.unit)}, expected {low:g} to {high:g} from "
                "the ranges that it was identified in"
            )


def _identification(simulator: Simulator | LoadedModel, decades: Decades) -> Identification:
    """Identification record of the simulator, residuals in working units."""
    if not isinstance(simulator, Simulator):
        return Identification(method="network")
    identification = simulator.identification
    residuals = tuple(
        r.model_copy(update={"rmse_deg": r.rmse_deg / decades.angle, "bias_deg": r.bias_deg / decades.angle})
        for r in identification.residuals
    )
    return identification.model_copy(update={"residuals": residuals})


def shortage(trials: Sequence[Trial]) -> str:
    """Why trials are too short, or turn too rarely, to select causes and test them; empty where they are not."""
    seconds = sum(trial.duration_s for trial in trials)
    turns = sum(segment(trial).reversals.size for trial in trials)
    if seconds < _LEAST_S:
        return f"{seconds:.3g} s in all, expected {_LEAST_S:g} s or more"
    if turns < _LEAST_TURNS:
        return f"the command turns {turns} times in all, expected {_LEAST_TURNS} or more"
    return ""


def _network_baseline(
    model: LoadedModel, trials: Sequence[Trial], command: Range, decades: Decades
) -> tuple[Baseline, list[Vec]]:
    """Plays in place of a network on these commands, and the difference of the network's angles from theirs (T,) each.

    Effects are applied to the plays: exact without effects, first order with them.
    """
    in_log = [replace(t, command=decades.command * t.command, angle=decades.angle * t.angle) for t in trials]
    angles = [free_run(model, trial.command, started(model, trial)) / decades.angle for trial in in_log]
    copies = [replace(trial, angle=y) for trial, y in zip(trials, angles, strict=True)]
    baseline = ScaledBaseline(_plays(copies, command), command)
    problem = Problem(baseline)
    pairs = zip(angles, runs_of(trials), strict=True)
    return baseline, [y - problem.angles(problem.as_given, run) for y, run in pairs]


def _plays(copies: Sequence[Trial], command: Range) -> Chain:
    """Rate-independent plays fitted to a network's own free runs."""
    from hystmpc.models.identify.chain_kinds import prandtl_ishlinskii_starts

    runs, fits = runs_of(copies), []
    for start in prandtl_ishlinskii_starts(copies, _PLAYS):
        values = [0.0 if p.name == "beta" else v for p, v in zip(start.parameters, start.values, strict=True)]
        baseline = FreeCoreBaseline(start.with_values(values), command)
        problem = Problem(baseline)
        fits.append((problem, fit_problem(problem, runs, problem.as_given, _EVALUATIONS, _TOLERANCE)))
    problem, best = min(fits, key=lambda pair: pair[1].mse)
    return problem.fitted_chain(best.q)


def model_form_mse(
    identification: Identification, trials: Sequence[Trial], motions: Sequence[str], dt_s: float
) -> float:
    """Model-form error: mean square residual of the nominal simulator on its own identification data [deg^2].

    Zero where it is unknown: the simulator's file stores no residuals, or it was identified on one of these trials
    (compared by fingerprint), so that its residuals contain the gap itself.

    Args:
        identification: of the simulator.
        trials: to be diagnosed, as recorded.
        motions: motion type of each.
        dt_s: sample time of the simulator, at which it was identified [s].
    """
    stored = identification.residuals
    if not stored or _identified_on(identification, trials, dt_s):
        return 0.0
    held = ["holds" if motion in ("holds", "steps", "point_to_point", "ramps") else "continuous" for motion in motions]
    everything = [r.rmse_deg**2 for r in stored]
    by_motion = [[r.rmse_deg**2 for r in stored if r.motion == kind] or everything for kind in held]
    return float(np.mean([np.mean(values) for values in by_motion]))


def _identified_on(identification: Identification, trials: Sequence[Trial], dt_s: float) -> bool:
    """Whether it was identified on one of these trials, or on all of them, at any rate."""
    known = {r.fingerprint for r in identification.residuals if r.fingerprint}
    # A file's sample time is rounded: 0.03333333333 s stand for 30 Hz, but 0.03 s for 1 / 0.03 Hz.
    parts = remove_command_noise([part for trial in trials for part in _parts(trial)])
    for taken in (
        trials,
        parts,
        *([t for part in parts if (t := resampled_or_none(part, rate))] for rate in {1 / dt_s, round(1 / dt_s, 4)}),
    ):
        if identification.training_data_hash == fingerprint(taken):
            return True
        if any(fingerprint([trial]) in known for trial in taken):
            return True
    return False


def _parts(trial: Trial) -> tuple[Trial, ...]:
    """The trial cut at its gaps, as an identification takes it; none where it is refused."""
    with suppress(LogError):
        return parts_at_gaps(trial)
    return ()


def nominal_noise_deg(identification: Identification, step_deg: float = 0.0) -> float | None:
    """Upper bound of the sensor's noise when the simulator was identified [deg]; None where unknown.

    A residual with lag-one correlation c has at most the share 1 - c of its energy in white noise. The rounding of
    readings in steps is not white where the angle moves slowly, and counts in full: step / sqrt(12).

    Args:
        identification: of the simulator.
        step_deg: of the sensor's readings then; 0 of a continuous sensor.
    """
    if not identification.residuals:
        return None
    white = float(np.median([r.rmse_deg * np.sqrt(max(1 - r.lag_one, 0.0)) for r in identification.residuals]))
    return max(white, step_deg / math.sqrt(12.0))
