"""Settings of LSTM training and its two presets: as in S2, and the best that we know."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hystmpc.trials.config import Settings

Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
Share = Annotated[float, Field(ge=0, le=1)]


class ScalingSettings(Settings):
    """v = (u - u_offset) / u_scale and theta = theta_offset + theta_scale y; see `LstmScaling`."""

    u_offset: float = 0.0
    u_scale: Positive = 6.0
    theta_offset: float = 0.0
    theta_scale: Positive = 90.0


class WindowTraining(Settings):
    """Training on short windows, the state zero at the start of each (S1 section II-C, S2 section III).

    Attributes:
        length: samples in a window; 50 are 2 s at 25 Hz.
        batch: windows in an update.
        epochs: greatest number of epochs; the one with the lowest validation error is kept.
        windows_per_epoch: windows drawn in an epoch, at any sample of any trial; None draws one per training sample.
        constancy_weight: beta of the constant-in, constant-out term, S2 eq. (12); the paper trains with 0 and 1e-4
            and keeps the better.
    """

    scheme: Literal["windows"] = "windows"
    length: Annotated[int, Field(ge=2)] = 50
    batch: Count = 16
    epochs: Count = 100
    windows_per_epoch: Count | None = None
    constancy_weight: Annotated[float, Field(ge=0)] = 0.0


class TeacherSettings(Settings):
    """A Prandtl-Ishlinskii model, fitted to the training trials, from which the network learns beside them.

    A few decaying sinusoids say nothing of ramps, holds and other amplitudes, nor of what a controller sends. The
    operator fills them in as hysteresis would; the trials then correct what the operator gets wrong. This is ours, not
    in the papers.

    Attributes:
        plays: number of plays of the operator.
        runs: motions of 10 to 60 s drawn anew for each round.
        weight: weight of a teacher's sample against a recorded one, at the start of training and at its end.
    """

    plays: Count = 10
    runs: Count = 16
    weight: tuple[Share, Share] = (1.0, 0.7)


class StreamTraining(Settings):
    """Truncated backpropagation over whole trials, many side by side, the state carried from piece to piece.

    What the network is trained in is what it is used in: a free run from the start of a trial.

    Attributes:
        length: samples in a piece, over which gradients flow.
        streams: trials side by side, pieces in an update.
        matrix_learning_rate: of Muon, for the gate matrices; `learning_rate` is for the rest.
        updates: number of updates; both rates fall to zero along a half cosine over them.
        rounds_between_checks: passes over the trials between two free runs over the held-out trials.
        copies: how often each recorded trial runs in a round.
        time_scaling: copies are stretched or compressed in time by up to this share, uniformly in the logarithm.
        longest_pause: copies pause once for up to this many samples, the angle held; 0 for none. That a device holds
            under constant command is an assumption (no creep), without which a network drifts where the trials have
            no holds.
        clip_norm: greatest norm of a gradient.
        averaging: decay per update of the running mean of the weights, which is what is judged and returned.
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
    longest_pause: Annotated[int, Field(ge=0)] = 250
    clip_norm: Positive = 1.0
    averaging: Annotated[float, Field(ge=0, lt=1)] = 0.98
    teacher: TeacherSettings | None = TeacherSettings()


class LstmSettings(Settings):
    """What `fit_lstm` needs to know.

    Attributes:
        preset: name for reports.
        hidden, layers: size; the papers have two layers of 64.
        scaling: None maps the ranges of the trials to [-1, 1], as S1 does.
        memory_samples: longest memory of the gates before anything is learned; 0 for PyTorch's own initial weights.
        warmup_samples: samples of the first command, held and unscored, before a trial's first sample.
        command_gain: factor on the initial weights of the command. Direction shows only in its change from sample to
            sample, a hundredth of its range; louder from the start, hysteresis is found sooner.
        first_flexure_weight: weight of samples before the first reversal of the command, 0 to leave them out; the
            network runs through them in any case.
        validation_trials: whole trials held out to choose the best weights. With 0 the training trials judge; the rates
            of `streams` end at zero, and of a handful of trials each is better spent on training.
        learning_rate: of Adam.
        seed: of weights, order and augmentation.
        threads: of torch.
        training: `windows` or `streams`.
    """

    preset: str = "best"
    hidden: Annotated[int, Field(ge=2)] = 64
    layers: Count = 2
    scaling: ScalingSettings | None = None
    memory_samples: Annotated[int, Field(ge=0)] = 300
    warmup_samples: Annotated[int, Field(ge=0)] = 25
    command_gain: Positive = 4.0
    first_flexure_weight: Share = 1.0
    validation_trials: Annotated[int, Field(ge=0)] = 0
    learning_rate: Positive = 3e-3
    seed: int = 1
    threads: Count = 1
    training: Annotated[WindowTraining | StreamTraining, Field(discriminator="scheme")] = StreamTraining()

    @property
    def steps(self) -> int:
        """What `progress` counts up to: epochs of windows or updates of streams."""
        return self.training.epochs if isinstance(self.training, WindowTraining) else self.training.updates


LSTM_PRESETS = {
    "best": LstmSettings(),
    "paper": LstmSettings(
        preset="paper",
        scaling=ScalingSettings(),
        memory_samples=0,
        command_gain=1.0,
        validation_trials=1,
        warmup_samples=0,
        learning_rate=1e-3,
        training=WindowTraining(),
    ),
}
"""`paper`: S2 section III-D (windows of 50 at 25 Hz, Adam 1e-3, batch 16, at most 100 epochs, u/6 and theta/90)."""
