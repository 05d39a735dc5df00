"""Gymnasium environment of the simulated device, whose complete state can be saved and restored."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.loop import AnySensorSettings, ContinuousSensorSettings, Imaging, ImagingSettings, NoSensorSettings
from hystmpc.trajectories import PreviewTable, Trajectory
from hystmpc.trials.errors import ConfigError, did_you_mean

from .config import SimulationConfig, load_simulation
from .plants.computed import ComputedPlant
from .study import prepare

Signal = Callable[[float], float]
_ANGLE_DEG = 720.0  # observations are clipped here, so that the space is bounded


@dataclass(frozen=True)
class Disturbance:
    """External disturbances as functions of the time since the reset [s].

    Attributes:
        angle_deg: added to the tip angle, as by a load or breathing.
        command: added to the command after its limits, as by a slipping drive [command unit].
    """

    angle_deg: Signal | None = None
    command: Signal | None = None


@dataclass(frozen=True, eq=False)
class EnvironmentState:
    """Immutable state of an environment: together with the actions it determines the future."""

    plant: ComputedPlant
    random: np.random.Generator
    motion: str
    k: int
    u: float
    y: float
    disturbance: Disturbance
    imaging: Imaging | None = None


@final
class HysteresisEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Gymnasium environment in which the tip angle of a device with hysteresis tracks a motion.

    Action (1,): the command, -1 and 1 being its limits; the rate limit is kept by the environment. Observation
    (2 + H,): measured angle [deg], command sent last, reference at the ends of the next H samples [deg]. Reward:
    -(theta - r)^2 - w (u_k - u_{k-1})^2 with the true angle theta at the end of the sample. An episode is truncated at
    the end of its motion and never terminated. Between the frames of an intermittent sensor the measured angle is that
    of the frame taken last; without a sensor it is that of the rest.

    `reset` takes `options={"motion": NAME}`; else the motion is drawn. `info` has `error_deg`, `true_angle_deg`,
    `reference_deg` and `command`.

    Args:
        preview: H, samples at least 1.
        rate_weight: w [deg^2 per squared command unit].
        sensor: what is measured; the plant's own angle in every sample where left out.

    Raises:
        ConfigError: if there is no motion or no preview.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  # gymnasium declares it so

    def __init__(
        self,
        plant: ComputedPlant,
        motions: Mapping[str, Trajectory],
        limits: CommandLimits,
        preview: int = 10,
        rate_weight: float = 0.0,
        disturbance: Disturbance | None = None,
        sensor: AnySensorSettings | None = None,
    ) -> None:
        if not motions or preview < 1:
            raise ConfigError(f"environment: got {len(motions)} motions and a preview of {preview}, expected 1 or more")
        self._plant, self._limits, self._rate_weight = plant.copied(), limits, rate_weight
        self._tables = {name: PreviewTable(motion, plant.dt, preview) for name, motion in motions.items()}
        self._disturbance, self._sensor = disturbance or Disturbance(), sensor or ContinuousSensorSettings()
        self._imaging: Imaging | None = None
        self._motion, self._k = next(iter(self._tables)), 0
        self._u, self._y = plant.rest_command, plant.true_angle
        angles = np.full(1 + preview, _ANGLE_DEG)
        low, high = np.array([limits.lower]), np.array([limits.upper])
        self._seen_low = np.concatenate([-angles[:1], low, -angles[1:]]).astype(np.float32)
        self._seen_high = np.concatenate([angles[:1], high, angles[1:]]).astype(np.float32)
        self.observation_space = Box(self._seen_low, self._seen_high)
        self.action_space = Box(-1.0, 1.0, (1,), np.float32)

    @classmethod
    def from_config(cls, config: SimulationConfig | Path | str, **options: Any) -> HysteresisEnv:
        """Build the environment of a closed-loop study: its plant, motions and limits; controllers are ignored.

        `options` are `preview`, `rate_weight`, `disturbance`. Errors are those of `load_simulation` and `prepare`.
        """
        study = prepare(config if isinstance(config, SimulationConfig) else load_simulation(config))
        return cls(study.plant, study.motions, study.limits, sensor=study.config.sensor, **options)

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return self._plant.dt

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Bring the device to rest after its initialisation flexure; see the class.

        Raises:
            ConfigError: if `options` names an unknown motion.
        """
        super().reset(seed=seed)
        names = list(self._tables)
        wanted = (options or {}).get("motion", names[int(self.np_random.integers(len(names)))])
        if wanted not in self._tables:
            raise ConfigError(f"environment: no motion {wanted!r}, {did_you_mean(str(wanted), names)}")
        self._plant = self._plant.reseeded(int(self.np_random.integers(2**31)))
        self._motion, self._k, self._u = wanted, 0, self._plant.rest_command
        self._y, self._imaging = self._first(self._plant.reset() + self._disturbing_deg())
        return self._observation(), self._info()

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Simulate one sample; an action that is no number holds the command."""
        half = 0.5 * (self._limits.upper - self._limits.lower)
        wanted = self._limits.lower + half * (1.0 + float(np.asarray(action, dtype=np.float64).reshape(-1)[0]))
        u, before = self._limits.clip(wanted, self._u, self.dt), self._u
        slip = self._disturbance.command
        y = self._plant.apply(u if slip is None else u + slip(self._k * self.dt))
        self._u, self._k = u, self._k + 1
        self._y = self._seen(y + self._disturbing_deg())
        info = self._info()
        reward = -(info["error_deg"] ** 2) - self._rate_weight * (u - before) ** 2
        return self._observation(), float(reward), False, self._k >= self._tables[self._motion].steps, info

    def disturb(self, disturbance: Disturbance | None) -> None:
        """Set the disturbance from now on; None for none."""
        self._disturbance = disturbance or Disturbance()

    def get_state(self) -> EnvironmentState:
        """Return the state for `set_state`, of this environment or an equal one."""
        plant, random = self._plant.copied(), deepcopy(self.np_random)
        return EnvironmentState(
            plant, random, self._motion, self._k, self._u, self._y, self._disturbance, self._imaging
        )

    def set_state(self, state: EnvironmentState) -> NDArray[np.float32]:
        """Restore a state and return its observation; the future noise is that of the state.

        Raises:
            ConfigError: if the state's motion is none of this environment.
        """
        if state.motion not in self._tables:
            raise ConfigError(f"environment: no motion {state.motion!r}, {did_you_mean(state.motion, self._tables)}")
        self._plant = state.plant.copied()
        self._np_random = deepcopy(state.random)
        self._motion, self._k, self._u, self._y = state.motion, state.k, state.u, state.y
        self._disturbance, self._imaging = state.disturbance, state.imaging
        return self._observation()

    def _disturbing_deg(self) -> float:
        load = self._disturbance.angle_deg
        return 0.0 if load is None else load(self._k * self.dt)

    def _first(self, measured: float) -> tuple[float, Imaging | None]:
        """Observed angle at rest [deg], and the imaging system if there is one."""
        true = self._plant.true_angle + self._disturbing_deg()
        if isinstance(self._sensor, ImagingSettings):
            imaging = Imaging.at_rest(self._sensor, self._plant.seed, true)
            return imaging.newest.angle_deg, imaging
        return (true if isinstance(self._sensor, NoSensorSettings) else measured), None

    def _seen(self, measured: float) -> float:
        """Newest observed angle at the end of the sample [deg]."""
        if isinstance(self._sensor, ContinuousSensorSettings):
            return measured
        if self._imaging is None:
            return self._y
        _, self._imaging = self._imaging.later(self._k * self.dt, self._plant.true_angle + self._disturbing_deg())
        return self._imaging.newest.angle_deg

    def _observation(self) -> NDArray[np.float32]:
        seen = np.concatenate([[self._y, self._u], self._tables[self._motion].at(self._k)])
        return np.clip(seen.astype(np.float32), self._seen_low, self._seen_high)

    def _info(self) -> dict[str, Any]:
        """True values now; the reference is that at the end of the last sample, or the first one before any sample."""
        theta = self._plant.true_angle + self._disturbing_deg()
        reference = float(self._tables[self._motion].at(max(self._k - 1, 0))[0])
        return {"true_angle_deg": theta, "reference_deg": reference, "error_deg": theta - reference, "command": self._u}
