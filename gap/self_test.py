"""Self-test of the diagnosis on simulated devices with known effects."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.effects.catalogue import EFFECTS, diagnosable
from hystmpc.models.effects.place import effect_from
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.identify.simulators import identify, settled
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.friction import Asymmetry, RateDependence, StickSlip
from hystmpc.models.operators.measurement import PeriodicDisturbance, Sensor
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.operators.slow_changes import Creep, Drift, FirstFlexure, TrialShift
from hystmpc.models.operators.static_curves import Contact, NonlinearGain, Slack
from hystmpc.models.simulator import Simulator
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress, Vec

from .diagnose import conclude, find_causes
from .diagnosis import Diagnosis

_DT_S, _TRIAL_S, _SPAN, _SPEED = 0.04, 20.0, 6.0, 12.0
_DEVICE = PrandtlIshlinskii(3.0, (3.0, 2.0, 1.0), 0.25, 0.0, 20.0)
_SENSOR = Sensor(0.0, 0.08, 0.0, 0.0, 0.0)
_SHIFT_SEED = 77  # of the phases and shifts of each trial


@dataclass(frozen=True)
class SelfTestRow:
    """Result of one case of the self-test.

    Attributes:
        named: named effects; indistinguishable ones are joined by `|`.
        passed: whether the true effect was identified, alone or in an indistinguishable set.
    """

    name: str
    truth: str
    verdict: str
    named: str
    closed_share: float
    seconds: float
    passed: bool


@dataclass(frozen=True)
class _Case:
    """Device of the self-test with known effects.

    Attributes:
        before, after: their operators on the command and on the angle.
        off: deviation of the device from its simulator: gain, and offset [deg].
        per_trial: operator of each trial, drawn from a generator.
    """

    truth: tuple[str, ...] = ()
    before: tuple[Operator, ...] = ()
    after: tuple[Operator, ...] = ()
    off: tuple[float, float] = (1.0, 0.0)
    per_trial: Callable[[np.random.Generator], Operator] | None = field(default=None)
    sensor: Sensor = _SENSOR


def _disturbance(random: np.random.Generator) -> Operator:
    return PeriodicDisturbance(1.1, (1.2,), (float(random.uniform(-3, 3)),))


def _shift(random: np.random.Generator) -> Operator:
    return TrialShift(float(2.5 * random.standard_normal()), 1 + 0.04 * float(random.standard_normal()), 0.0)


def _as_shown(name: str) -> _Case:
    """Case with one effect at the size of its picture in the catalogue."""
    placed = effect_from({"effect": name, "parameters": dict(EFFECTS[name].shown[0])}, _DT_S)
    operators = (placed.operator,)
    return _Case((name,), before=operators) if placed.side == "command" else _Case((name,), after=operators)


_CASES: dict[str, _Case] = {
    "none": _Case(),
    "mis-set only": _Case(off=(1.12, 3.0)),
    "lag": _Case(("lag",), (Lag(0.25),)),
    "delay": _Case(("delay",), (Delay.at_rate(0.2, _DT_S),)),
    "rate_dependence": _Case(("rate_dependence",), (RateDependence(0.12),)),
    "creep": _Case(("creep",), (Creep((0.2,), (4.0,)),)),
    "drift": _Case(("drift",), after=(Drift(5.0, 0.0, 0.0),)),
    "first_flexure": _Case(("first_flexure",), (FirstFlexure(0.4, 1.0),)),
    "slack": _Case(("slack",), (Slack(1.2),)),
    "stick_slip": _Case(("stick_slip",), (StickSlip(0.8, 1.5),)),
    "contact": _Case(("contact",), after=(Contact(55.0, 0.3),)),
    "nonlinear_gain": _Case(("nonlinear_gain",), after=(NonlinearGain(0.006, 0.0, 45.0),)),
    "asymmetry": _Case(("asymmetry",), after=(Asymmetry(1.25, 0.85, 40.0),)),
    "trial_shift": _Case(("trial_shift",), per_trial=_shift),
    "periodic_disturbance": _Case(("periodic_disturbance",), per_trial=_disturbance),
    "sensor": _Case(("sensor",), sensor=Sensor(1.0, 0.08, 0.02, 12.0, 0.0)),
    "lag and creep": _Case(("creep", "lag"), (Lag(0.2), Creep((0.2,), (5.0,)))),
}
CASES: Mapping[str, _Case] = _CASES | {name: _as_shown(name) for name in diagnosable() if name not in _CASES}
"""Cases with known effects: none, a mis-set simulator, each effect at a clear size, and two at once."""


def self_test(
    seed: int = 1, progress: Progress | None = None, cases: Sequence[str] | None = None
) -> tuple[SelfTestRow, ...]:
    """Diagnose simulated devices with known effects.

    The device is a Prandtl-Ishlinskii model of three plays, its simulator a backlash identified on trials without any
    effect, so that the simulator's form is never exact.
    """
    names = tuple(CASES) if cases is None else tuple(cases)
    simulator = identify("backlash", record(CASES["none"], seed + 1000))[0]
    rows = []
    for k, name in enumerate(names):
        if progress:
            progress(k, len(names), name)
        rows.append(_row(name, CASES[name], simulator, seed))
    if progress:
        progress(len(names), len(names), "done")
    return tuple(rows)


def record(case: _Case, seed: int) -> list[Trial]:
    """Record trials of a simulated device in sequence; persistent states carry over."""
    random, trials = np.random.default_rng(seed), []
    shifts = np.random.default_rng(_SHIFT_SEED)
    gain, offset = case.off
    core = _DEVICE.with_values(
        [
            v * gain if p.unit == "deg/cmd" else v + offset if p.name == "b" else v
            for p, v in zip(_DEVICE.parameters, _DEVICE.values, strict=True)
        ]
    )
    bent, clock = -np.inf, 0.0
    for k, command in enumerate(motions(random)):
        trial_operators = (case.per_trial(shifts),) if case.per_trial else ()
        sensor = replace(case.sensor, seed=int(random.integers(1 << 30)))
        chain = Chain(core, case.before, (*case.after, *trial_operators, sensor))
        state = settled(chain, float(command[0]), core.values[-1], bent, clock)
        angle = StagedChain(chain).simulate(command[:, None], _DT_S, state[:, None])[0][:, 0]
        trials.append(Trial(_DT_S * np.arange(command.size, dtype=np.float64), command, angle, source=f"trial_{k}.csv"))
        bent, clock = max(bent, float(command.max())), clock + _TRIAL_S
    return trials


def motions(random: np.random.Generator) -> list[Vec]:
    """Commands of the trials, with larger amplitudes at first: ramps and holds, sines, steps, point to point."""
    t = _DT_S * np.arange(round(_TRIAL_S / _DT_S))
    levels = np.array([0, 0, 1, 1, 0, 0, 0.6, 0.6, 0, 0, 0.3])
    ramps = np.interp(t, [0, 1, 3, 7, 9, 12, 13, 14, 15, 18, 19], _SPAN * levels)
    slow = 0.5 * _SPAN * (1 - np.cos(2 * np.pi * 0.1 * t))
    fast = 0.4 * _SPAN * (1 - np.cos(2 * np.pi * 0.4 * t))
    small = np.where(t > 10, 0.05 * _SPAN * np.sin(2 * np.pi * 2.5 * (t - 10)), 0.0)
    steps = np.interp(t, *_legs([0.5, 0.2, 0.8, 0.4, 0.7, 0.5], [1.5] * 6)) + small
    moves = [np.interp(t, *_legs(random.uniform(0, 1, 9), random.uniform(0.5, 3, 9))) for _ in range(2)]
    return [0.5 * ramps, 0.7 * slow, 0.85 * ramps, moves[0], steps, ramps, fast, moves[1], slow, ramps]


def _legs(levels: Sequence[float] | Vec, holds: Sequence[float] | Vec) -> tuple[Vec, Vec]:
    """Times and commands of full-speed moves between levels in shares of the span, each with a hold [s]."""
    times, commands = [0.0, 1.0], [0.0, 0.0]
    for level, hold in zip(levels, holds, strict=True):
        way = abs(_SPAN * level - commands[-1]) / _SPEED
        times += [times[-1] + way, times[-1] + way + hold]
        commands += [_SPAN * level] * 2
    return np.array(times), np.array(commands)


def _row(name: str, case: _Case, simulator: Simulator, seed: int) -> SelfTestRow:
    started = time.perf_counter()
    diagnosis, _ = conclude(find_causes(record(case, seed), simulator, seed=seed))
    return SelfTestRow(
        name=name,
        truth=", ".join(case.truth) or "none",
        verdict=diagnosis.verdict,
        named=", ".join("|".join(names) for names in _sets(diagnosis)) or "none",
        closed_share=diagnosis.gap.closed_share,
        seconds=time.perf_counter() - started,
        passed=_recovered(diagnosis, case.truth),
    )


def _sets(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    sets = {names[0]: names for names in diagnosis.ambiguity}
    return [sets.get(effect.name, (effect.name,)) for effect in diagnosis.effects]


def _recovered(diagnosis: Diagnosis, truth: tuple[str, ...]) -> bool:
    if not truth:
        return diagnosis.verdict in ("none", "retuned")
    sets = _sets(diagnosis)
    if diagnosis.verdict not in ("named", "one_of") or len(sets) != len(truth):
        return False
    return all(any(name in names for names in sets) for name in truth)
