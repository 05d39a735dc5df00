"""Plants of the closed-loop benchmark, and the models of them used by controllers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.contract.export import export_onnx
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.load import library_file
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.slow_changes import Creep
from hystmpc.models.simulator import ChainModel, Simulator, load_simulator, save_simulator
from hystmpc.sim.plants.simulated import Effects, SimulatedPlant, mismatched
from hystmpc.trajectories.excitation import Offset, s2_point_to_point, s2_sinusoid
from hystmpc.trajectories.trajectory import Trajectory
from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial

MISMATCH = 1.2
"""Factor on every parameter of a plant whose models are off, its lag and delay included."""

_LAG_S, _DELAY_S, _NOISE_DEG = 0.08, 0.08, 0.15
# The answer creeps on by a twentieth of the step within some seconds.
_CREEP = Creep((-0.05,), (5.0,))
_SLOW_S = 120.0  # of a quasi-static loop: the thresholds' growth with speed is a thousandth of a millimetre then
_WHOLE = 1e-9


@dataclass(frozen=True)
class Plant:
    """Device of the benchmark.

    Attributes:
        family: its name without mismatch: what models are identified on.
        lag_s, delay_s: of its actuator [s].
        noise_deg: standard deviation of its sensor [deg].
        factor: on all its parameters, lag and delay included; 1 for the device that models were identified on.
    """

    name: str
    family: str
    library: str
    lag_s: float = 0.0
    delay_s: float = 0.0
    noise_deg: float = 0.0
    before: tuple[Operator, ...] = ()
    factor: float = 1.0

    @property
    def off(self) -> bool:
        """Whether the models' parameters differ from those of the device."""
        return self.factor != 1.0

    @property
    def ideal(self) -> bool:
        """Whether it has no lag, delay, noise and creep."""
        return self.effects == Effects() and not self.before

    @property
    def effects(self) -> Effects:
        """Effects of the device that its simulator does not contain."""
        return Effects(lag_s=self.factor * self.lag_s, delay_s=self.factor * self.delay_s, noise_deg=self.noise_deg)

    def nominal(self) -> Plant:
        """Device on which models are identified."""
        return replace(self, name=self.family, factor=1.0)

    def simulator(self, dt_s: float) -> Simulator:
        """Simulator with hysteresis and creep, without lag and delay, at a sample time [s]."""
        base = load_simulator(library_file(self.library))
        chain = replace(base.chain, before=self.before)
        return replace(base, chain=mismatched(chain, dict.fromkeys(chain.labels, self.factor))).at_sample_time(dt_s)

    def device(self, dt_s: float, seed: int = 0) -> SimulatedPlant:
        """Device without file output."""
        return SimulatedPlant(self.simulator(dt_s), self.effects, dt_s, seed=seed)

    def oracle(self, dt_s: float) -> tuple[Simulator, int]:
        """Exact simulator except for whole samples of delay, and the number of these."""
        effects, simulator = self.effects, self.simulator(dt_s)
        samples = int(effects.delay_s / dt_s + _WHOLE)
        rest = effects.delay_s - samples * dt_s
        delay = (Delay.at_rate(rest, dt_s),) if rest > _WHOLE else ()
        lag = (Lag(effects.lag_s),) if effects.lag_s > 0 else ()
        chain = simulator.chain
        return replace(simulator, chain=replace(chain, before=(*delay, *lag, *chain.before))), samples


def _pairs(*plants: Plant) -> Mapping[str, Plant]:
    off = [replace(plant, name=f"{plant.name}-off", factor=MISMATCH) for plant in plants]
    return MappingProxyType({plant.name: plant for pair in zip(plants, off, strict=True) for plant in pair})


PLANTS: Mapping[str, Plant] = _pairs(
    Plant("backlash", "backlash", "backlash"),
    Plant("pi", "pi", "tendon-catheter"),
    Plant("noisy", "noisy", "tendon-catheter", _LAG_S, _DELAY_S, _NOISE_DEG, (_CREEP,)),
)
"""All plants by name; `-off` has every parameter `MISMATCH` times that of the device that models were identified on."""


def half_width(simulator: Simulator) -> float:
    """Half the width of the hysteresis loop at its middle angle [cmd], from a slow run over the command range.

    Only the core counts; what stands before and after it has no part in the backlash.
    """
    slow = replace(simulator, chain=Chain(simulator.chain.core)).at_sample_time(0.01)
    limits = simulator.command_limits
    up = np.linspace(limits.lower, limits.upper, round(0.5 * _SLOW_S / slow.dt_s))
    theta = ChainModel(slow).run(np.concatenate([up, up[::-1], up, up[::-1]]), simulator.trained_angle_deg.lower)
    rising, falling = theta[2 * up.size : 3 * up.size], theta[3 * up.size :]
    middle = 0.5 * (rising[0] + rising[-1])
    return 0.5 * float(np.interp(middle, rising, up) - np.interp(middle, falling[::-1], up))


RECORDING_DT_S = 0.04
_SINUSOIDS_HZ = (0.1, 0.2, 0.4, 0.5)
_MOVES, _QUICK_MOVES = 6, 2
_NETWORK_TRAINING = "best"


def recordings(plant: Plant, seed: int, quick: bool = False) -> tuple[Trial, ...]:
    """Trials of the device at 25 Hz: S2's sinusoids (eq. (9)-(10)) and ramps with holds (eq. (11)), in mm of travel.

    The delay is taken out, as a controller that is told of it wants it: an angle stands beside the command that it
    answers to. Noise, lag and creep stay in.
    """
    device = plant.device(RECORDING_DT_S, seed)
    delay = round(plant.effects.delay_s / RECORDING_DT_S)
    return tuple(
        _recorded(device.reseeded(seed + k), motion, delay, name)
        for k, (name, motion) in enumerate(_commands(seed, quick))
    )


def fitted_backlash(plant: Plant, seed: int, quick: bool = False) -> Simulator:
    """Backlash of the plant itself if it is one, else one identified on recordings behind the known lag.

    Raises:
        FitError: if it cannot be identified.
    """
    if plant.ideal and plant.library == "backlash":
        return plant.simulator(RECORDING_DT_S)
    trials = [_lagged(trial, plant.effects.lag_s) for trial in recordings(plant, seed, quick)]
    request = FitRequest(seed=seed, skip_first_flexure=True)
    fitted = kind_named("backlash").fit(trials, request)
    if fitted.simulator is None:
        raise FitError("backlash: got no simulator, expected one")
    device = plant.simulator(RECORDING_DT_S)
    return replace(fitted.simulator, command_limits=device.command_limits, command_rate_per_s=device.command_rate_per_s)


def save_backlash(plant: Plant, folder: Path, rates_hz: Iterable[float], seed: int, quick: bool = False) -> list[Path]:
    """Fit and write a backlash for every rate, and one behind the lag, as the companion of a network."""
    fitted, lag_s = fitted_backlash(plant, seed, quick), plant.effects.lag_s
    lag = (Lag(lag_s),) if lag_s > 0 else ()
    behind = replace(fitted, chain=replace(fitted.chain, before=lag))
    files = [save_simulator(fitted.at_sample_time(1 / rate), backlash_file(folder, plant, rate)) for rate in rates_hz]
    return [*files, save_simulator(behind.at_sample_time(RECORDING_DT_S), companion_file(folder, plant))]


def save_network(plant: Plant, kind: str, folder: Path, updates: int, seed: int, quick: bool = False) -> str:
    """Train and export a network; return one line on the training."""
    request = FitRequest(training=_NETWORK_TRAINING, seed=seed, steps=updates)
    trained = kind_named(kind).fit(recordings(plant, seed, quick), request)
    if trained.interrupted:
        raise KeyboardInterrupt
    file = network_file(folder, plant, kind)
    file.parent.mkdir(parents=True, exist_ok=True)
    export_onnx(trained.bundle, file)
    return trained.report


def backlash_file(folder: Path, plant: Plant, rate_hz: float) -> Path:
    """File of the backlash of a plant's family."""
    return folder / "models" / f"{plant.family}-backlash-{rate_hz:g}hz.yaml"


def companion_file(folder: Path, plant: Plant) -> Path:
    """File of the backlash behind the lag: the surrogate for a network's inverse."""
    return folder / "models" / f"{plant.family}-companion.yaml"


def network_file(folder: Path, plant: Plant, kind: str) -> Path:
    """File of a network of a plant's family."""
    return folder / "models" / f"{plant.family}-{kind}.onnx"


def _commands(seed: int, quick: bool) -> Iterable[tuple[str, Trajectory]]:
    rng = np.random.default_rng(seed)
    offsets: tuple[Offset, ...] = ("0BL",) if quick else ("0BL", "MidBL", "EndBL")
    for frequency in _SINUSOIDS_HZ[-2:] if quick else _SINUSOIDS_HZ:
        for offset in offsets:
            yield f"sinusoid_{frequency:g}hz_{offset}", s2_sinusoid(frequency, offset)
    for k in range(_QUICK_MOVES if quick else _MOVES):
        yield f"point_to_point_{k}", s2_point_to_point(rng, "train")


def _recorded(device: SimulatedPlant, motion: Trajectory, delay: int, name: str) -> Trial:
    """Command and measured angle at the ends of samples, the angle `delay` samples later."""
    t = RECORDING_DT_S * np.arange(round(motion.duration_s / RECORDING_DT_S) + 1, dtype=np.float64)
    command = np.clip(motion(t), *_limits(device))
    device.reset()
    angle = np.array([device.apply(float(u)) for u in np.concatenate([command, np.full(delay, command[-1])])])
    return Trial(t, command, angle[delay:], source=name)


def _limits(device: SimulatedPlant) -> tuple[float, float]:
    limits = device.simulator.command_limits
    return limits.lower, limits.upper


def _lagged(trial: Trial, lag_s: float) -> Trial:
    """Trial with its command after a known lag."""
    if lag_s == 0:
        return trial
    share, travel, last = 1 - np.exp(-trial.dt / lag_s), np.empty_like(trial.command), float(trial.command[0])
    for k, u in enumerate(trial.command):
        last += share * (u - last)
        travel[k] = last
    return Trial(trial.t, travel, trial.angle, source=trial.source)
