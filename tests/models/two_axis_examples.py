"""Models of two axes for tests: two devices of one axis, joined by matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.operators.dynamics import Lag
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.simulator import Identification, Simulator
from hystmpc.models.two_axes.model import CrossFriction, Row, TwoAxisModel
from hystmpc.trials.trial import Trial

Vec = NDArray[np.float64]
IDENTITY: tuple[Row, Row] = ((1.0, 0.0), (0.0, 1.0))
REACH, RATE, DT = 3.0, 8.0, 0.04
SHARED = CrossFriction(lag_s=0.05, radii=(0.1, 0.4), weights=((2.0, 1.0), (1.0, 3.0)))
COUPLED = SHARED.model_copy(
    update={"delay_s": 0.08, "coupling": ((0.1, -0.2, 0.06, -0.03, 0.02), (-0.2, 0.1, -0.05, 0.04, 0.03))}
)
"""The same behind a delay, with static coupling."""


def axis(gain: float = 8.0, lag_s: float = 0.08) -> Simulator:
    """A Prandtl-Ishlinskii sum behind a lag, from -3 to 3 mm."""
    core = PrandtlIshlinskii(0.3 * gain, (0.4 * gain, 0.3 * gain), 0.15, 0.0, 0.0)
    travel = Range(lower=-2 * REACH, upper=2 * REACH)
    return Simulator(
        chain=Chain(core, before=(Lag(lag_s),)),
        dt_s=DT,
        command_unit="mm",
        command_limits=travel,
        command_rate_per_s=2 * RATE,
        trained_command=travel,
        trained_angle_deg=Range(lower=-2 * REACH * gain, upper=2 * REACH * gain),
        trained_rate_per_s=2 * RATE,
        identification=Identification(method="test"),
        rest_command=0.0,
    )


def two_axes(
    mix: tuple[Row, Row] = IDENTITY, frame: tuple[Row, Row] = IDENTITY, cross: CrossFriction | None = None
) -> TwoAxisModel:
    """A device of two commands from -3 to 3 mm at 8 mm/s."""
    limits = Range(lower=-REACH, upper=REACH)
    return TwoAxisModel((axis(8.0), axis(10.0, 0.05)), mix, frame, (limits,) * 2, (RATE,) * 2, (0.0, 0.0), {}, cross)


def wandering(seed: int, samples: int = 1000) -> Vec:
    """Commands (T, 2) that move and rest at random, at times one of them alone."""
    random = np.random.default_rng(seed)
    u, at, to = np.zeros((samples, 2)), np.zeros(2), np.zeros(2)
    for k in range(samples):
        for i in range(2):
            if random.random() < 0.03:
                to[i] = random.uniform(-REACH, REACH) if random.random() < 0.7 else to[i]
        at = at + np.clip(to - at, -0.1, 0.1)
        u[k] = at
    u[: samples // 5, 1] = 0.0
    return u


def recorded(model: TwoAxisModel, seeds: range, noise: float = 0.05) -> list[Trial]:
    """Trials of a device that is the model."""
    made = []
    for seed in seeds:
        u = wandering(seed)
        angles = model.run(u, model.turn @ np.zeros(2))
        angles = angles + noise * np.random.default_rng(seed).standard_normal(angles.shape)
        made.append(Trial(DT * np.arange(len(u)), u, angles, source=f"trial {seed}"))
    return made
