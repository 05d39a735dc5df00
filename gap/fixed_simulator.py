"""The corrected simulator: retuned, with the effects found, and honest about what it leaves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.models.effects.place import PlacedEffect, effect_spec
from hystmpc.models.fit.identify import HOLDS_SHARE
from hystmpc.models.fit.trial_set import fingerprint
from hystmpc.models.operators.catalogue import operator_spec
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.periodic_disturbance import PeriodicDisturbance
from hystmpc.models.simulator import Identification, Residual, Simulator
from hystmpc.models.staged.chain_run import StagedChain
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.segments import Motion, first_flexure_end, segment
from hystmpc.trials.trial import Trial

from .hypothesis import Hypothesis
from .logs.preparation import PreparedTrials
from .next.open_hypotheses import settled

EFFECTS_FILE = "effects.yaml"
_FORMAT = "hystmpc-effects/1"


def fixed_simulator(simulator: Simulator, chosen: Hypothesis, prepared: PreparedTrials) -> Simulator:
    """A simulator retuned and with its causes.

    A disturbance has the amplitude, the frequency and the phase of the last trial. What each trial has of its own
    (`trial_shift`) and a faulty sensor are no part of it, and what is carried from trial to trial begins anew; the
    method says so. Residuals are those of the file as it stands, on the development trials, as `fit` stores them.

    Args:
        simulator: as given.
        chosen: fitted, with its causes.
        prepared: trials.
    """
    chain = chosen.problem.fitted_chain(chosen.q)
    disturbance = _disturbance(chosen, prepared, simulator.dt_s)
    if disturbance is not None:
        chain = replace(chain, after=(*chain.after, disturbance))
    note = f"{simulator.identification.method}; diagnosed: {chosen.label}{_remarks(chosen)}"
    return replace(simulator, chain=chain, identification=_identification(simulator, chain, prepared, note))


def network_effects(chosen: Hypothesis, prepared: PreparedTrials, simulator: str) -> dict[str, str]:
    """The file that stands beside a network, which cannot hold effects itself; none where there are no effects."""
    effects = [_spec(c.effect, c.side, operator) for c, operator in _placed(chosen)]
    disturbance = _disturbance(chosen, prepared, prepared.checked.dt)
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
        "retuned": {name: float(value) for name, value in prepared.baseline.quantities(z).items()},
        "effects": effects,
    }
    return {EFFECTS_FILE: dump_yaml(content)}


def _disturbance(chosen: Hypothesis, prepared: PreparedTrials, dt_s: float) -> Operator | None:
    """The disturbance of the last trial, for a clock of that sample time; None if there is none.

    Terms are s_h sin(2 pi h f t) + c_h cos(2 pi h f t), taken off the error; the operator's clock has made one step
    at the first sample.
    """
    terms = chosen.problem.terms
    if not terms.frequency_hz:
        return None
    run = prepared.everything[-1]
    theta, by_q = chosen.problem.linearised(chosen.q, run)
    weights = np.linalg.lstsq(terms.columns(run, theta, by_q), run.angle - theta, rcond=None)[0]
    sines, cosines = weights[-2 * terms.harmonics :].reshape(-1, 2).T
    turns = 2 * math.pi * terms.frequency_hz * dt_s * np.arange(1, terms.harmonics + 1)
    phases = np.arctan2(cosines, sines) - turns
    wrapped = np.angle(np.exp(1j * phases))
    return PeriodicDisturbance(terms.frequency_hz, tuple(np.hypot(sines, cosines).tolist()), tuple(wrapped.tolist()))


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


def _identification(simulator: Simulator, chain: Chain, prepared: PreparedTrials, note: str) -> Identification:
    """Where the numbers come from, with the residuals on the development trials."""
    names = {run.name for run in prepared.development}
    at = [k for k, run in enumerate(prepared.everything) if run.name in names]
    given = [prepared.given[k] for k in at]
    skip = simulator.identification.skip_first_flexure
    return Identification(
        method=note,
        seed=simulator.identification.seed,
        skip_first_flexure=skip,
        training_data_hash=fingerprint(given),
        residuals=tuple(_residual(chain, _mended(prepared, k), prepared.given[k], skip) for k in at),
    )


def _residual(chain: Chain, trial: Trial, given: Trial, skip_first_flexure: bool) -> Residual:
    """What the chain leaves of a trial, as `fit` stores it; it starts as anew, at rest at the first command."""
    state = settled(chain, float(trial.command[0]), float(trial.angle[0]), -math.inf, 0.0)
    theta = StagedChain(chain).simulate(trial.command[:, None], trial.dt, state[:, None])[0][:, 0]
    parts = segment(trial)
    start = first_flexure_end(trial) if skip_first_flexure and parts.reversals.size else 0
    error = (theta - trial.angle)[start:]
    around = error - error.mean()
    power = float(around @ around)
    held = float(np.mean(parts.labels == Motion.HOLD))
    return Residual(
        log=Path(given.source).name,
        motion="holds" if held >= HOLDS_SHARE else "continuous",
        samples=error.size,
        rmse_deg=float(np.sqrt(np.mean(error**2))),
        bias_deg=float(np.mean(error)),
        lag_one=float(np.clip(around[1:] @ around[:-1] / power, -1, 1)) if power > 0 else 0.0,
        fingerprint=fingerprint([given]),
    )


def _mended(prepared: PreparedTrials, k: int) -> Trial:
    """A trial at the common rate, the sensor's faults repaired."""
    trial = prepared.checked.trials[k]
    return Trial(trial.t, trial.command, prepared.everything[k].angle, units=trial.units, source=trial.source)


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
