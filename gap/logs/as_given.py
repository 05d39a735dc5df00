"""The simulator as given: where its free runs begin, its sample time, and whether `evaluate` finds the same error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.identify.runs import Run
from hystmpc.models.simulator import Simulator
from hystmpc.models.start import Runs, TrialStart, estimated_start, search_box, trial_start
from hystmpc.trials.errors import LogError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial, resample
from hystmpc.trials.types import Vec

_SAME = 0.1  # of the error: two that differ by less, or by no more energy than the noise has, say the same
_ROUNDED = 1e-3  # of a sample time, which files round


def corrected_to_simulator_rate(
    runs: Sequence[Run], recorded: Sequence[Trial], chain: Chain, simulator_chain: Chain, simulator_dt_s: float
) -> tuple[Run, ...]:
    """Add a correction to the runs: the difference between the simulator's angles at its own sample time and at theirs.

    An operator is exact at any sample time for some inputs only, such as a lag for one in steps. Where the simulator
    is faster than its diagnosis, the difference of its angles at the two sample times is added to all free runs: exact
    for the simulator as given, and to first order with other numbers or effects. Nothing is added where it is as fast
    or slower, or where a log is too slow for its sample time.

    Args:
        runs: at the sample time of the diagnosis.
        recorded: the trials as recorded, in the units of the runs.
        chain, own: the simulator's at that sample time, and at its own.
        simulator_dt_s: its own sample time [s].
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
    """Initial states of the trials, found at the simulator's own sample time as `evaluate` does.

    Args:
        recorded: the trials as recorded, in the units of the runs.
        simulator_dt_s, dt_s: sample time of the simulator, and of the diagnosis [s].
    """
    starts = []
    for trial in recorded:
        resampled = resampled_or_none(trial, 1 / simulator_dt_s) or resampled_or_none(trial, 1 / dt_s) or trial
        start = trial_start(resampled.command, resampled.angle, resampled.dt)
        starts.append(replace(start, lead=round(start.lead * resampled.dt / dt_s)))
    return tuple(starts)


def resampled_or_none(trial: Trial, rate_hz: float) -> Trial | None:
    """A trial at a simulator's rate, as `evaluate` takes it; None where the log is too slow for it."""
    with suppress(LogError):
        return resample(trial, rate_hz)
    return None


def evaluated_mse(simulator: Simulator, recorded: Sequence[Trial], skip_first_flexure: bool = False) -> float | None:
    """Mean square error that `evaluate` finds on trials without gaps [deg^2]; None where one is too slow for it.

    A free run at the simulator's sample time, from where `evaluate` lets a trial begin (`models.start`).
    """
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


def evaluation_notes(
    simulator: Simulator,
    given_mse: float,
    noise_mse: float,
    evaluated: float | None,
    recorded: Sequence[Trial],
    dt_s: float,
) -> tuple[str, ...]:
    """Note that `evaluate` finds another error of the simulator as given; none where the two agree.

    Args:
        simulator: as given.
        given_mse: its error in the diagnosis, over all trials as measured [deg^2].
        noise_mse: white noise of the sensor, which other sample times meet in other readings [deg^2].
        evaluated: the error that `evaluate` finds (`evaluated_mse`) [deg^2].
        recorded: the trials, cut at gaps.
        dt_s: sample time of the diagnosis [s].
    """
    unit, own_hz, hz = simulator.angle_unit, 1 / simulator.dt_s, 1 / dt_s
    if evaluated is None:
        slowest = max(recorded, key=lambda trial: trial.dt)
        return (
            f"The simulator is of {own_hz:.4g} Hz and {Path(slowest.source).name} of {1 / slowest.dt:.4g} Hz: "
            f"`evaluate` does not run it over these trials, and the diagnosis runs it at {hz:.4g} Hz.",
        )
    mine, other = math.sqrt(given_mse), math.sqrt(evaluated)
    if abs(mine - other) <= _SAME * max(mine, other) or abs(given_mse - evaluated) <= noise_mse:
        return ()
    rates = abs(simulator.dt_s - dt_s) > _ROUNDED * dt_s
    why = (
        f"`evaluate` runs it at {own_hz:.4g} Hz, the diagnosis at {hz:.4g} Hz"
        if rates
        else "the diagnosis lets trials that rest at one command begin alike, and finds other starts to first order"
    )
    return (
        f"`evaluate` gives another error of the simulator as given, {other:.3g} {unit} RMS over all trials instead of "
        f"{mine:.3g} {unit}: {why}.",
    )


def _angles(chain: Chain, run: Run, commands: Vec, dt_s: float) -> Vec:
    """Angles (T,) of a chain over commands (T,) at a sample time, from where a run begins [deg]."""
    way = np.array(run.approach)
    if way.size:
        steps = np.arange(round(way.size * run.dt_s / dt_s)) * dt_s / run.dt_s
        way = np.interp(steps, np.arange(way.size), way)
    start = TrialStart(run.rest_command, run.rest_angle, run.lead, tuple(way.tolist()))
    return _free_run_from(StagedChain(chain).rollouts(dt_s, chain.values), start, commands)


def _free_run_from(run: Runs, start: TrialStart, commands: Vec) -> Vec:
    """Angles (T,) over commands (T,) from a start on [deg]."""
    plan = np.concatenate([start.approach, commands])
    return np.asarray(run(np.array([start.command]), np.array([start.angle]), plan[None])[0, len(start.approach) :])


_ONE_REST = 0.01  # of the command's range: rests this near to each other are one
_LEAST_SAMPLES = 3
_BEYOND = 3.0  # times what motions change the angle at rest by: more does not come from a motion
_BEYOND_FORM = 2.0  # times the model-form error (RMS): less does not matter


def common_rest(runs: tuple[Run, ...], form_mse: float) -> tuple[Run, ...]:
    """Give all runs one rest angle where friction cannot explain the scatter of their rest angles.

    A friction keeps an angle until a motion changes it. A trial that comes back to the command at which it rested shows
    how much its motion did. Where the angles at rest of the trials differ by three times the most that any of these
    motions did, something else has moved them between the trials: a mounting, a drift, a zero. A core must not take
    that up as the state in which its plays begin: wide plays would keep it for the whole trial. All runs then begin
    at the median angle, and what differs is left in the error.

    Args:
        runs: all trials.
        form_mse: model-form error of the simulator [deg^2].
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
