"""What a network is made of: one class of settings for each form."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hystmpc.trials.config import Settings

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
