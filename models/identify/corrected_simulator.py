"""The corrected simulator: retuned, with the effects found, and with the residuals that it leaves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hystmpc.trials.config import dump_yaml
from hystmpc.trials.segments import first_flexure_end, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..chain import Chain, operator_spec
from ..decades import Decades
from ..effects.catalogue import EFFECTS
from ..effects.place import PlacedEffect, effect_spec
from ..operators.measurement import PeriodicDisturbance
from ..operators.operator import Operator
from ..operators.slow_changes import Drift, FirstFlexure
from ..simulator import Identification, Simulator
from .baseline import Baseline
from .cross_validation import Hypothesis
from .estimation_noise import estimation_noise
from .free_run import StagedChain
from .methods import residual
from .runs import Run, fingerprint
from .uncertainty import BASELINE_UNITS

EFFECTS_FILE = "effects.yaml"
_FORMAT = "hystmpc-effects/1"
_SETTLE_S, _SETTLE_DT = 1800.0, 2.0


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
    """A simulator retuned, with the effects found.

    A disturbance has the amplitude, the frequency and the phase of the last trial. What each trial has of its own
    (`trial_shift`) and a faulty sensor are not included, and what is carried from trial to trial begins anew; the
    method says so. Residuals and noise are those of the file as it stands, on the development trials, as `fit` stores
    them.

    Args:
        simulator: as given.
        chosen: fitted, with its causes.
        runs: all trials in recording order, the sensor's faults repaired.
        development: those that were fitted.
        trials, given: all trials at the common rate, and as recorded.
        decades: units in which the simulator was fitted and the runs are; the trials are in those of the log.
        skip_first_flexure: whether the trials counted from their first reversal on only.
    """
    chain = decades.log_chain(chosen.problem.fitted_chain(chosen.q))
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
    """The file that stands beside a network, which cannot hold effects itself; none where there are no effects.

    Args:
        chosen: fitted, with its causes.
        baseline: the plays that stand for the network.
        last: trial recorded last.
        dt_s: sample time of the trials [s].
        simulator: what the network is called in the file's note.
        decades: units in which the effects were fitted; the file is in those of the log.
    """
    effects = [_spec(c.effect, c.side, decades.log_operator(operator, c.side)) for c, operator in _placed(chosen)]
    disturbance = _disturbance(chosen, last, dt_s, decades)
    if disturbance is not None:
        effects.append(effect_spec(PlacedEffect(EFFECTS[disturbance.name], "output", disturbance)))
    if not effects:
        return {}
    z = chosen.problem.retuned(chosen.q)
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
    """The disturbance of the last trial, for a clock of that sample time; None if there is none.

    Terms are s_h sin(2 pi h f t) + c_h cos(2 pi h f t), taken off the error; the operator's clock has made one step
    at the first sample.
    """
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
    """What the file leaves out."""
    said = []
    if chosen.problem.terms.shift:
        said.append("shifts from trial to trial are not in this file")
    if chosen.problem.terms.frequency_hz:
        said.append("the disturbance has the phase of the last trial")
    carried = {"bend": "the first flexure starts anew", "clock": "the drift starts at the first trial"}
    said += [carried[c.carries] for c in chosen.problem.effects if c.carries]
    return "".join(f"; {text}" for text in said)


def _compared(chain: Chain, angle: Vec, trial: Trial, skip_first_flexure: bool) -> tuple[Trial, Vec, int]:
    """A trial with the angle as repaired (T,), the chain's free run (T,), and the first sample that counts.

    The chain starts anew, at rest at the first command.
    """
    repaired = Trial(trial.t, trial.command, angle, units=trial.units, source=trial.source)
    state = settled(chain, float(trial.command[0]), float(angle[0]), -math.inf, 0.0)
    theta = StagedChain(chain).simulate(trial.command[:, None], trial.dt, state[:, None])[0][:, 0]
    moves = skip_first_flexure and segment(repaired).reversals.size
    return repaired, theta, first_flexure_end(repaired) if moves else 0


def _placed(chosen: Hypothesis) -> list[tuple[Any, Operator]]:
    """Candidates with their operators as identified, in the order of the signal."""
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

    The start at rest is known for each operator alone; in a chain, creep before a play moves on from there. The command
    is therefore held for half an hour. Clocks and running maxima are set afterwards.

    Args:
        chain: with its numbers.
        command: held [cmd].
        angle: approximate angle of the device [deg].
        bent: greatest command that the device has seen [cmd]; the rest command for one that forgets.
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
