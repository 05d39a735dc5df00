"""What the papers' networks are made of, as `hystmpc.models.networks.settings` has it for the product's."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from hystmpc.models.networks.settings import CellSettings, Count, DeviceFacts, FormSettings

if TYPE_CHECKING:
    from hystmpc.models.networks.network_ import Network


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

    def network(self, facts: DeviceFacts) -> Network:
        from .feed_forward_ import FeedForwardNet  # torch is loaded by these methods only

        return FeedForwardNet(self.hidden, self.history, facts.rest)


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

    def network(self, facts: DeviceFacts) -> Network:
        from .hybrid_ import ParallelNet, SerialNet

        if facts.operator is None:
            raise TypeError("a hybrid needs its operator, got None")
        net = SerialNet if self.form == "serial" else ParallelNet
        return net(self.lstm(net.outputs), facts.operator, self.head_gain)
