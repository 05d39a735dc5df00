"""What is true about a case: kept sealed until the score."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from hystmpc.trials.config import Settings

from .catalogue import UNKNOWN, generator_named
from .core import Mounting
from .device import BlindDevice
from .devices import core_of
from .generator import Withheld

Suite = Literal["single", "none", "misset", "pairs", "contaminated", "unknown", "without", "controls", "injection"]


class EffectAnswer(Settings):
    """One withheld effect.

    Attributes:
        label: name that a diagnosis should give.
        generator: what made it.
        size, shape: its numbers.
        ratio: gap that it alone leaves after retuning, in floors.
        gap_deg: the same [deg].
        main: whether it counts as the cause, or is a smaller contaminant.
    """

    label: str
    generator: str
    size: float
    shape: dict[str, float] = Field(default_factory=dict)
    ratio: float = 0.0
    gap_deg: float = 0.0
    main: bool = True

    def withheld(self) -> Withheld:
        """The effect itself.

        Raises:
            ConfigError: if its generator is none of a synthetic device.
        """
        return Withheld(generator_named(self.generator), self.size, self.shape)


class Answer(Settings):
    """The truth about one case.

    Attributes:
        suite: which part of the check it belongs to; decoys and controls say more in `variant`.
        effects: what was withheld.
        without: classes that the diagnosis is not given.
        separable: whether these motions can tell the effects from their twins.
        plan, motions: kind of recording plan, and motion by trial.
        floor_deg, noise_deg, form_deg: noise and model-form error together, and each [deg].
        retuned_deg: what a refit of the baseline leaves of the affected device, noise apart [deg].
        true_closed: share of that, squared, which the effects make up; the rest is model-form error.
        retuned_by_trial, form_by_trial: of each trial alone: what the refit leaves of it, and what one leaves of the
            unaffected device [deg].
        where: density of the retuned error by region, 1 on average.
        device, mounting, seed: of the simulated device, to record more of it.
        baseline: kind of the nominal simulator.
    """

    suite: Suite
    variant: str = ""
    effects: tuple[EffectAnswer, ...] = ()
    without: tuple[str, ...] = ()
    separable: bool = True
    plan: str = ""
    motions: tuple[str, ...] = ()
    floor_deg: float = 0.0
    noise_deg: float = 0.0
    form_deg: float = 0.0
    resolution_deg: float = 0.0
    retuned_deg: float = 0.0
    true_closed: float | None = None
    retuned_by_trial: tuple[float, ...] = ()
    form_by_trial: tuple[float, ...] = ()
    where: dict[str, float] = Field(default_factory=dict)
    device: dict[str, Any] = Field(default_factory=dict)
    mounting: dict[str, float] = Field(default_factory=dict)
    seed: int = 0
    baseline: str = ""

    @property
    def mains(self) -> tuple[EffectAnswer, ...]:
        """Effects that count as causes, the largest first."""
        return tuple(sorted((e for e in self.effects if e.main), key=lambda e: -e.ratio))

    @property
    def labels(self) -> tuple[str, ...]:
        """Names that a diagnosis should give; none where its library has none for them."""
        gone = (UNKNOWN, *self.without)
        return tuple(dict.fromkeys(e.label for e in self.mains if e.label not in gone))

    @property
    def truth(self) -> str:
        """`none`, `unknown`, or the name of the largest cause."""
        if not self.mains:
            return "none"
        return self.labels[0] if self.labels else UNKNOWN

    @property
    def ratio(self) -> float:
        """Of the largest cause; 0 without any."""
        return self.mains[0].ratio if self.mains else 0.0

    def blind_device(self) -> BlindDevice:
        """The simulated device of the case."""
        core = core_of(self.device).mounted(Mounting(**self.mounting))
        effects = tuple(effect.withheld() for effect in self.effects)
        return BlindDevice(core, self.noise_deg, self.resolution_deg, self.seed, effects)
