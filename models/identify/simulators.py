"""Simulators of identified chains, also with the corrections of a diagnosis, and their residuals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import FitError
from hystmpc.trials.segments import Motion, first_flexure_end, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..chain import Chain, operator_spec
from ..contract.metadata import DeviceLimits, NoiseModel, Range
from ..decades import Decades
from ..effects.catalogue import EFFECTS
from ..effects.place import PlacedEffect, effect_spec
from ..evaluate import evaluate
from ..model import FitProgress
from ..operators.hysteresis import Backlash
from ..operators.measurement import PeriodicDisturbance
from ..operators.operator import Operator
from ..operators.slow_changes import Drift, FirstFlexure
from ..simulator import ChainModel, Identification, Residual, Simulator
from ..start import trial_start
from .baseline import Baseline, without_idle_friction
from .chain_fit import ChainFit, OperatorFitSettings, identify_chain
from .cross_validation import Hypothesis
from .estimation_noise import estimation_noise
from .free_run import StagedChain
from .least_squares import one_blas_thread
from .runs import Run, angle_range, check_trial_set, command_range, fastest_command, fingerprint
from .uncertainty import BASELINE_UNITS

EFFECTS_FILE = "effects.yaml"
HOLDS_SHARE = 0.2
_FORMAT = "hystmpc-effects/1"
_SETTLE_S, _SETTLE_DT = 1800.0, 2.0


@one_blas_thread
def identify(
    kind: str,
    trials: Sequence[Trial],
    settings: OperatorFitSettings | None = None,
    plays: int = 4,
    limits: DeviceLimits | None = None,
    progress: FitProgress | None = None,
) -> tuple[Simulator, ChainFit]:
    """Identify the simulator of a kind of chain by least squares; arguments and errors as of `identify_chain`.

    Raises:
        FitError: also where the lines of a backlash cross within the trained range.
    """
    settings = settings or OperatorFitSettings()
    chain, fit = identify_chain(kind, trials, settings=settings, plays=plays, progress=progress)
    words, skip = "bounded least squares on free runs", settings.skip_first_flexure
    return simulator_of(chain, trials, limits or DeviceLimits(), words, settings.seed, skip), fit


def simulator_of(
    chain: Chain,
    trials: Sequence[Trial],
    limits: DeviceLimits,
    method: str,
    seed: int = 0,
    skip_first_flexure: bool = False,
    noise: NoiseModel | None = None,
) -> Simulator:
    """Simulator of an identified chain with the metadata of its trials, and the residuals of its free runs.

    Args:
        skip_first_flexure: whether each trial counted from the first reversal of its command on.
        noise: noise on held-out trials; that on these trials where left out.

    Raises:
        FitError: on unusable trials, or a backlash whose lines cross within the trained range.
    """
    _check_lines(chain, command_range(trials))
    dt_s, box = check_trial_set(trials), limits.command or command_range(trials)

    def build(residuals: tuple[Residual, ...], noise: NoiseModel | None) -> Simulator:
        return Simulator(
            chain=chain,
            dt_s=dt_s,
            command_unit=trials[0].units.command,
            angle_unit=trials[0].units.angle,
            inverse=trials[0].inverted,
            rest_command=_rest_command(trials, box),
            command_limits=box,
            command_rate_per_s=limits.rate_per_s or fastest_command(trials),
            trained_command=command_range(trials),
            trained_angle_deg=angle_range(trials),
            trained_rate_per_s=fastest_command(trials),
            identification=Identification(
                method=method,
                seed=seed,
                skip_first_flexure=skip_first_flexure,
                training_data_hash=fingerprint(trials),
                residuals=residuals,
                noise=noise,
            ),
        ).at_sample_time(dt_s)

    model = ChainModel(build((), None))
    runs = [(trial, evaluate(model, trial, skip_first_flexure)) for trial in trials]
    if noise is None and not model.metadata.inverted:
        errors = [(trial.angle - run.theta)[run.start :] for trial, run in runs]
        noise = estimation_noise(trials, errors, chain.values.size)
    return build(tuple(residual(trial, trial, run.theta, run.start) for trial, run in runs), noise)


def _rest_command(trials: Sequence[Trial], limits: Range) -> float | None:
    """Command at rest before the trials, else the one at which they begin; None for the lower end of its range."""
    if trials[0].inverted:
        return None
    starts = [trial_start(trial.command, trial.angle, trial.dt) for trial in trials]
    rests = [start.command for start in starts if start.at_rest] or [float(trial.command[0]) for trial in trials]
    rest = float(np.median(rests))
    return rest if rest > limits.lower + _FROM_BELOW * (limits.upper - limits.lower) else None


_FROM_BELOW = 0.01  # share of the command's range: trials that begin higher do not begin at its lower end


def residual(log: Trial, trial: Trial, theta: Vec, start: int) -> Residual:
    """Residual of a simulator on a trial.

    Args:
        theta: the simulator's free run (T,) [deg].
        start: first sample that counts.
    """
    error = (theta - trial.angle)[start:]
    around = error - error.mean()
    power = float(np.sum(around**2))
    held = float(np.mean(segment(trial).labels == Motion.HOLD))
    return Residual(
        log=Path(log.source).name,
        motion="holds" if held >= HOLDS_SHARE else "continuous",
        samples=error.size,
        rmse_deg=float(np.sqrt(np.mean(error**2))),
        bias_deg=float(np.mean(error)),
        lag_one=float(np.clip(np.sum(around[1:] * around[:-1]) / power, -1, 1)) if power > 0 else 0.0,
        fingerprint=fingerprint([log]),
    )


def _check_lines(chain: Chain, trained: Range) -> None:
    """Refuse a backlash whose unloading line dips below its loading line: it has no inverse there."""
    if isinstance(chain.core, Backlash) and chain.core.crosses(trained.lower, trained.upper):
        depth, u = min((chain.core.gap(u), u) for u in (trained.lower, trained.upper))
        raise FitError(
            f"the fitted lines cross: at command {u:.4g} unloading lies {-depth:.3g} deg below loading, expected "
            "above; is the sign of the command right?"
        )


def corrected_simulator(
    simulator: Simulator,
    chosen: Hypothesis,
    runs: Sequence[Run],
    development: Sequence[Run],
    trials: Sequence[Trial],
    given: Sequence[Trial],
    decades: Decades,
    skip_first_flexure: bool = False,
) -> Simulator:
    """Retuned simulator with the identified effects.

    A disturbance has the amplitude, the frequency and the phase of the last trial. Terms of single trials
    (`trial_shift`) and a faulty sensor are not included, and memory is reset for each trial; the method says so.
    Residuals and noise are those of this simulator on the development trials, as `fit` stores them.

    Args:
        runs: all trials in recording order, the sensor's faults repaired.
        trials, given: all trials at the common rate, and as recorded.
        decades: units in which the simulator was fitted and the runs are; the trials are in those of the log.
        skip_first_flexure: whether the trials counted from their first reversal on only.
    """
    chain = decades.log_chain(without_idle_friction(chosen.chain))
    disturbance = _disturbance(chosen, runs[-1], runs[-1].dt_s, decades)
    if disturbance is not None:
        chain = replace(chain, after=(*chain.after, disturbance))
    names, skip = {run.name for run in development}, simulator.identification.skip_first_flexure or skip_first_flexure
    fitted = [(run, trial, log) for run, trial, log in zip(runs, trials, given, strict=True) if run.name in names]
    compared = [_compared(chain, decades.angle * run.angle, trial, skip) for run, trial, _ in fitted]
    errors = [(trial.angle - theta)[start:] for trial, theta, start in compared]
    identification = Identification(
        method=f"{simulator.identification.method}; diagnosed: {chosen.label}{_remarks(chosen)}",
        seed=simulator.identification.seed,
        skip_first_flexure=skip,
        training_data_hash=fingerprint([log for *_, log in fitted]),
        residuals=tuple(residual(log, *pair) for (*_, log), pair in zip(fitted, compared, strict=True)),
        noise=estimation_noise([trial for trial, *_ in compared], errors, chosen.problem.size),
    )
    corrected = replace(simulator, chain=chain, identification=identification, dt_s=runs[-1].dt_s)
    return corrected.at_sample_time(simulator.dt_s)


def network_effects(
    chosen: Hypothesis, baseline: Baseline, last: Run, dt_s: float, simulator: str, decades: Decades
) -> dict[str, str]:
    """File of effects for a network, which cannot contain them; none where there are no effects.

    Args:
        baseline: plays that represent the network.
        decades: units in which the effects were fitted; the file is in those of the log.
    """
    effects = [_spec(c.effect, c.side, decades.log_operator(operator, c.side)) for c, operator in _placed(chosen)]
    disturbance = _disturbance(chosen, last, dt_s, decades)
    if disturbance is not None:
        effects.append(effect_spec(PlacedEffect(EFFECTS[disturbance.name], "output", disturbance)))
    if not effects:
        return {}
    z = chosen.z
    content: dict[str, Any] = {
        "format": _FORMAT,
        "note": (
            f"Effects found beside {simulator}, identified through plays that stand for the network: exact while "
            "nothing else changes, first order beyond. No simulator by itself; the effects have the form of a "
            f"study's plant.effects.{_remarks(chosen)}"
        ),
        "retuned": {
            name: decades.log_value(float(value), BASELINE_UNITS[name])
            for name, value in baseline.quantities(z).items()
        },
        "effects": effects,
    }
    return {EFFECTS_FILE: dump_yaml(content)}


def _disturbance(chosen: Hypothesis, last: Run, dt_s: float, decades: Decades) -> Operator | None:
    """Disturbance of the last trial, whose clock has made one step at the first sample; None if there is none."""
    terms = chosen.problem.terms
    if not terms.frequency_hz:
        return None
    theta, by_q = chosen.problem.linearised(chosen.q, last)
    weights = np.linalg.lstsq(terms.columns(last, theta, by_q), last.angle - theta, rcond=None)[0]
    sines, cosines = weights[-2 * terms.harmonics :].reshape(-1, 2).T
    turns = 2 * math.pi * terms.frequency_hz * dt_s * np.arange(1, terms.harmonics + 1)
    phases = np.angle(np.exp(1j * (np.arctan2(cosines, sines) - turns)))
    sizes = decades.angle * np.hypot(sines, cosines)
    return PeriodicDisturbance(terms.frequency_hz, tuple(sizes.tolist()), tuple(phases.tolist()))


def _remarks(chosen: Hypothesis) -> str:
    said = []
    if chosen.problem.terms.shift:
        said.append("shifts from trial to trial are not in this file")
    if chosen.problem.terms.frequency_hz:
        said.append("the disturbance has the phase of the last trial")
    carried = {"bend": "the first flexure starts anew", "clock": "the drift starts at the first trial"}
    said += [carried[c.carries] for c in chosen.problem.effects if c.carries]
    return "".join(f"; {text}" for text in said)


def _compared(chain: Chain, angle: Vec, trial: Trial, skip_first_flexure: bool) -> tuple[Trial, Vec, int]:
    """Trial with the repaired angle (T,), free run (T,) of the chain from rest, and first sample that counts."""
    repaired = Trial(trial.t, trial.command, angle, units=trial.units, source=trial.source)
    state = settled(chain, float(trial.command[0]), float(angle[0]), -math.inf, 0.0)
    theta = StagedChain(chain).simulate(trial.command[:, None], trial.dt, state[:, None])[0][:, 0]
    moves = skip_first_flexure and segment(repaired).reversals.size
    return repaired, theta, first_flexure_end(repaired) if moves else 0


def _placed(chosen: Hypothesis) -> list[tuple[Any, Operator]]:
    problem = chosen.problem
    chain, nominal = problem.fitted_chain(chosen.q), problem.baseline.chain
    lead = len(chain.before) - len(nominal.before)
    fitted = [*chain.before[:lead], *chain.after[len(nominal.after) :]]
    order = [
        c
        for side in ("command", "output")
        for c in sorted((c for c in problem.effects if c.side == side), key=lambda c: c.order)
        for _ in c.operators
    ]
    return list(zip(order, fitted, strict=True))


def _spec(effect: str, side: str, operator: Operator) -> Mapping[str, Any]:
    spec = dict(operator_spec(operator))
    kind = spec.pop("operator")
    head: dict[str, Any] = {"effect": effect, "side": side}
    return head | spec if kind == effect else head | {"operator": kind} | spec


def settled(chain: Chain, command: float, angle: float, bent: float, clock_s: float) -> Vec:
    """State (S,) of a chain after a long rest.

    The command is held for half an hour, as creep before a play moves it. Clocks and running maxima are set afterwards.

    Args:
        command: constant [cmd].
        angle: approximate angle of the device [deg].
        bent: greatest command of the device so far [cmd]; the rest command for a device without that memory.
        clock_s: of the device [s].
    """
    staged = StagedChain(chain)
    start = staged.rest(np.array([command]), np.array([angle]))
    held = np.full((round(_SETTLE_S / _SETTLE_DT), 1), command)
    state: Vec = staged.simulate(held, _SETTLE_DT, start)[1][:, 0]
    at = 0
    for operator in chain.operators:
        if isinstance(operator, Drift):
            state[at], state[at + 1] = clock_s, 0.0  # time and travel
        if isinstance(operator, FirstFlexure):
            state[at] = max(float(state[at]), bent)
        at += len(operator.states)
    return state
