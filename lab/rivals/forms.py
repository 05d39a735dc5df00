"""What the papers' networks are made of, as `hystmpc.models.networks.settings` has it for the product's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from hystmpc.models.networks.settings import CellSettings, DeviceFacts, FormSettings
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.trials.config import Count

if TYPE_CHECKING:
    from hystmpc.models.networks.network_ import Network
    from hystmpc.models.networks.nodes import Scaling
    from hystmpc.models.operators.operator import Operator
    from hystmpc.trials.trial import Trial


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

    form: Literal["serial", "parallel"]
    head_gain: Annotated[float, Field(ge=0)] = 0.1
    dead_zone: Annotated[float, Field(ge=0, le=10)] | None = None

    def operator(self, trials: Sequence[Trial], scaling: Scaling, skip_first_flexure: bool) -> Operator:
        from .backlash import fitted_backlash, scaled_operator

        return scaled_operator(fitted_backlash(trials, skip_first_flexure, self.dead_zone), scaling)

    def network(self, facts: DeviceFacts) -> Network:
        from .hybrid_ import ParallelNet, SerialNet

        net = SerialNet if self.form == "serial" else ParallelNet
        operator = facts.operator or Backlash(1.0, 1.0, 0.1, -0.1)  # unfitted, where only the time of an update counts
        return net(self.lstm(net.outputs), operator, self.head_gain)
