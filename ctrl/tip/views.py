"""What a planner sees: frozen, detached from the controller that made it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.models.model import Predictor
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Vec

from ..command import Source
from ..ladder import attempt
from ..limits import CommandLimits
from ..observer import Estimate
from .memory import Snapshot

_ROUNDING = 1e-9  # of a limit or a time, that passes


@dataclass(frozen=True)
class TipState:
    """The controller between two steps.

    Attributes:
        time_s: end of the running sample: steps taken times the sample time.
        measured_deg: last accepted measurement, made at the beginning of the running sample; NaN before the first.
        predicted_deg: angle expected at the end of it, disturbance included; NaN without a model.
        reference_deg, reference_velocity_deg_s: what is wanted then.
        command: the command that is being held [mm or bar].
        disturbance_deg: by how much the device is off the model, as estimated.
        source, status: of that command.
        done: whether the reference has come to its end.
        settled: done, and the measurement is within the tolerance.
        stopped: whether the stop is latched, by `stop` or after repeated failures.
    """

    time_s: float
    measured_deg: float
    predicted_deg: float
    reference_deg: float
    reference_velocity_deg_s: float
    command: float
    disturbance_deg: float
    source: Source
    status: str
    done: bool
    settled: bool
    stopped: bool


@dataclass(frozen=True, eq=False)
class TipPlan:
    """What the controller means to do; rows belong to the running and the next samples (H,).

    Attributes:
        time_s: ends of the samples.
        command: planned commands; only the one that is held where the controller does not plan.
        predicted_deg: angles at these ends, disturbance included; as many as are known.
        reference_deg: wanted angles at these ends; NaN before the start.
    """

    time_s: Vec
    command: Vec
    predicted_deg: Vec
    reference_deg: Vec


def state_of(memory: Snapshot, dt: float, tolerance_deg: float) -> TipState:
    """The state that a snapshot means."""
    now, command = memory.steps * dt, memory.command
    motion, measured = memory.motion(now), memory.measured_deg
    done = memory.reference is not None and now >= memory.reference.end_s - _ROUNDING
    return TipState(
        time_s=now,
        measured_deg=measured,
        predicted_deg=float(command.predicted[0]) if command.predicted.size else math.nan,
        reference_deg=motion.theta_deg,
        reference_velocity_deg_s=motion.velocity_deg_s,
        command=command.u,
        disturbance_deg=memory.disturbance_deg,
        source=command.source,
        status=command.status,
        done=done,
        settled=done and abs(measured - motion.theta_deg) <= tolerance_deg,
        stopped=memory.stopped,
    )


def plan_of(memory: Snapshot, dt: float) -> TipPlan:
    """The plan that a snapshot holds."""
    command, reference = memory.command, memory.reference
    planned = command.plan if command.plan.size else np.array([command.u])
    times = dt * (memory.steps + np.arange(max(planned.size, command.predicted.size), dtype=np.float64))
    wanted = None if reference is None else attempt(lambda: reference.at(times))[0]
    return TipPlan(times, planned, command.predicted, np.full(times.size, np.nan) if wanted is None else wanted)


def predicted_angles(
    predictor: Predictor, limits: CommandLimits, estimate: Estimate | None, commands: ArrayLike
) -> Vec:
    """Angles [deg] at the ends of the coming samples under one plan (N,) or several (K, N), disturbance included.

    Raises:
        ControllerError: if there is no estimate of a model's state, or a plan is not finite or beyond the limits.
    """
    if estimate is None or not estimate.angles:
        reason = "has not started" if estimate is None else "has no model"
        raise ControllerError(f"predict: the controller {reason}, expected one with a model after its first step")
    plans = np.atleast_2d(np.asarray(commands, dtype=np.float64))
    moves = np.abs(np.diff(plans, axis=-1, prepend=estimate.command))
    low, high, reach = limits.lower - _ROUNDING, limits.upper + _ROUNDING, limits.rate * predictor.dt * (1 + _ROUNDING)
    if plans.ndim != 2 or not plans.size or not np.all((plans >= low) & (plans <= high) & (moves <= reach + _ROUNDING)):
        raise ControllerError(
            f"predict: got plans of shape {plans.shape}, expected (N,) or (K, N) finite commands within "
            f"{limits.lower:g} to {limits.upper:g} at {limits.rate:g} per second from {estimate.command:.6g} on"
        )
    under_way = np.array(estimate.angles[1:])  # of commands that are sent already but have not acted
    new = predictor.rollout(estimate.state, plans)
    angles = np.hstack([np.tile(under_way, (len(plans), 1)), new])[:, : plans.shape[1]] + estimate.disturbance
    return angles.reshape(np.shape(commands))
