"""Settings of network training: on short windows as in the papers, and on streams of whole trials."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hystmpc.trials.config import Count, NotNegative, NotNegativeInt, Positive, Settings, Share

from ..networks.settings import NetworkForm, RecurrentSettings


class ScalingSettings(Settings):
    """Scaling of devices of one command unit; for others the ranges of the trials are mapped to [-1, 1].

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
    """Rest of a device of one command unit: what stands before a trial where a network looks further back.

    Attributes:
        unit: of the command; for another unit a trial's first sample is its rest.
        command: command at rest.
        angle: angle at rest [deg].
    """

    unit: str = "mm"
    command: float = 0.0
    angle: float = 30.0


class WindowTraining(Settings):
    """Training on short windows, a recurrent state zero at the start of each.

    Source: S1 (RA-L 2021) section II-C, S2 (RA-L 2024) section III.

    Attributes:
        length: samples in a window, all of them scored; 50 are 2 s at 25 Hz. A feed-forward network sees the samples
            before them as well, as many as it looks back on; one scored sample is what S2 trains it with.
        batch: windows in an update.
        epochs: greatest number of epochs; the one with the lowest validation error is kept.
        keep_after: epochs that are only kept if training ends before a later one (the code of S2 has 10).
        windows_per_epoch: windows drawn in an epoch, at any sample of any trial; None draws one per training sample.
        padding_samples: samples of rest before each trial, scored as all others; S2 has 50.
        constancy_weight: beta of the constant-in, constant-out term, S2 eq. (12); the paper trains with 0 and 1e-4
            and keeps the better. It needs windows of two samples or more.
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
    """A model of plays, fitted to the training trials, from which the network learns beside them.

    A few decaying sinusoids say nothing of ramps, holds and other amplitudes, nor of what a controller sends. The
    operator fills them in as hysteresis would; the trials then correct what the operator gets wrong. This is ours, not
    in the papers.

    Attributes:
        model: `pi` for a Prandtl-Ishlinskii operator; `play_kernel` for a monotone sum of functions of plays, which
            also saturates and has dead zones.
        plays: number of plays of a `pi`.
        runs: motions of 10 to 60 s drawn anew for each round.
        weight: weight of a teacher's sample against a recorded one, at the start of training and at its end.
        centred: take out of each training trial the mean by which it lies off the teacher. Angle sensors are zeroed
            anew for each trial; a network that follows the offsets of its training trials does worse on the next one.
    """

    model: Literal["pi", "play_kernel"] = "pi"
    plays: Count = 10
    runs: Count = 16
    weight: tuple[Share, Share] = (1.0, 0.7)
    centred: bool = False


class StreamTraining(Settings):
    """Truncated backpropagation over whole trials, many side by side, the state carried from piece to piece.

    What the network is trained in is what it is used in: a free run from the start of a trial.

    Attributes:
        length: samples in a piece, over which gradients flow.
        streams: trials side by side, pieces in an update.
        matrix_learning_rate: of Muon, for the matrices between hidden layers; `learning_rate` is for the rest.
        updates: number of updates; both rates fall to zero along a half cosine over them.
        rounds_between_checks: passes over the trials between two free runs over the held-out trials.
        copies: how often each recorded trial runs in a round.
        time_scaling: copies are stretched or compressed in time by up to this share, uniformly in the logarithm.
        longest_pause: copies pause once for up to this many samples, the angle held; 0 for none. That a device holds
            under constant command is an assumption (no creep), without which a network drifts where the trials have
            no holds.
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
        network: what it is made of.
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
