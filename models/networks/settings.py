"""Settings of a network: one class for each form, which builds its network.

The modules with the PyTorch classes take numbers and never import this one.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import BeforeValidator, Field, SerializeAsAny

from hystmpc.trials.config import Count, NotNegativeInt, Positive, Settings

if TYPE_CHECKING:
    from hystmpc.trials.trial import Trial

    from ..operators.operator import Operator
    from .network_ import Network
    from .nodes import Scaling
    from .recurrent_ import LstmNet

_SPAN = 2.0  # of inputs scaled to [-1, 1]


@dataclass(frozen=True)
class DeviceFacts:
    """Facts of the device before its network is trained.

    Attributes:
        rest: scaled input of a device at rest.
        operator: what `FormSettings.operator` has fitted.
        lag_samples: time constant of the lag in front of the hysteresis [samples]; 0 for none.
        inverted: whether the network is an inverse map.
    """

    rest: float = 0.0
    operator: Operator | None = None
    lag_samples: float = 0.0
    inverted: bool = False


class FormSettings(Settings, ABC):
    """Base of the forms of networks.

    Attributes:
        known: all forms, by name.
    """

    known: ClassVar[dict[str, type[FormSettings]]] = {}

    @classmethod
    def __pydantic_init_subclass__(cls, **options: Any) -> None:
        super().__pydantic_init_subclass__(**options)
        if "form" in cls.model_fields:
            FormSettings.known |= dict.fromkeys(get_args(cls.model_fields["form"].annotation), cls)

    @property
    def context(self) -> int:
        """Samples before the present one that an output looks back on; 0 with a recurrent state."""
        return 0

    def operator(self, trials: Sequence[Trial], scaling: Scaling, skip_first_flexure: bool) -> Operator | None:
        """An operator in scaled units that is part of the network, fitted to the training trials; None for none.

        Raises:
            FitError: if it cannot be fitted.
        """
        del trials, scaling, skip_first_flexure
        return None

    @abstractmethod
    def network(self, facts: DeviceFacts) -> Network:
        """A network with initial weights drawn from torch's generator."""


def _of_its_form(data: Any) -> Any:
    """Plain data as the settings of its form; anything else as it is."""
    known = FormSettings.known
    return known[data["form"]].model_validate(data) if isinstance(data, dict) and data.get("form") in known else data


NetworkForm = Annotated[SerializeAsAny[FormSettings], BeforeValidator(_of_its_form)]


class CellSettings(FormSettings):
    """Stacked recurrent cells.

    Attributes:
        hidden, layers: size; the papers have two layers of 64.
        memory_samples: longest memory of the gates before anything is learned; 0 for PyTorch's own initial weights.
        command_gain: factor on the initial weights of the input. Direction shows only in its change from sample to
            sample, a hundredth of its range; louder from the start, hysteresis is found sooner.
    """

    hidden: Annotated[int, Field(ge=2)] = 64
    layers: Count = 2
    memory_samples: NotNegativeInt = 300
    command_gain: Positive = 4.0

    def lstm(self, outputs: int = 1) -> LstmNet:
        """An LSTM of this size with initial weights drawn from torch's generator."""
        from .recurrent_ import LstmNet

        return LstmNet(self.hidden, self.layers, self.memory_samples, self.command_gain, outputs)


class RecurrentSettings(CellSettings):
    """An LSTM or a GRU, see `LstmNet` and `GruNet`."""

    form: Literal["recurrent"] = "recurrent"
    cell: Literal["lstm", "gru"] = "lstm"

    def network(self, facts: DeviceFacts) -> Network:
        from .recurrent_ import GruNet

        del facts
        if self.cell == "lstm":
            return self.lstm()
        return GruNet(self.hidden, self.layers, self.memory_samples, self.command_gain)


class GatedSettings(FormSettings):
    """An LSTM over the plays of the command, which moves only as far as the command does; see `GatedLstmNet`.

    Lengths are shares of the range of the input.

    Attributes:
        hidden: cells of the one layer.
        plays: number of plays; 0 for an LSTM that sees the command alone.
        reach: greatest radius; the radii of a forward model are spread evenly up to it.
        inverse_finest: least radius of an inverse map, whose radii are spread evenly in their logarithm: a reversal of
            the angle asks for a jump across the loop, which only plays of small radius follow.
        path: travel of the command over which the cell forgets, None for an LSTM without the gate.
    """

    form: Literal["gated"] = "gated"
    hidden: Annotated[int, Field(ge=2)] = 24
    plays: NotNegativeInt = 8
    reach: Annotated[float, Field(gt=0, le=1)] = 0.45
    inverse_finest: Annotated[float, Field(gt=0, le=1)] = 3e-3
    path: Positive | None = 0.025

    def network(self, facts: DeviceFacts) -> Network:
        from .gated_ import GatedLstmNet

        keep = math.exp(-1.0 / facts.lag_samples) if facts.lag_samples > 0 else 0.0
        path = None if self.path is None else _SPAN * self.path
        return GatedLstmNet(self.hidden, _SPAN * self._radii(facts.inverted), facts.rest, keep, path)

    def _radii(self, inverted: bool) -> np.ndarray:
        """Radii (n,), as shares of the range."""
        if inverted:
            return np.geomspace(self.inverse_finest, self.reach, self.plays)
        return self.reach * np.arange(1, self.plays + 1) / max(self.plays, 1)
