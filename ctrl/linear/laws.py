"""Controllers as linear systems of python-control: PID, and the predictive law around a resting plan."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hystmpc.models.linear.systems import LinearPart
from hystmpc.trials.errors import ControllerError
from hystmpc.trials.types import Mat, Vec

from ..estimation.observer import EstimatorSettings
from ..feedback import PidSettings
from ..mpc_settings import PredictiveSettings

System = Any
"""A system of python-control, which has no types."""


def pid_system(gains: PidSettings, dt_s: float, name: str = "pid") -> System:
    """PID from the error [deg] to the command, without its dead zone, limits and anti-windup.

        C(z) = kp + ki dt / (z - 1) + kd a / dt (z - 1) / (z + a - 1),   a = dt / (filter_s + dt)

    The derivative of the law in `core/feedback.c` acts on the measurement: in a loop at a constant reference that is
    the same. Without integral or derivative the state stays, as a pole that nothing shows.
    """
    from control import ss

    share = dt_s / (gains.filter_s + dt_s)
    slope = share / dt_s
    a = np.array([[1.0, 0.0], [0.0, 1.0 - share]])  # integral; filtered slope less its direct part
    b = np.array([[gains.ki_per_deg_s * dt_s], [-share * slope]])
    c = np.array([[1.0, gains.kd_s_per_deg]])
    d = np.array([[gains.kp_per_deg + gains.kd_s_per_deg * slope]])
    keep = [k for k, used in enumerate((gains.ki_per_deg_s > 0, gains.kd_s_per_deg > 0)) if used]
    part = (a[np.ix_(keep, keep)], b[keep], c[:, keep], d)
    return ss(*part, dt_s, inputs=["error_deg"], outputs=["command"], name=name, remove_useless_states=False)


def engine_pid(step: Callable[[Vec, Vec], tuple[float, Vec]], dt_s: float, name: str) -> System:
    """PID of the engine as a nonlinear system; `step` gives command and next states, see `GuardedController`."""
    from control import nlsys

    return nlsys(
        lambda t, x, u, params: step(x, u)[1],
        lambda t, x, u, params: np.array([step(x, u)[0]]),
        inputs=["reference_deg", "angle_deg"],
        outputs=["command"],
        states=["integral", "speed", "angle_deg", "command"],
        dt=dt_s,
        name=name,
    )


def predictive_system(
    settings: PredictiveSettings, model: LinearPart, dt_s: float, observer_gain: float, name: str = "mpc"
) -> System:
    """Law of a predictive controller from the error r - y [deg] to the command, around a plan that rests.

        d_k = d_{k-1} + K (y_k - C x_{k-D} - d_{k-1}),   u_k = u_{k-1} - k' (F x_k + G u_{k-1} + d_k - r)
        k' = e_1' (J'QJ + w_r D'D)^-1 J'Q

    F x + G u are the angles under a held command, J those of the moves, Q and w_r the weights at a reference that
    rests. No limit is active, no hold and no learning: those only leave moves out, or make them smaller. The effort
    weight, which ties the plan to the inverse, and blocks of moves, which refine one plan after the other, are not in
    it.

    Args:
        settings: weights, horizon, delay.
        model: linearisation x' = A x + B u, y = C x, at rest.
        observer_gain: K.

    Raises:
        ControllerError: if the model has a direct part.
    """
    from control import ss

    if np.any(model.d):
        raise ControllerError("predictive law: got a model with a direct part, expected the angle as a state")
    horizon = settings.preview_samples(dt_s)
    held, moved, k = _first_move(settings, model, horizon)
    n, late = model.a.shape[0], settings.estimator.delay_samples if _models(settings) else 0
    size = n + 2 + late  # x, u, d, and the angles C x of the last `late` samples
    a, b, c = np.zeros((size, size)), np.zeros((size, 1)), np.zeros((1, size))
    seen = np.zeros(size)
    seen[:n] = model.c[0] if not late else 0.0
    if late:
        seen[-1] = 1.0
    # d_k = (1 - K) d + K y - K seen;  with e = -y at r = 0
    disturbance = np.zeros(size)
    disturbance[n + 1] = 1.0 - observer_gain
    disturbance -= observer_gain * seen
    c[0, :n] = -k @ held
    c[0, n] = 1.0 - k @ moved
    c -= k.sum() * disturbance
    through = k.sum() * observer_gain
    a[:n, :n], a[n + 1] = model.a, disturbance
    a[:n] += model.b @ c
    a[n] = c[0]
    b[:n, 0], b[n, 0], b[n + 1, 0] = model.b[:, 0] * through, through, -observer_gain
    if late:
        a[n + 2, :n] = model.c[0]
        a[n + 3 :, n + 2 : -1] = np.eye(late - 1)
    d = np.array([[through]])
    return ss(a, b, c, d, dt_s, inputs=["error_deg"], outputs=["command"], name=name, remove_useless_states=False)


def _models(settings: PredictiveSettings) -> bool:
    return isinstance(settings.estimator, EstimatorSettings)


def _first_move(settings: PredictiveSettings, model: LinearPart, horizon: int) -> tuple[Mat, Vec, Vec]:
    """F (H, n), G (H,) of a held command, and the gain k (H,) of the first move by the predicted errors."""
    held, power = np.empty((horizon, model.a.shape[0])), model.c.copy()
    answer = np.empty(horizon)
    for i in range(horizon):
        answer[i] = (power @ model.b).item()
        power = power @ model.a
        held[i] = power[0]
    jacobian = np.array([[answer[i - j] if i >= j else 0.0 for j in range(horizon)] for i in range(horizon)])
    weights = settings.weights.discounted(False)
    differences = np.eye(horizon) - np.eye(horizon, k=-1)
    tracked = weights.over(horizon)[:, None] * jacobian
    hessian = jacobian.T @ tracked + weights.rate * differences.T @ differences
    return held, np.asarray(np.cumsum(answer)), np.linalg.solve(hessian, tracked.T)[0]
