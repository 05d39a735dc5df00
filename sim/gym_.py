"""Gymnasium environment of the simulated device, whose complete state can be saved and restored."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast, final

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.loop import AnySensorSettings, ContinuousSensorSettings, Imaging, ImagingSettings, NoSensorSettings
from hystmpc.trajectories import PreviewTable, Trajectory
from hystmpc.trajectories.plane import PlaneMotion
from hystmpc.trials.errors import ConfigError, did_you_mean
from hystmpc.trials.types import Vec

from .config import SimulationConfig, load_simulation
from .plants.computed import ComputedPlant
from .study import prepare
from .two_axes.config import TwoAxisSimulationConfig, file_of_two_axes, load_two_axis_simulation
from .two_axes.plant import TwoAxisPlant
from .two_axes.study import prepare_two_axes

Signal = Callable[[float], Any]
"""Function of the time [s], to a number or to one for each axis or command."""
_ANGLE_DEG = 720.0  # observations are clipped here, so that the space is bounded


@dataclass(frozen=True)
class Disturbance:
    """External disturbances as functions of the time since the reset [s].

    Attributes:
        angle_deg: added to the tip angle, as by a load or breathing; of two axes to both, or angles (2,).
        command: added to the command after its limits, as by a slipping drive [command unit]; of two axes to each, or
            commands (n,).
    """

    angle_deg: Signal | None = None
    command: Signal | None = None


@dataclass(frozen=True, eq=False)
class EnvironmentState:
    """Immutable state of an environment: together with the actions it determines the future.

    Attributes:
        u, y: command sent last and angle [deg] seen last; of two axes commands (n,) and angles (2,).
    """

    plant: ComputedPlant | TwoAxisPlant
    random: np.random.Generator
    motion: str
    k: int
    u: float | Vec
    y: float | Vec
    disturbance: Disturbance
    imaging: Imaging | None = None


@final
class HysteresisEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Gymnasium environment in which the tip angle of a device with hysteresis tracks a motion.

    Action (1,): the command, -1 and 1 being its limits; the rate limit is kept by the environment. Observation
    (2 + H,): measured angle [deg], command sent last, reference at the ends of the next H samples [deg]. Reward:
    -(theta - r)^2 - w (u_k - u_{k-1})^2 with the true angle theta at the end of the sample. An episode is truncated at
    the end of its motion and never terminated.

    A device of two axes and n commands has actions (n,) and observations (2 + n + 2 H,): both measured angles, the
    commands sent last, x and y of the reference at the end of the next sample, those of the one behind it, and so on.
    The reward sums the squares of both errors and of all moves. What `info` holds are arrays.

    Between the frames of an intermittent sensor the measured angle is that
    of the frame taken last; without a sensor it is that of the rest.

    `reset` takes `options={"motion": NAME}`; else the motion is drawn. `info` has `error_deg`, `true_angle_deg`,
    `reference_deg` and `command`.

    Args:
        limits: of the command; of two axes those of every command, n of them.
        preview: H, samples at least 1.
        rate_weight: w [deg^2 per squared command unit].
        sensor: what is measured; the plant's own angle in every sample where left out, as always of two axes.

    Raises:
        ConfigError: if there is no motion or no preview, or two axes have another sensor or number of limits.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  # gymnasium declares it so

    def __init__(
        self,
        plant: ComputedPlant | TwoAxisPlant,
        motions: Mapping[str, Trajectory | PlaneMotion],
        limits: CommandLimits | Sequence[CommandLimits],
        preview: int = 10,
        rate_weight: float = 0.0,
        disturbance: Disturbance | None = None,
        sensor: AnySensorSettings | None = None,
    ) -> None:
        if not motions or preview < 1:
            raise ConfigError(f"environment: got {len(motions)} motions and a preview of {preview}, expected 1 or more")
        self._limits = (limits,) if isinstance(limits, CommandLimits) else tuple(limits)
        self._two = isinstance(plant, TwoAxisPlant)
        if len(self._limits) != np.size(plant.rest_command):
            got = f"{len(self._limits)} limits, expected those of {np.size(plant.rest_command)} commands"
            raise ConfigError(f"environment: got {got}")
        if self._two and not isinstance(sensor, ContinuousSensorSettings | None):
            raise ConfigError(f"environment: got the sensor {sensor.kind} and two axes, expected none: continuous")
        # The plant of two axes takes and gives arrays in place of numbers.
        self._plant: Any = plant.copied()
        self._rate_weight = rate_weight
        self._tables: Mapping[str, Any] = {
            name: PreviewTable(cast(Any, motion), plant.dt, preview) for name, motion in motions.items()
        }
        self._disturbance, self._sensor = disturbance or Disturbance(), sensor or ContinuousSensorSettings()
        self._imaging: Imaging | None = None
        self._motion, self._k = next(iter(self._tables)), 0
        self._u: Any = plant.rest_command
        self._y: Any = plant.true_angle
        axes = np.size(self._y)
        angles = np.full(axes * (1 + preview), _ANGLE_DEG)
        self._low, self._high = (np.array([getattr(one, end) for one in self._limits]) for end in ("lower", "upper"))
        self._seen_low = np.concatenate([-angles[:axes], self._low, -angles[axes:]]).astype(np.float32)
        self._seen_high = np.concatenate([angles[:axes], self._high, angles[axes:]]).astype(np.float32)
        self.observation_space = Box(self._seen_low, self._seen_high)
        self.action_space = Box(-1.0, 1.0, (len(self._limits),), np.float32)

    @classmethod
    def from_config(
        cls, config: SimulationConfig | TwoAxisSimulationConfig | Path | str, **options: Any
    ) -> HysteresisEnv:
        """Build the environment of a closed-loop study: its plant, motions and limits; controllers are ignored.

        `options` are `preview`, `rate_weight`, `disturbance`. Errors are those of `load_simulation` and `prepare`, of a
        study of two axes those of `load_two_axis_simulation` and `prepare_two_axes`.
        """
        if isinstance(config, Path | str) and file_of_two_axes(config):
            config = load_two_axis_simulation(config)
        if isinstance(config, TwoAxisSimulationConfig):
            both = prepare_two_axes(config)
            return cls(both.plant, both.motions, both.config.command_limits(), **options)
        study = prepare(config if isinstance(config, SimulationConfig) else load_simulation(config))
        return cls(study.plant, study.motions, study.limits, sensor=study.config.sensor, **options)

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return float(self._plant.dt)

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
        """Simulate one sample; an action that is no number holds the command.

        Raises:
            ConfigError: if there are fewer numbers than commands.
        """
        given, before = np.asarray(action, dtype=np.float64).reshape(-1)[: len(self._limits)], self._u
        if given.size < len(self._limits):
            raise ConfigError(f"environment: got an action of {given.size} numbers, expected {len(self._limits)}")
        wanted = self._low + 0.5 * (self._high - self._low) * (1.0 + given)
        sent = zip(self._limits, wanted.tolist(), np.atleast_1d(before).tolist(), strict=True)
        u = self._number([limits.clip(one, last, self.dt) for limits, one, last in sent])
        slip = self._disturbance.command
        y = self._plant.apply(u if slip is None else u + slip(self._k * self.dt))
        self._u, self._k = u, self._k + 1
        self._y = self._seen(y + self._disturbing_deg())
        info = self._info()
        reward = -_squares(info["error_deg"]) - self._rate_weight * _squares(u - before)
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

    def _number(self, values: Any) -> Any:
        """One number of one axis, an array of two."""
        return np.array(values) if self._two else float(values[0])

    def _disturbing_deg(self) -> Any:
        load = self._disturbance.angle_deg
        return 0.0 if load is None else load(self._k * self.dt)

    def _first(self, measured: Any) -> tuple[Any, Imaging | None]:
        """Observed angle at rest [deg], and the imaging system if there is one."""
        true = self._plant.true_angle + self._disturbing_deg()
        if isinstance(self._sensor, ImagingSettings):
            imaging = Imaging.at_rest(self._sensor, self._plant.seed, true)
            return imaging.newest.angle_deg, imaging
        return (true if isinstance(self._sensor, NoSensorSettings) else measured), None

    def _seen(self, measured: Any) -> Any:
        """Newest observed angle at the end of the sample [deg]."""
        if isinstance(self._sensor, ContinuousSensorSettings):
            return measured
        if self._imaging is None:
            return self._y
        _, self._imaging = self._imaging.later(self._k * self.dt, self._plant.true_angle + self._disturbing_deg())
        return self._imaging.newest.angle_deg

    def _observation(self) -> NDArray[np.float32]:
        ahead = self._tables[self._motion].at(self._k).ravel()
        seen = np.concatenate([np.atleast_1d(self._y), np.atleast_1d(self._u), ahead])
        return np.clip(seen.astype(np.float32), self._seen_low, self._seen_high)

    def _info(self) -> dict[str, Any]:
        """True values now; the reference is that at the end of the last sample, or the first one before any sample."""
        theta = self._plant.true_angle + self._disturbing_deg()
        due = self._tables[self._motion].at(max(self._k - 1, 0))[0]
        reference = np.array(due) if self._two else float(due)
        command = self._number(np.atleast_1d(self._u))
        return {"true_angle_deg": theta, "reference_deg": reference, "error_deg": theta - reference, "command": command}


def _squares(numbers: Any) -> float:
    """Sum of the squares of a number or of several."""
    return float(sum(one**2 for one in np.atleast_1d(numbers).tolist()))
