"""What a network is made of: one class of settings for each form, which builds its network.

The modules with the PyTorch classes take numbers and never import this one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_args

from pydantic import BeforeValidator, Field, SerializeAsAny

from hystmpc.trials.config import Settings

if TYPE_CHECKING:
    from ..operators.operator import Operator
    from .network_ import Network
    from .recurrent_ import LstmNet

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]


class FormSettings(Settings, ABC):
    """What a network is made of; builds the network.

    Attributes:
        known: all forms, by name.
        has_backlash: whether a backlash, fitted to the training trials beforehand, is part of it.
    """

    has_backlash: ClassVar[bool] = False
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

    @abstractmethod
    def network(self, rest: float, operator: Operator | None) -> Network:
        """A network with initial weights drawn from torch's generator.

        Args:
            rest: scaled input of a device at rest, for a buffer of past inputs.
            operator: the fitted backlash in scaled units, for hybrids.
        """


def _of_its_form(data: Any) -> Any:
    """Plain data as the settings of its form; anything else as it is."""
    known = FormSettings.known
    return known[data["form"]].model_validate(data) if isinstance(data, dict) and data.get("form") in known else data


NetworkForm = Annotated[SerializeAsAny[FormSettings], BeforeValidator(_of_its_form)]


class FeedForwardSettings(FormSettings):
    """ReLU layers over the present input and its past, see `FeedForwardNet`.

    Attributes:
        hidden: widths of the layers; S2 (RA-L 2024) has two of 64.
        history: samples that are looked at, the present one included: 1 for the FNN, 50 for the FNN-HIB of S2.
    """

    form: Literal["feed_forward"] = "feed_forward"
    hidden: tuple[Annotated[int, Field(ge=2)], ...] = (64, 64)
    history: Count = 1

    @property
    def context(self) -> int:
        """Samples before the present one."""
        return self.history - 1

    def network(self, rest: float, operator: Operator | None) -> Network:
        from .network_ import FeedForwardNet  # torch is loaded by these methods only

        del operator
        return FeedForwardNet(self.hidden, self.history, rest)


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
    memory_samples: Annotated[int, Field(ge=0)] = 300
    command_gain: Positive = 4.0

    def lstm(self, outputs: int = 1) -> LstmNet:
        """An LSTM of this size with initial weights drawn from torch's generator."""
        from .recurrent_ import LstmNet

        return LstmNet(self.hidden, self.layers, self.memory_samples, self.command_gain, outputs)


class RecurrentSettings(CellSettings):
    """An LSTM or a GRU, see `LstmNet` and `GruNet`."""

    form: Literal["recurrent"] = "recurrent"
    cell: Literal["lstm", "gru"] = "lstm"

    def network(self, rest: float, operator: Operator | None) -> Network:
        from .recurrent_ import GruNet

        del rest, operator
        if self.cell == "lstm":
            return self.lstm()
        return GruNet(self.hidden, self.layers, self.memory_samples, self.command_gain)


class HybridSettings(CellSettings):
    """An LSTM with a backlash that is fitted by least squares beforehand, see `SerialNet` and `ParallelNet`.

    Attributes:
        head_gain: factor on the initial weights of the LSTM's head; small, training starts from the backlash itself.
        dead_zone: of the inverse backlash of an inverse map: changes of the measured angle [deg] that count as none;
            None for what fits the training trials best.
    """

    has_backlash: ClassVar[bool] = True
    form: Literal["serial", "parallel"]
    head_gain: Annotated[float, Field(ge=0)] = 0.1
    dead_zone: Annotated[float, Field(ge=0, le=10)] | None = None

    def network(self, rest: float, operator: Operator | None) -> Network:
        from .hybrid_ import ParallelNet, SerialNet

        del rest
        if operator is None:
            raise TypeError("a hybrid needs its operator, got None")
        net = SerialNet if self.form == "serial" else ParallelNet
        return net(self.lstm(net.outputs), operator, self.head_gain)
