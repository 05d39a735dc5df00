"""Settings of the play-kernel model and its presets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from hystmpc.trials.config import Settings

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=1)]


class PlayKernelSettings(Settings):
    """How a play-kernel model is built and identified; see `PlayKernelWeights` and `fit_play_kernel`.

    Commands are counted in units of the trained command range, angles in units of the trained angle range.

    Attributes:
        preset: name in reports.
        plays: number n of plays with a positive radius.
        reach: greatest radius; the radii of a forward model are spread evenly up to it.
        inverse_reach, inverse_finest: greatest and least radius of an inverse map, spread evenly in their logarithm: a
            reversal of the angle asks for a jump across the whole loop, which only plays of small radius can follow.
        segments: number K of linear pieces of each function.
        lags_s: time constants of the lag in front that are compared, 0 for none [s].
        smoothness: penalties on the differences of neighbouring slopes that are compared.
        offset_penalty: on the square of the trial offsets; an offset b of a trial is known up to the factor
            1 / (1 + penalty). Angle sensors are zeroed anew for each trial, and a model that bends to follow the
            offsets of its training trials does worse on the next one. Large values turn offsets off.
        least_slope: added to every slope, so that the angle strictly rises.
        folds: greatest number of groups of trials in the comparison, each left out once.
    """

    preset: str = "best"
    plays: Count = 12
    reach: Annotated[float, Field(gt=0, le=1)] = 0.45
    inverse_reach: Annotated[float, Field(gt=0, le=1)] = 0.45
    inverse_finest: Annotated[float, Field(gt=0, le=1)] = 3e-4
    segments: Count = 14
    lags_s: tuple[NotNegative, ...] = Field(default=(0.0, 0.02, 0.04, 0.06), min_length=1)
    smoothness: tuple[NotNegative, ...] = Field(default=(3e-7, 3e-6, 3e-5), min_length=1)
    offset_penalty: NotNegative = 0.03
    least_slope: Positive = 1e-6
    folds: Annotated[int, Field(ge=2)] = 6


PLAY_KERNEL_PRESETS: Mapping[str, PlayKernelSettings] = {
    "best": PlayKernelSettings(),
    "rate_independent": PlayKernelSettings(preset="rate_independent", lags_s=(0.0,)),
}
