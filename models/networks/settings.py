"""What a network is made of: one class of settings for each form."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ModelError
from hystmpc.trials.types import Vec

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]


class FeedForwardSettings(Settings):
    """ReLU layers over the present input and its past, see `FeedForwardNet`.

    Attributes:
        hidden: widths of the layers; S2 has two of 64.
        history: samples that are looked at, the present one included: 1 for the FNN, 50 for the FNN-HIB of S2.
    """

    form: Literal["feed_forward"] = "feed_forward"
    hidden: tuple[Annotated[int, Field(ge=2)], ...] = (64, 64)
    history: Count = 1


class CellSettings(Settings):
    """Stacked recurrent cells.

    Attributes:
        hidden, layers: size; the papers have two layers of 64.
        memory_samples: longest memory of the gates before anything is learned; 0 for PyTorch's own initial weights.
        command_gain: factor on the initial weights of the input. Direction shows only in its change from sample to
            sample, a hundredth of its range; louder from the start, hysteresis is found sooner.
    """

    hidden: Annotated[int, Field(ge=2)] = 64
    layers: Count = 2
    memory_samples: Annotated[int, Field(ge=0)] = 300
    command_gain: Positive = 4.0


class RecurrentSettings(CellSettings):
    """An LSTM or a GRU, see `LstmWeights` and `GruNet`."""

    form: Literal["recurrent"] = "recurrent"
    cell: Literal["lstm", "gru"] = "lstm"


class HybridSettings(CellSettings):
    """An LSTM with a backlash that is fitted by least squares beforehand, see `SerialNet` and `ParallelNet`.

    Attributes:
        head_gain: factor on the initial weights of the LSTM's head; small, training starts from the backlash itself.
        dead_zone: of the inverse backlash of an inverse map: changes of the measured angle [deg] that count as none;
            None for what fits the training trials best.
    """

    form: Literal["serial", "parallel"]
    head_gain: Annotated[float, Field(ge=0)] = 0.1
    dead_zone: Annotated[float, Field(ge=0, le=10)] | None = None


NetworkForm = Annotated[FeedForwardSettings | RecurrentSettings | HybridSettings, Field(discriminator="form")]


@dataclass(frozen=True)
class Scaling:
    """Units in, units out: v = (u - u_offset) / u_scale, theta = theta_offset + theta_scale * y.

    For an inverse map `u` is the angle and `theta` the command.

    Attributes:
        u_offset, u_scale: in the unit of what goes in [mm or bar].
        theta_offset, theta_scale: in the unit of what comes out [deg].

    Raises:
        ModelError: if a number is not finite or a scale not positive.
    """

    u_offset: float = 0.0
    u_scale: float = 6.0
    theta_offset: float = 0.0
    theta_scale: float = 90.0

    def __post_init__(self) -> None:
        values = [getattr(self, f.name) for f in fields(self)]
        if not np.isfinite(values).all() or self.u_scale <= 0 or self.theta_scale <= 0:
            raise ModelError(f"network scaling: got {values}, expected finite numbers and scales > 0")

    def scale_in(self, u: Vec) -> Vec:
        """Scaled input v."""
        return (u - self.u_offset) / self.u_scale

    def scale_out(self, theta: Vec) -> Vec:
        """Scaled output y that stands for `theta`."""
        return (theta - self.theta_offset) / self.theta_scale

    def to_units(self, y: Vec) -> Vec:
        """Output `theta` of a scaled output y."""
        return self.theta_offset + self.theta_scale * y
