"""Preparation: checked, resampled, repaired and split trials; the run nominal simulator and its model-form error."""

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
from hystmpc.models.identify.baseline import (
    Baseline,
    FreeCoreBaseline,
    ScaledBaseline,
    baseline_of,
    with_play_friction,
)
from hystmpc.models.identify.cross_validation import Hypothesis, fit_problem
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.identify.problem import Problem
from hystmpc.models.identify.runs import Before, Run, fingerprint, runs_of
from hystmpc.models.model import LoadedModel
from hystmpc.models.simulator import Identification, Simulator
from hystmpc.models.start import Runs, TrialStart, estimated_start, motion_line, search_box, trial_start
from hystmpc.trials.command_noise import remove_command_noise
from hystmpc.trials.errors import GapError, LogError
from hystmpc.trials.segments import first_flexure_end, segment
from hystmpc.trials.trial import Trial, Units, parts_at_gaps, resample
from hystmpc.trials.types import Vec

from ..diagnosis import Order
from .check import CheckedTrials, check_trials
from .noise_floor import NoiseFloor, find_floor
from .sensor import SensorSigns, repaired, sensor_signs, white_noise
from .simulated import as_simulated, have_simulated
from .trial_choice import in_recording_order, split_runs

_LEAST_S, _LEAST_TURNS = 15.0, 3
_COARSER = 1.5  # times the step that the readings had at identification
_PLAYS, _EVALUATIONS, _TOLERANCE = 8, 40, 1e-5


@dataclass(frozen=True, eq=False)
class PreparedTrials:
    """Trials and nominal simulator, ready for the attribution.

    Trials are in the units of the log. All other values are in working units, in which the simulator has the size of a
    tendon catheter: thresholds and bounds are stated for that size. In them `deg` and `cmd` mean a working unit.

    Attributes:
        baseline: the nominal simulator and the freedom of retuning.
        development, final: runs for the choice of causes, and runs that are evaluated once.
        everything: all runs with every sample counted; in recording order if known, otherwise by content.
        counted: the same, each from its first scored sample on.
        raw: angles as measured, before repair of the sensor's faults (T,) each [deg].
        form_mse: model-form error [deg^2]; zero if unknown.
        too_little: reason why the trials do not allow a diagnosis; empty otherwise.
        excess_mse: energy of the sensor's noise beyond its noise at identification, or beyond its rounding if that is
            unknown [deg^2].
        new_step: whether the sensor's readings have coarse steps that were absent at identification.
        stand_in_rmse_deg: error of the stand-in on the output of the user's simulator [unit of the log]; None where the
            simulator itself is given.
    """

    decades: Decades
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
    stand_in_rmse_deg: float | None = None

    @property
    def rounding_deg(self) -> float:
        """RMS error of readings on a grid; 0 without a grid [deg]."""
        return self.signs.quantisation_deg / math.sqrt(12.0)

    @property
    def final_part(self) -> float:
        """Part of all samples that is of the final trials."""
        final, rest = (sum(int(run.counts.sum()) for run in runs) for runs in (self.final, self.development))
        return final / max(final + rest, 1)

    def residuals(self, hypothesis: Hypothesis) -> list[Vec]:
        """Measured minus simulated angle of every run (T,) each [deg]."""
        return [run.angle - hypothesis.angles(run) for run in self.everything]

    def floor(self, residuals: Sequence[Vec]) -> NoiseFloor:
        """Noise floor of residuals (T,) of every run [deg]."""
        return find_floor(self.checked.trials, residuals, self.checked.dt, self.checked.excitation.repeats)

    def scored(self, residuals: Sequence[Vec]) -> list[Vec]:
        """Residuals (T,) of every run with zeros at samples that do not count [deg]."""
        return [np.where(run.counts, error, 0.0) for run, error in zip(self.counted, residuals, strict=True)]


def prepare(
    trials: Sequence[Trial],
    simulator: Simulator | LoadedModel,
    seed: int = 0,
    ordered: bool = True,
    skip_first_flexure: bool = False,
) -> PreparedTrials:
    """Check, resample, repair and split trials, and derive the baseline of the simulator.

    Where the trials hold the output of the user's simulator, the one given is its stand-in, see `logs.simulated`.

    Args:
        seed: of the choice among too many trials.
        ordered: whether the trials are known to be in recording order, see `in_recording_order`.

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
    stands_in = have_simulated(checked.trials)
    identification = Identification(method="stand-in") if stands_in else _identification(simulator, decades)
    noise = identification.noise
    known_step = 0.0 if noise is None else noise.sensor_resolution_deg / decades.angle
    nominal = nominal_noise_deg(identification, known_step)
    signs = sensor_signs(decades.trials(checked.given), nominal)
    in_working_units = decades.trials(checked.trials)
    baseline, runs = _baseline_and_runs(simulator, checked, signs, decades)
    motions = checked.excitation.motions
    form_mse = model_form_mse(identification, trials, motions, facts.dt_s)
    if stands_in:
        form_mse = _stand_in_form_mse(baseline, runs)
    runs = counted = common_rest(runs, form_mse)
    begun = [f"{motion_line(Path(run.name).name, run.start, run.dt_s)}." for run in runs if run.lead]
    checked = replace(checked, notes=(*checked.notes, *begun))
    if skip_first_flexure:
        ends = [first_flexure_end(trial) for trial in in_working_units]
        counted = tuple(
            replace(run, counts=run.counts & (np.arange(run.counts.size) >= end))
            for run, end in zip(runs, ends, strict=True)
        )
    if isinstance(simulator, Simulator) and not stands_in:
        problem, pairs = Problem(baseline), zip(counted, in_working_units, strict=True)
        errors = [decades.angle * (problem.angles(problem.as_given, r) - t.angle)[r.counts] for r, t in pairs]
        notes = _evaluation_notes(simulator, errors, checked, skip_first_flexure)
        checked = replace(checked, notes=(*checked.notes, *notes))
    development, final = split_runs(counted, motions, known)
    new_step = signs.coarse and signs.quantisation_deg > _COARSER * known_step
    faulty = signs.noisy or (nominal is not None and signs.coarse)
    excess = signs.energy - (nominal or 0.0) ** 2 if faulty else 0.0
    return PreparedTrials(
        decades=decades,
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
        excess_mse=max(excess, signs.quantisation_deg**2 / 12.0 if new_step else 0.0),
        order=order,
        new_step=new_step,
        stand_in_rmse_deg=_stand_in_rmse(counted) * decades.angle if stands_in else None,
    )


def _stand_in_form_mse(baseline: Baseline, runs: Sequence[Run]) -> float:
    """Part of the stand-in's error that its correction does not take off, and the sensor's noise n [deg^2].

        n^2 + e^2 min(1, (gap / width)^2),  width = gain * loop width

    The error e of a stand-in changes along the way of its plays. On the simulator's own way it is known and taken
    off. A device that is a width of the loop away meets another error of that size.
    """
    problem, quantities = Problem(baseline), baseline.quantities(baseline.nominal)
    errors = [(problem.angles(problem.as_given, run) - run.angle)[run.counts] for run in runs]
    away = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    width = quantities.get("gain", 0.0) * max(baseline.loop_width(baseline.nominal), 0.0)
    return white_noise(errors) ** 2 + _stand_in_rmse(runs) ** 2 * min(1.0, away / max(width, 1e-12)) ** 2


def _stand_in_rmse(runs: Sequence[Run]) -> float:
    return float(np.sqrt(np.mean(np.concatenate([run.correction[run.counts] for run in runs]) ** 2)))


def _baseline_and_runs(
    simulator: Simulator | LoadedModel, checked: CheckedTrials, signs: SensorSigns, decades: Decades
) -> tuple[Baseline, tuple[Run, ...]]:
    """Nominal simulator at the sample time of the trials, and the trials as runs with repaired sensor faults."""
    trials, given = decades.trials(checked.trials), decades.trials(checked.given)
    repaired_trials = [repaired(trial, signs) for trial in trials]
    command = Range(
        lower=min(float(t.command.min()) for t in repaired_trials),
        upper=max(float(t.command.max()) for t in repaired_trials),
    )
    before = [b.scaled(1 / decades.command) for b in checked.before]
    played = decades.trials([as_simulated(t) for t in checked.trials]) if have_simulated(checked.trials) else None
    if isinstance(simulator, Simulator):
        simulator_chain, chain = (decades.chain(s.chain) for s in (simulator, simulator.at_sample_time(checked.dt)))
        baseline = baseline_of(with_play_friction(chain, command), command)
        starts = starts_at_simulator_rate([repaired(trial, signs) for trial in given], simulator.dt_s, checked.dt)
        runs = _with_starts(baseline, runs_of(repaired_trials, None, before, starts), simulator, decades)
        if played is None:
            runs = corrected_to_simulator_rate(runs, given, chain, simulator_chain, simulator.dt_s)
        else:
            runs = _corrected(runs, output_corrections(baseline, simulator, decades, played, before))
    else:
        baseline, corrections = _network_baseline(simulator, repaired_trials, command, decades, played)
        if played is not None:
            corrections = output_corrections(baseline, simulator, decades, played, before)
        runs = runs_of(repaired_trials, corrections, before)
    if signs.spikes or signs.drops:
        problem, pairs = Problem(baseline), zip(runs, trials, strict=True)
        runs = tuple(replace(r, angle=repaired(t, signs, problem.angles(problem.as_given, r)).angle) for r, t in pairs)
    return baseline, runs


def output_corrections(
    baseline: Baseline,
    simulator: Simulator | LoadedModel,
    decades: Decades,
    played: Sequence[Trial],
    before: Sequence[Before],
) -> list[Vec]:
    """Output (T,) of the user's simulator minus that of its stand-in on each command, from the simulator's start [deg].

    Args:
        played: commands with the simulator's output as their angle, in working units, as `before` is.
    """
    runs, stand_in = runs_of(played, None, before), Problem(baseline)
    if isinstance(simulator, Simulator):
        runs = _with_starts(baseline, runs, simulator, decades)
    return [run.angle - stand_in.angles(stand_in.as_given, run) for run in runs]


def _corrected(runs: Sequence[Run], corrections: Sequence[Vec]) -> tuple[Run, ...]:
    return tuple(replace(run, correction=correction) for run, correction in zip(runs, corrections, strict=True))


def _with_starts(baseline: Baseline, runs: Sequence[Run], simulator: Simulator, decades: Decades) -> tuple[Run, ...]:
    """Runs with initial states estimated by the simulator as given, as in `evaluate` (`models.start`)."""
    u, y = simulator.trained_command, simulator.trained_angle_deg
    box = search_box(
        Range(lower=u.lower / decades.command, upper=u.upper / decades.command),
        Range(lower=y.lower / decades.angle, upper=y.upper / decades.angle),
    )
    problem = Problem(baseline)
    return tuple(problem.begun(problem.as_given, run, box) for run in runs)


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
    if not isinstance(simulator, Simulator):
        return Identification(method="network")
    identification = simulator.identification
    residuals = tuple(
        r.model_copy(update={"rmse_deg": r.rmse_deg / decades.angle, "bias_deg": r.bias_deg / decades.angle})
        for r in identification.residuals
    )
    return identification.model_copy(update={"residuals": residuals})


def shortage(trials: Sequence[Trial]) -> str:
    """Reason why trials are too short, or have too few reversals, for a diagnosis; otherwise empty."""
    seconds = sum(trial.duration_s for trial in trials)
    turns = sum(segment(trial).reversals.size for trial in trials)
    if seconds < _LEAST_S:
        return f"{seconds:.3g} s in all, expected {_LEAST_S:g} s or more"
    if turns < _LEAST_TURNS:
        return f"the command turns {turns} times in all, expected {_LEAST_TURNS} or more"
    return ""


def _network_baseline(
    model: LoadedModel,
    trials: Sequence[Trial],
    command: Range,
    decades: Decades,
    played: Sequence[Trial] | None = None,
) -> tuple[Baseline, list[Vec]]:
    """Plays as a baseline for a network, first order with effects, and the angle differences (T,) that they leave.

    Args:
        played: the same trials with the output of the user's simulator, which then counts in place of the network's.
    """
    if played is None:
        in_log = [replace(t, command=decades.command * t.command, angle=decades.angle * t.angle) for t in trials]
        angles = [free_run(model, trial.command, started(model, trial)) / decades.angle for trial in in_log]
    else:
        angles = [trial.angle for trial in played]
    copies = [replace(trial, angle=y) for trial, y in zip(trials, angles, strict=True)]
    baseline = ScaledBaseline(_plays(copies, command), command)
    problem = Problem(baseline)
    pairs = zip(angles, runs_of(trials), strict=True)
    return baseline, [y - problem.angles(problem.as_given, run) for y, run in pairs]


def _plays(copies: Sequence[Trial], command: Range) -> Chain:
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
    """Model-form error: mean square residual of the nominal simulator on its identification data [deg^2].

    Zero if unknown: the simulator's file stores no residuals, or it was identified on one of these trials (compared by
    fingerprint), so that its residuals contain the gap itself.
    """
    stored = identification.residuals
    if not stored or _identified_on(identification, trials, dt_s):
        return 0.0
    held = ["holds" if motion in ("holds", "steps", "point_to_point", "ramps") else "continuous" for motion in motions]
    everything = [r.rmse_deg**2 for r in stored]
    by_motion = [[r.rmse_deg**2 for r in stored if r.motion == kind] or everything for kind in held]
    return float(np.mean([np.mean(values) for values in by_motion]))


def _identified_on(identification: Identification, trials: Sequence[Trial], dt_s: float) -> bool:
    """Whether the simulator was identified on one or all of these trials, at any sampling rate."""
    known = {r.fingerprint for r in identification.residuals if r.fingerprint}
    # A file's sample time is rounded: 0.03333333333 s means 30 Hz, but 0.03 s means 1 / 0.03 Hz.
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
    """Parts of a trial between gaps, as in an identification; none if the trial is refused."""
    with suppress(LogError):
        return parts_at_gaps(trial)
    return ()


def nominal_noise_deg(identification: Identification, step_deg: float = 0.0) -> float | None:
    """Upper bound of the sensor's noise [deg], at identification with readings in steps [deg]; None if unknown.

    A residual with lag-one correlation c has at most the share 1 - c of its energy in white noise. Rounding of readings
    in steps is not white at slow motion, and counts in full: step / sqrt(12).
    """
    if not identification.residuals:
        return None
    white = float(np.median([r.rmse_deg * np.sqrt(max(1 - r.lag_one, 0.0)) for r in identification.residuals]))
    return max(white, step_deg / math.sqrt(12.0))


_SAME = 0.1  # of the error: errors that differ by less, or by at most the energy of the noise, are equal
_ROUNDED = 1e-3  # of a sample time, which files round


def corrected_to_simulator_rate(
    runs: Sequence[Run], recorded: Sequence[Trial], chain: Chain, simulator_chain: Chain, simulator_dt_s: float
) -> tuple[Run, ...]:
    """Runs with a correction: angles of the simulator at its sample time minus those at the sample time of the runs.

    Operators are exact at any sample time only for some inputs, such as a lag for steps. The correction is exact for
    the nominal simulator, and of first order otherwise. There is none if the simulator is no faster than its diagnosis,
    or a log is too slow for its sample time.
    """
    if simulator_dt_s >= runs[0].dt_s * (1 - _ROUNDED):
        return tuple(runs)
    corrected = []
    for run, trial in zip(runs, recorded, strict=True):
        fast = resampled_or_none(trial, 1 / simulator_dt_s)
        if fast is None:
            return tuple(runs)
        there = trial.t[0] + run.dt_s * np.arange(run.command.size)
        angles = np.interp(there, fast.t, _angles(simulator_chain, run, fast.command, simulator_dt_s))
        corrected.append(replace(run, correction=angles - _angles(chain, run, run.command, run.dt_s)))
    return tuple(corrected)


def starts_at_simulator_rate(recorded: Sequence[Trial], simulator_dt_s: float, dt_s: float) -> tuple[TrialStart, ...]:
    """Initial states of the trials, estimated at the simulator's sample time as in `evaluate`."""
    starts = []
    for trial in recorded:
        resampled = resampled_or_none(trial, 1 / simulator_dt_s) or resampled_or_none(trial, 1 / dt_s) or trial
        start = trial_start(resampled.command, resampled.angle, resampled.dt)
        starts.append(replace(start, lead=round(start.lead * resampled.dt / dt_s)))
    return tuple(starts)


def resampled_or_none(trial: Trial, rate_hz: float) -> Trial | None:
    """Trial resampled to a simulator's rate as in `evaluate`; None if the log is too slow."""
    with suppress(LogError):
        return resample(trial, rate_hz)
    return None


def evaluated_mse(simulator: Simulator, recorded: Sequence[Trial], skip_first_flexure: bool = False) -> float | None:
    """Mean square error of a free run as in `evaluate` on trials without gaps [deg^2]; None if a log is too slow."""
    facts, staged = simulator.metadata(), StagedChain(simulator.chain)
    run = staged.rollouts(simulator.dt_s, simulator.chain.values)
    box, squares, samples = search_box(facts.trained_command, facts.trained_angle), 0.0, 0
    for trial in recorded:
        if (resampled := resampled_or_none(trial, 1 / simulator.dt_s)) is None:
            return None
        start = trial_start(resampled.command, resampled.angle, resampled.dt)
        start = estimated_start(start, resampled.command, resampled.angle, resampled.dt, box, run)
        error = _free_run_from(run, start, resampled.command) - resampled.angle
        error = error[max(start.lead, first_flexure_end(resampled) if skip_first_flexure else 0) :]
        squares, samples = squares + float(error @ error), samples + error.size
    return squares / samples


def _evaluation_notes(
    simulator: Simulator, errors: Sequence[Vec], checked: CheckedTrials, skip_first_flexure: bool
) -> tuple[str, ...]:
    """Note if `evaluate` gives another error of the nominal simulator than these errors (C,) [unit of the log]."""
    given_mse, noise_mse = float(np.mean(np.concatenate(errors) ** 2)), white_noise(errors) ** 2
    evaluated, dt_s = evaluated_mse(simulator, checked.given, skip_first_flexure), checked.dt
    unit, simulator_hz, hz = simulator.angle_unit, 1 / simulator.dt_s, 1 / dt_s
    if evaluated is None:
        slowest = max(checked.given, key=lambda trial: trial.dt)
        return (
            f"The simulator is of {simulator_hz:.4g} Hz and {Path(slowest.source).name} of {1 / slowest.dt:.4g} Hz: "
            f"`evaluate` does not run it over these trials, and the diagnosis runs it at {hz:.4g} Hz.",
        )
    mine, other = math.sqrt(given_mse), math.sqrt(evaluated)
    if abs(mine - other) <= _SAME * max(mine, other) or abs(given_mse - evaluated) <= noise_mse:
        return ()
    rates = abs(simulator.dt_s - dt_s) > _ROUNDED * dt_s
    why = (
        f"`evaluate` runs it at {simulator_hz:.4g} Hz, the diagnosis at {hz:.4g} Hz"
        if rates
        else "the diagnosis lets trials that rest at one command begin alike, and finds other starts to first order"
    )
    return (
        f"`evaluate` gives another error of the simulator as given, {other:.3g} {unit} RMS over all trials instead of "
        f"{mine:.3g} {unit}: {why}.",
    )


def _angles(chain: Chain, run: Run, commands: Vec, dt_s: float) -> Vec:
    """Angles (T,) of a chain over commands (T,) at a sample time, from the start of a run [deg]."""
    way = np.array(run.approach)
    if way.size:
        steps = np.arange(round(way.size * run.dt_s / dt_s)) * dt_s / run.dt_s
        way = np.interp(steps, np.arange(way.size), way)
    start = TrialStart(run.rest_command, run.rest_angle, run.lead, tuple(way.tolist()))
    return _free_run_from(StagedChain(chain).rollouts(dt_s, chain.values), start, commands)


def _free_run_from(run: Runs, start: TrialStart, commands: Vec) -> Vec:
    plan = np.concatenate([start.approach, commands])
    return np.asarray(run(np.array([start.command]), np.array([start.angle]), plan[None])[0, len(start.approach) :])


_ONE_REST = 0.01  # of the command's range: rests this near to each other are one
_LEAST_SAMPLES = 3
_BEYOND = 3.0  # times what motions change the angle at rest by: more has another cause than a motion
_BEYOND_FORM = 2.0  # times the model-form error (RMS): less does not matter


def common_rest(runs: tuple[Run, ...], form_mse: float) -> tuple[Run, ...]:
    """Give all runs one rest angle if friction cannot explain the scatter of their rest angles.

    A trial that returns to its rest command shows the change of the angle by its motion. If the rest angles of the
    trials differ by three times the greatest such change, another cause, such as a moved mounting, is likely: all runs
    then begin at the median angle, and the difference stays in the error.
    """
    span = max(float(run.command.max()) for run in runs) - min(float(run.command.min()) for run in runs)
    commands, angles = np.array([(run.rest_command, run.rest_angle) for run in runs]).T
    changes = [change for run in runs if (change := _rest_angle_change(run, _ONE_REST * span)) is not None]
    spread = float(np.ptp(angles))
    if 2 * len(changes) < len(runs) or np.ptp(commands) > _ONE_REST * span:
        return runs
    if spread <= max(_BEYOND * max(changes), _BEYOND_FORM * form_mse**0.5):
        return runs
    return tuple(replace(run, rest_angle=runs[0].rest_angle) for run in runs)


def _rest_angle_change(run: Run, near: float) -> float | None:
    """Change of the rest angle over the motion [deg]; None if the command does not return to its rest."""
    away = np.flatnonzero(np.abs(run.command - run.rest_command) > near)
    back = run.angle[away[-1] + 1 :] if away.size else run.angle[:0]
    return abs(float(np.mean(back)) - run.rest_angle) if back.size >= _LEAST_SAMPLES else None
