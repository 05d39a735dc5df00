"""Trials of the rod device by one call: what it did, and what the tracker on its tip saw."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from .device import Motion
from .rod import RodCatheter
from .rod_parameters import RodParameters
from .sensors import EmTracker


@dataclass(frozen=True, eq=False)
class RodTrial:
    """One run.

    Attributes:
        motion: true angle [deg], drive [mm] and tension [N], all (T,), and the state after it; a further trial of the
            same device starts there.
        measured: what the tracker says [deg], (T,).
        residual_mm: greatest residual of the friction law in any step; see `rod_solver.TOLERANCE_MM`.
    """

    motion: Motion
    measured: Vec
    residual_mm: float

    @property
    def true(self) -> Vec:
        """Tip angle without any sensor [deg], (T,)."""
        return self.motion.angle


@dataclass(frozen=True)
class RodBench:
    """A rod and its tracker.

    Attributes:
        device: numbers of the rod; alter them with `dataclasses.replace`.
        tracker: the sensor on its tip.
    """

    device: RodParameters = field(default_factory=RodParameters)
    tracker: EmTracker = field(default_factory=EmTracker)

    def run(self, commands: ArrayLike, dt_s: float, seed: int = 0, state: Vec | None = None) -> RodTrial:
        """Commands (T,) [mm], each held for `dt_s` [s], from `state` or a virgin device.

        Equal arguments give equal trials. `seed` is of the tracker's noise; the rod itself has nothing random.

        Raises:
            ConfigError: if commands are not one row of finite numbers, the sample time is not positive, or the state
                is that of another device.
        """
        u = np.asarray(commands, dtype=np.float64)
        if u.ndim != 1 or u.size == 0 or not np.isfinite(u).all():
            raise ConfigError(f"commands: got shape {u.shape}, expected (T,) finite numbers [mm], T >= 1")
        if not (np.isfinite(dt_s) and dt_s > 0):
            raise ConfigError(f"dt_s: got {dt_s}, expected a positive number [s]")
        rod = RodCatheter(self.device)
        start = rod.virgin() if state is None else np.asarray(state, dtype=np.float64)
        if start.shape != (rod.state_size,):
            raise ConfigError(f"state: got shape {start.shape}, expected ({rod.state_size},)")
        random = np.random.default_rng(seed)
        motion = rod.advance(start, u, dt_s, random)
        measured, _, _ = self.tracker(motion.angle, random)
        return RodTrial(motion, measured, rod.residual_mm)


def simulate_rod(parameters: RodParameters, commands: ArrayLike, dt_s: float, seed: int = 0) -> tuple[Vec, Vec]:
    """True and measured tip angle, both (T,) [deg], of a virgin rod under commands (T,) [mm]; see `RodBench.run`.

    Raises:
        ConfigError: through `RodBench.run`.
    """
    trial = RodBench(parameters).run(commands, dt_s, seed)
    return trial.true, trial.measured
