"""Settings of networks, one class for each form, which builds its network, and of their training."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, get_args

import numpy as np
from pydantic import BeforeValidator, Field, SerializeAsAny, model_validator

from hystmpc.trials.config import Count, NotNegative, NotNegativeInt, Positive, Settings, Share

if TYPE_CHECKING:
    from hystmpc.trials.trial import Trial

    from ..operators.operator import Operator
    from .network_ import Network
    from .nodes import Scaling
    from .recurrent_ import LstmNet

_SPAN = 2.0  # range of inputs scaled to [-1, 1]


@dataclass(frozen=True)
class DeviceFacts:
    """Properties of the device before its network is trained."""

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
        """Number of past samples in an output; 0 with a recurrent state."""
        return 0

    def operator(self, trials: Sequence[Trial], scaling: Scaling, skip_first_flexure: bool) -> Operator | None:
        """Operator in scaled units within the network, fitted to the training trials; None for none.

        Raises:
            FitError: if it cannot be fitted.
        """
        del trials, scaling, skip_first_flexure
        return None

    @abstractmethod
    def network(self, facts: DeviceFacts) -> Network:
        """Network with initial weights drawn from torch's generator."""


def _of_its_form(data: Any) -> Any:
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
        """LSTM of this size with initial weights drawn from torch's generator."""
        from .recurrent_ import LstmNet

        return LstmNet(self.hidden, self.layers, self.memory_samples, self.command_gain, outputs)


class RecurrentSettings(CellSettings):
    """LSTM or GRU, see `LstmNet` and `GruNet`."""

    form: Literal["recurrent"] = "recurrent"
    cell: Literal["lstm", "gru"] = "lstm"

    def network(self, facts: DeviceFacts) -> Network:
        from .recurrent_ import GruNet

        del facts
        if self.cell == "lstm":
            return self.lstm()
        return GruNet(self.hidden, self.layers, self.memory_samples, self.command_gain)


class GatedSettings(FormSettings):
    """LSTM over the plays of the command, whose state changes only with the command; see `GatedLstmNet`.

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
        if inverted:
            return np.geomspace(self.inverse_finest, self.reach, self.plays)
        return self.reach * np.arange(1, self.plays + 1) / max(self.plays, 1)


class ScalingSettings(Settings):
    """Scaling for devices of one command unit; for others the ranges of the trials are mapped to [-1, 1].

    Attributes:
        unit: of the command.
        command_offset, command_scale: scaled command (u - offset) / scale.
        angle_offset, angle_scale: likewise for the angle [deg]; an inverse map has the two pairs exchanged.
    """

    unit: str = "mm"
    command_offset: float = 0.0
    command_scale: Positive = 6.0
    angle_offset: float = 0.0
    angle_scale: Positive = 90.0


class RestSettings(Settings):
    """Rest of a device of one command unit, used as history before a trial.

    Attributes:
        unit: of the command; for another unit a trial's first sample is its rest.
        command: command at rest.
        angle: angle at rest [deg].
    """

    unit: str = "mm"
    command: float = 0.0
    angle: float = 30.0


class WindowTraining(Settings):
    """Training on short windows, with a recurrent state of zero at the start of each.

    Source: S1 (RA-L 2021) section II-C, S2 (RA-L 2024) section III.

    Attributes:
        length: samples in a window, all of them scored; 50 are 2 s at 25 Hz. A feed-forward network sees the samples
            before them as well, as many as it looks back on; one scored sample is what S2 trains it with.
        batch: windows in an update.
        epochs: greatest number of epochs; the one with the lowest validation error is kept.
        keep_after: epochs that are only kept if training ends before a later one (the code of S2 has 10).
        windows_per_epoch: windows drawn in an epoch, at any sample of any trial; None draws one per training sample.
        padding_samples: samples of rest before each trial, scored as all others; S2 has 50.
        constancy_weight: beta of the constant-in, constant-out term, S2 eq. (12); the paper trains with 0 and 1e-4 and
            keeps the better. It needs windows of two samples or more.
    """

    scheme: Literal["windows"] = "windows"
    length: Count = 50
    batch: Count = 16
    epochs: Count = 100
    keep_after: NotNegativeInt = 0
    windows_per_epoch: Count | None = None
    padding_samples: NotNegativeInt = 0
    constancy_weight: NotNegative = 0.0

    @model_validator(mode="after")
    def _long_enough(self) -> Self:
        if self.constancy_weight and self.length < 2:
            raise ValueError(f"constancy_weight is {self.constancy_weight:g} with length 1, expected length >= 2")
        return self


class TeacherSettings(Settings):
    """Model of plays, fitted to the training trials, whose free runs are additional training data of a network.

    A few decaying sinusoids contain no ramps, holds and other amplitudes, nor commands of a controller. The operator
    supplies them; the trials then correct its errors. This is ours, not in the papers.

    Attributes:
        model: `pi` for a Prandtl-Ishlinskii operator; `play_kernel` for a monotone sum of functions of plays, which
            also saturates and has dead zones.
        plays: number of plays of a `pi`.
        runs: motions of 10 to 60 s drawn anew for each round.
        weight: weight of a teacher's sample against a recorded one, at the start of training and at its end.
        centred: subtract from each training trial its mean offset from the teacher. Angle sensors are zeroed anew for
            each trial; a network that follows the offsets of its training trials does worse on the next one.
    """

    model: Literal["pi", "play_kernel"] = "pi"
    plays: Count = 10
    runs: Count = 16
    weight: tuple[Share, Share] = (1.0, 0.7)
    centred: bool = False


class StreamTraining(Settings):
    """Truncated backpropagation over whole trials in parallel, with the state passed from piece to piece.

    Training thus equals use: a free run from the start of a trial.

    Attributes:
        length: samples in a piece, over which gradients flow.
        streams: trials side by side, pieces in an update.
        matrix_learning_rate: of Muon, for the matrices between hidden layers; `learning_rate` is for the rest.
        updates: number of updates; both rates fall to zero along a half cosine over them.
        rounds_between_checks: passes over the trials between two free runs over the held-out trials.
        copies: how often each recorded trial runs in a round.
        time_scaling: copies are stretched or compressed in time by up to this share, uniformly in the logarithm.
        longest_pause: copies pause once for up to this many samples, the angle held; 0 for none. That a device holds
            under constant command is an assumption (no creep), without which a network drifts where the trials have no
            holds.
        clip_norm: greatest norm of a gradient.
        averaging: decay per update of the running mean of the weights, which is what is judged and returned.
        constancy_weight: beta of the constant-in, constant-out term, S2 eq. (12), over pieces.
        teacher: None to learn from the recorded trials alone.
    """

    scheme: Literal["streams"] = "streams"
    length: Annotated[int, Field(ge=2)] = 100
    streams: Count = 8
    matrix_learning_rate: Positive = 0.01
    updates: Count = 6000
    rounds_between_checks: Count = 10
    copies: Count = 2
    time_scaling: Annotated[float, Field(ge=0, le=0.5)] = 0.2
    longest_pause: NotNegativeInt = 250
    clip_norm: Positive = 1.0
    averaging: Annotated[float, Field(ge=0, lt=1)] = 0.98
    constancy_weight: NotNegative = 0.0
    teacher: TeacherSettings | None = TeacherSettings()


class NetworkSettings(Settings):
    """Settings of `fit_network`.

    Attributes:
        kind: name in model files and reports.
        name: of the training, for reports.
        network: form of the network and its sizes.
        scaling: None maps the ranges of the trials to [-1, 1], as S1 does.
        rest: None takes the first sample of each trial, and the least input of all for the start of a buffer.
        warmup_samples: samples of the first command, held and unscored, before a trial's first sample.
        first_flexure_weight: weight of samples before the first reversal of the command, 0 to leave them out; the
            network runs through them in any case.
        validation_trials: whole trials held out to choose the best weights. With 0 the training trials judge; the rates
            of `streams` end at zero, and of a handful of trials each is better spent on training.
        learning_rate: of Adam.
        seed: of weights, order and augmentation.
        threads: of torch.
        training: `windows` or `streams`.
    """

    kind: str = "lstm"
    name: str = "best"
    network: NetworkForm = RecurrentSettings()
    scaling: ScalingSettings | None = None
    rest: RestSettings | None = None
    warmup_samples: NotNegativeInt = 25
    first_flexure_weight: Share = 1.0
    validation_trials: NotNegativeInt = 0
    learning_rate: Positive = 3e-3
    seed: int = 1
    threads: Count = 1
    training: Annotated[WindowTraining | StreamTraining, Field(discriminator="scheme")] = StreamTraining()

    @property
    def steps(self) -> int:
        """Total number of epochs of windows or updates of streams."""
        return self.training.epochs if isinstance(self.training, WindowTraining) else self.training.updates
