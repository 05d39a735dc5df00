"""A device, the simulator identified on it before it was affected, and the recording plan: what a case starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from hystmpc.models.contract.metadata import Range
from hystmpc.models.identify.chain_kinds import backlash_starts, prandtl_ishlinskii_starts
from hystmpc.models.identify.least_squares import OperatorFitSettings, fit_chain
from hystmpc.models.identify.methods import simulator_of
from hystmpc.models.identify.trial_set import DeviceLimits
from hystmpc.models.simulator import Simulator
from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from .core import TRAVEL_MM, Core, Mounting
from .device import BlindDevice
from .devices import DEVICES
from .generator import Withheld
from .plan import Plan, draw_plan
from .retuning import GapRuler

_RATE_MM_S = 40.0
_TRIES = 5
_PLAYS = 3


@dataclass(frozen=True, eq=False)
class Bench:
    """What a case is made from.

    Attributes:
        core: the device as the simulator knew it.
        mounting: how it is off by now.
        device: the device of the case, without effects.
        simulator: the nominal one.
        baseline: its kind.
        plan: what is recorded.
        ruler: for sizes of effects.
        random: for all further draws.
    """

    core: Core
    mounting: Mounting
    device: BlindDevice
    simulator: Simulator
    baseline: str
    plan: Plan
    ruler: GapRuler
    random: np.random.Generator

    @property
    def floor_deg(self) -> float:
        """Noise and model-form error together [deg]."""
        return float(np.hypot(self.device.noise_deg, self.ruler.base.rmse_deg))

    def angles(self, effects: Sequence[Withheld]) -> list[Vec]:
        """Angles (T,) without common noise, by trial [deg]."""
        return self.device.with_effects(effects).true_angles(self.plan.commands)

    def facts(self) -> dict[str, object]:
        """Fields of an answer that are known before any effect is chosen."""
        return {
            "plan": self.plan.name,
            "motions": self.plan.types,
            "floor_deg": self.floor_deg,
            "noise_deg": self.device.noise_deg,
            "form_deg": self.ruler.base.rmse_deg,
            "resolution_deg": self.device.resolution_deg,
            "device": self.core.numbers(),
            "mounting": asdict(self.mounting),
            "seed": self.device.seed,
            "baseline": self.baseline,
        }


def set_up(seed: Sequence[int], spread: float = 1.0, plan: str | None = None) -> Bench:
    """Draw a device, identify its simulator, draw what it is off by and what is recorded.

    Args:
        seed: of everything in the case.
        spread: of the mounting; 0 keeps the device as it was identified.
        plan: kind of plan, drawn where left out.

    Raises:
        FitError: if no drawn device can be identified.
    """
    for attempt in range(_TRIES):
        random = np.random.default_rng([*seed, attempt])
        try:
            return _bench(random, spread, plan)
        except FitError:
            continue
    raise FitError(f"blind case {list(seed)}: no simulator could be identified on {_TRIES} drawn devices")


def _bench(random: np.random.Generator, spread: float, plan: str | None) -> Bench:
    core = DEVICES[int(random.integers(len(DEVICES)))].draw(random)
    baseline = str(random.choice(["backlash", "pi"]))
    noise, resolution = float(random.choice([0.03, 0.06, 0.12])), 0.01
    nominal = BlindDevice(core, noise, resolution, int(random.integers(2**31)))
    recorded = nominal.record(draw_plan(random, "short").commands)
    named = [replace(trial, source=f"fit_{k + 1:02d}.csv") for k, trial in enumerate(recorded)]
    simulator = _identified(baseline, named)
    mounting = Mounting(
        gain=float(1 + spread * random.uniform(-0.12, 0.12)),
        friction=float(1 + spread * random.uniform(-0.25, 0.25)),
        offset_deg=float(spread * random.uniform(-2, 2)),
    )
    device = replace(nominal, core=core.mounted(mounting), seed=int(random.integers(2**31)))
    recording = draw_plan(random, plan)
    ruler = GapRuler.of(simulator, recording.commands, device.true_angles(recording.commands))
    return Bench(core, mounting, device, simulator, baseline, recording, ruler, random)


def _identified(baseline: str, trials: Sequence[Trial]) -> Simulator:
    """As `hystmpc fit` does it, from one start instead of several."""
    start = backlash_starts(trials)[0] if baseline == "backlash" else prandtl_ishlinskii_starts(trials, _PLAYS)[1]
    chain = fit_chain([start], trials, OperatorFitSettings(restarts=0, evaluations=30, tolerance=1e-5)).chain
    limits = DeviceLimits(Range(lower=0.0, upper=TRAVEL_MM), _RATE_MM_S)
    return simulator_of(chain, trials, limits, "least_squares, preset best", seed=1)
