"""Fault injection into every controller, with counts of exceptions and violated limits, which both must be zero.

    python lab/benchmarks/faults.py [--steps 1000000] [--seed 0]

Faults of the measurement: not a number, infinite, no number at all, outlier, stale, missing for a while. Of frames:
late, out of order, of the future, far too old, without a time of exposure; a refused frame is no exception. Of the
planner: targets out of reach, invalid references, functions that raise, stops, resets. Of model and solver:
exceptions, predictions and Jacobians that are not finite or too large for the quadratic program. Of time: samples
without a step, in which the device holds its command. Faults come alone, in bursts and together. The device is
unaffected: it is the model with parameters off by a fifth.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from kit import asked, show
from threadpoolctl import threadpool_limits

from hystmpc.ctrl import CommandLimits, TipController
from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.planner.reach import Workspace, angles_at_rest
from hystmpc.ctrl.planner.settings import Assembly, TipSettings
from hystmpc.models.load import library_file, load_model
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.simulator import load_simulator
from hystmpc.sim.plants.simulated import Effects, SimulatedPlant
from hystmpc.trials.errors import ControllerError, HystmpcError
from hystmpc.trials.types import Vec

LADDER = {"stop_after_failures": 10, "max_missing_samples": 5, "safe_command": 0.0}
_FRAMES = {"sensor": "intermittent", "oldest_frame_s": 0.6, "longest_gap_s": 1.0}
_NONE = {"sensor": "none"}
CONTROLLERS: dict[str, dict[str, Any]] = {
    "linearised MPC, OSQP": {"kind": "linearised_mpc", "solver": "osqp", "weights": {"angle_upper_deg": 80.0}},
    "linearised MPC, active set": {"kind": "linearised_mpc"},
    "sampling MPC, MPPI": {"kind": "sampling_mpc", "samples": 32},
    "sampling MPC, CEM": {"kind": "sampling_mpc", "samples": 32, "method": "cem"},
    "linearised MPC, frames": {"kind": "linearised_mpc", "estimator": _FRAMES},
    "linearised MPC, no sensor": {"kind": "linearised_mpc", "estimator": _NONE},
    "sampling MPC, frames": {"kind": "sampling_mpc", "samples": 32, "estimator": _FRAMES},
    "sampling MPC, no sensor": {"kind": "sampling_mpc", "samples": 32, "estimator": _NONE},
    "inverse": {"kind": "inverse"},
    "inverse, frames": {"kind": "inverse", "estimator": _FRAMES},
    "inverse, no sensor": {"kind": "inverse", "estimator": _NONE},
    "inverse + PID": {"kind": "inverse_pid"},
    "inverse + PID, frames": {"kind": "inverse_pid", "estimator": _FRAMES},
    "PID": {"kind": "pid"},
    "PID, frames": {"kind": "pid", "estimator": _FRAMES},
}
_ROUNDING = 1e-9
_EPISODE = 200  # steps between rests


@dataclass
class Tally:
    """Counts of the events of one controller."""

    steps: int = 0
    violations: int = 0
    exceptions: int = 0
    seconds: float = 0.0
    sources: Counter[str] = field(default_factory=Counter)
    first_exception: str = ""


class Sick(Predictor):
    """Model that raises or returns values that are not finite, as selected by `sickness`."""

    def __init__(self, inner: Predictor) -> None:
        self.inner, self.dt, self.command_range = inner, inner.dt, inner.command_range
        self.sickness: tuple[str, str] | None = None

    def _spoilt(self, call: str, value: Vec) -> Vec:
        if self.sickness is None or self.sickness[0] != call:
            return value
        if self.sickness[1] == "raises":
            raise RuntimeError(f"{call} fails")
        if self.sickness[1] == "huge":  # finite, and too much for a solver
            return 1e200 * value
        return np.full_like(value, math.nan if self.sickness[1] == "nan" else math.inf)

    def initial(self, y: float, u: float) -> Vec:
        return self.inner.initial(y, u)

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        angle, following = self.inner.advance(state, u)
        return float(self._spoilt("advance", np.array([angle]))[0]), following

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return self._spoilt("rollout", self.inner.rollout(state, plans))

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        angles, jacobian = self.inner.linearise(state, plan)
        return angles, self._spoilt("linearise", jacobian)


class SickInverse(Inverse):
    """Inverse that fails together with its model."""

    def __init__(self, inner: Inverse, model: Sick) -> None:
        self.inner, self.model = inner, model

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        u = self.inner.command(state, theta, u_last)
        return float(self.model._spoilt("inverse", np.array([u]))[0])


class Injector:
    """Random faults from a seed; about every second step has one."""

    def __init__(self, tip: TipController, model: Sick, seed: int) -> None:
        self.tip, self.model = tip, model
        self.random = np.random.default_rng(seed)
        self.missing = self.sick = 0
        self.stale = math.nan

    def measurement(self, y: float) -> Any:
        """Measurement after fault injection, in place of `y` [deg]."""
        if self.missing > 0:
            self.missing -= 1
            return math.nan
        fate = self.random.random()
        if fate < 0.05:
            return self.random.choice(np.array([math.nan, math.inf, -math.inf, 1e300]))
        if fate < 0.06:
            return (None, "?", [], 10**400)[self.random.integers(4)]
        if fate < 0.10:
            return y + float(self.random.choice([-1.0, 1.0])) * float(self.random.uniform(5.0, 500.0))
        if fate < 0.15 and math.isfinite(self.stale):
            return self.stale
        if fate < 0.16:
            self.missing = int(self.random.integers(1, 30))
        self.stale = y
        return y + 0.15 * float(self.random.standard_normal())

    def frame(self, y: float) -> None:
        """Frame of the device at `y` [deg], or of a broken imaging system, in about every fourth sample."""
        if self.random.random() > 0.25:
            return
        now_s, fate = self.tip.state().time_s, self.random.random()
        taken_s = now_s - float(self.random.uniform(0.0, 0.5))
        if fate < 0.05:
            taken_s = (math.nan, math.inf, -math.inf, 1e300)[self.random.integers(4)]
        elif fate < 0.15:
            taken_s = now_s + float(self.random.uniform(-3.0, 1.0))
        with suppress(ControllerError):
            self.tip.measure(self.measurement(y), taken_s)

    def planner(self) -> None:
        """Action of the planner before this step."""
        fate = self.random.random()
        if fate > 0.06:
            return
        if fate < 0.02:
            self.tip.set_target(float(self.random.uniform(30.0, 80.0)))
        elif fate < 0.03:
            self.tip.set_target(float(self.random.uniform(-9000.0, 9000.0)))
        elif fate < 0.04:
            self.tip.set_reference(self.random.uniform(-200.0, 200.0, 40))
        elif fate < 0.05:
            self.tip.set_reference(self._rude())
        elif fate < 0.055:
            self.tip.set_waypoints(self.random.uniform(20.0, 90.0, 3).tolist(), [0.0, 0.2, 0.1])
        elif fate < 0.056:
            self.tip.stop()

    def _rude(self) -> Any:
        """Function that is valid at its check and fails later."""
        answer = (math.nan, math.inf, "x", 1e7, 60.0)[self.random.integers(5)]

        def reference(t: float) -> Any:
            if t > 0.5 and answer == 60.0:
                raise OSError("the planner has gone")
            return 50.0 if t < 0.5 else answer

        return reference

    def model_and_solver(self) -> None:
        """Whether the model fails in this step, and the kind of failure."""
        if self.sick > 0:
            self.sick -= 1
            return
        self.model.sickness = None
        if self.random.random() < 0.04:
            call = ("advance", "rollout", "linearise", "inverse")[self.random.integers(4)]
            self.model.sickness = call, ("raises", "nan", "inf", "huge")[self.random.integers(4)]
            self.sick = int(self.random.integers(0, 8))

    def samples_lost(self) -> int:
        """Number of samples without a step."""
        return int(self.random.integers(1, 5)) if self.random.random() < 0.02 else 0


def faulty(settings: dict[str, Any]) -> tuple[TipController, Sick, CommandLimits]:
    """Build a controller whose model can be made to fail."""
    model = load_model(library_file("pi"), start="conditioned")
    predictor, inverse = controller_model(model).predictive
    sick, facts = Sick(predictor), model.metadata
    limits = CommandLimits(facts.command_limits.lower, facts.command_limits.upper, facts.command_rate)
    tip = TipSettings.parse({"model": "builtin:pi", "controller": {**settings, "ladder": LADDER}})
    controller = build_controller(tip.controller, sick, SickInverse(inverse, sick), limits)
    workspace = Workspace(angles_at_rest(predictor, limits, 30.0), (-math.inf, math.inf), (30.0, 80.0))
    return TipController(Assembly(controller, sick, limits, workspace, facts.command_unit, limits), tip), sick, limits


def violates(limits: CommandLimits, u: float, last: float, dt: float) -> bool:
    """Whether `u` violates the limits after `last` and `dt` seconds, or is not a number."""
    return not (limits.lower <= u <= limits.upper and abs(u - last) <= limits.rate * dt * (1 + _ROUNDING))


def inject(settings: dict[str, Any], steps: int, seed: int) -> Tally:
    """Run one controller through `steps` steps with faults."""
    tip, sick, limits = faulty(settings)
    mismatch = {"prandtl_ishlinskii.alpha": 1.2, "prandtl_ishlinskii.a0": 0.8}
    device = SimulatedPlant(load_simulator(library_file("tendon-catheter")), Effects(lag_s=0.08, mismatch=mismatch))
    faults, tally = Injector(tip, sick, seed), Tally()
    y, u = device.reset(), device.rest_command
    tip.reset(y, u)
    for k in range(steps):
        try:
            if k % _EPISODE == 0 or (tip.state().stopped and faults.random.random() < 0.05):
                sick.sickness = None
                tip.reset()
            elif not tip.state().stopped:
                faults.planner()
            faults.model_and_solver()
            if settings.get("estimator") is _FRAMES:
                faults.frame(y)
                measured = math.nan if faults.random.random() < 0.98 else faults.measurement(y)
            else:
                measured = faults.measurement(y)
            started = perf_counter()
            command = tip.step(measured)
            tally.seconds += perf_counter() - started
        except HystmpcError as error:
            tally.first_exception = tally.first_exception or f"step {k}: {error}"
            tally.exceptions += 1
            continue
        except Exception as error:  # noqa: BLE001 - that is what is counted
            tally.first_exception = tally.first_exception or f"step {k}: {type(error).__name__}: {error}"
            tally.exceptions += 1
            continue
        tally.violations += violates(limits, command.u, u, tip.dt)
        tally.sources[str(command.source)] += 1
        tally.steps, u = tally.steps + 1, command.u
        for _ in range(1 + faults.samples_lost()):
            y = device.apply(u)
    return tally


def run(steps: int, seed: int = 0) -> dict[str, Tally]:
    """Run all controllers; `steps` are divided among them."""
    with threadpool_limits(limits=1):
        share = math.ceil(steps / len(CONTROLLERS))
        return {name: inject(settings, share, seed + k) for k, (name, settings) in enumerate(CONTROLLERS.items())}


def main() -> None:
    """Print one row a controller; exit with 1 if any exception or violation was counted."""
    given = asked(__doc__, steps=(1_000_000, "steps of all controllers together"), seed=(0, "of the faults"))
    tallies = run(given.steps, given.seed)
    rows = []
    for name, tally in tallies.items():
        sources = ", ".join(f"{source} {count / tally.steps:.1%}" for source, count in tally.sources.most_common())
        per_s = f"{tally.steps / tally.seconds:,.0f}"
        rows.append((name, f"{tally.steps:,}", tally.violations, tally.exceptions, per_s, sources))
    show(("controller", "steps", "violations", "exceptions", "steps/s", "commands by source"), rows)
    for name, tally in tallies.items():
        if tally.first_exception:
            print(f"{name}: {tally.first_exception}")
    sys.exit(any(tally.violations or tally.exceptions for tally in tallies.values()))


if __name__ == "__main__":
    main()
