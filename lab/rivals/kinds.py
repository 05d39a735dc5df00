"""Models of the papers used only by studies, as kinds of `hystmpc fit`: FNN, hybrids, support vectors.

Sources: S2 (Wu et al., RA-L 2024) sections III-B and III-D, S1 (Wu et al., RA-L 2021) section II-C.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal, final

from pydantic import Field

from hystmpc.models.kinds.kind import FitRequest, Identified, ModelKind, recorded
from hystmpc.models.kinds.networks import (
    PLAIN,
    S1_WINDOWS,
    S2_WINDOWS,
    NetworkKind,
    by_training,
    s1_settings,
    s2_settings,
)
from hystmpc.models.model import FitProgress
from hystmpc.models.networks.settings import CellSettings, DeviceFacts, FormSettings, NetworkSettings, StreamTraining
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.trials.config import Count
from hystmpc.trials.trial import Trial

if TYPE_CHECKING:
    from hystmpc.models.networks.network_ import Network
    from hystmpc.models.networks.nodes import Scaling
    from hystmpc.models.operators.operator import Operator


class FeedForwardSettings(FormSettings):
    """Settings of ReLU layers over the present input and its past, see `FeedForwardNet`.

    Attributes:
        hidden: widths of the layers; S2 (RA-L 2024) has two of 64.
        history: samples that are looked at, the present one included: 1 for the FNN, 50 for the FNN-HIB of S2.
    """

    form: Literal["feed_forward"] = "feed_forward"
    hidden: tuple[Annotated[int, Field(ge=2)], ...] = (64, 64)
    history: Count = 1

    @property
    def context(self) -> int:
        """Number of samples before the present one."""
        return self.history - 1

    def network(self, facts: DeviceFacts) -> Network:
        from .networks_ import FeedForwardNet

        return FeedForwardNet(self.hidden, self.history, facts.rest)


class HybridSettings(CellSettings):
    """Settings of an LSTM with a backlash fitted by least squares beforehand, see `SerialNet` and `ParallelNet`.

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
        from .networks_ import ParallelNet, SerialNet

        operator = facts.operator or Backlash(1.0, 1.0, 0.1, -0.1)  # unfitted, where only the time of an update counts
        net = SerialNet if self.form == "serial" else ParallelNet
        return net(self.lstm(net.outputs), operator, self.head_gain)


_HISTORY = 50
_FNN = FeedForwardSettings()
_HIB = FeedForwardSettings(history=_HISTORY)
_HB1 = HybridSettings(form="serial")
_HB2 = HybridSettings(form="parallel")
_PLAIN_HEAD = PLAIN | {"head_gain": 1.0}
_SERIAL = S2_WINDOWS.model_copy(update={"batch": 4})
_SINGLE = {"length": 1}  # a feed-forward network is scored on the last sample of its window

FNN = NetworkKind(
    "fnn",
    "FNN",
    by_training(
        NetworkSettings(
            kind="fnn", network=_FNN, warmup_samples=0, training=StreamTraining(updates=1500, teacher=None)
        ),
        s2_settings("fnn", _FNN, S2_WINDOWS.model_copy(update=_SINGLE)),
        s1_settings("fnn", _FNN, S1_WINDOWS.model_copy(update=_SINGLE)),
    ),
    recurrent=False,
)
"""Two ReLU layers of 64 over the present command alone, S2 section III-B; see `FeedForwardNet`."""

FNN_HIB = NetworkKind(
    "fnn_hib",
    "FNN-HIB",
    by_training(
        NetworkSettings(
            kind="fnn_hib", network=_HIB, warmup_samples=_HISTORY - 1, training=StreamTraining(updates=6000)
        ),
        s2_settings("fnn_hib", _HIB, S2_WINDOWS.model_copy(update=_SINGLE)),
        s1_settings("fnn_hib", _HIB, S1_WINDOWS.model_copy(update=_SINGLE)),
    ),
)
"""Two ReLU layers of 64 over the last 50 commands, S2 section III-B; see `FeedForwardNet`."""

HB1 = NetworkKind(
    "hb1",
    "HB1",
    by_training(
        NetworkSettings(kind="hb1", network=_HB1, training=StreamTraining(updates=4000)),
        s2_settings("hb1", _HB1.model_copy(update=_PLAIN_HEAD)),
        s2_settings("hb1", _HB1.model_copy(update=_PLAIN_HEAD), _SERIAL, "paper-batch-4"),
    ),
)
"""An LSTM that gives the four parameters of a backlash at every sample, S2 eq. (6); see `SerialNet`."""

HB2 = NetworkKind(
    "hb2",
    "HB2",
    by_training(
        NetworkSettings(kind="hb2", network=_HB2, training=StreamTraining(updates=4000)),
        s2_settings("hb2", _HB2.model_copy(update=_PLAIN_HEAD)),
    ),
)
"""A backlash fitted beforehand and an LSTM that adds what it leaves, S2 eq. (7); see `ParallelNet`."""


@final
class SvrKind(ModelKind):
    """Radial kernel on 50 past commands, S1 (RA-L 2021): `paper` with its values, `grid` with its search, or `best`.

    See `SvrWeights` for the equations and `SvrSettings` for what is compared how.
    """

    name = "svr"
    title = "SVR"
    trainings = ("best", "paper", "grid")

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None) -> Identified:
        from hystmpc.models.identify.estimation_noise import with_noise

        from .svr_ import SVR_TRAININGS, fit_svr, svr_bundle

        self.check(trials, request)
        settings = SVR_TRAININGS[request.training].model_copy(update={"seed": request.seed})
        history, show = recorded(progress)
        found = fit_svr(trials, settings, request.skip_first_flexure, show)
        choice, unit = found.choice, trials[0].units.angle
        report = (
            f"C {choice.c:g}, gamma {choice.gamma:g}, epsilon {choice.epsilon:g}: {len(found.weights.supports)} "
            f"support vectors of {found.samples} samples, {found.rmse:.4g} {unit} on these"
        )
        if found.judged:
            report += f", {found.judged[choice]:.4g} {unit} on what was left out"
        bundle = svr_bundle(found, trials, settings, request.limits)
        bundle = with_noise(bundle, trials, len(found.weights.supports))
        return Identified(bundle, None, tuple(history), report, found.interrupted)

    def steps(self, request: FitRequest) -> int | None:
        from .svr_ import SVR_TRAININGS

        settings = SVR_TRAININGS.get(request.training)
        if settings is None:
            return None
        compared = len(settings.c) * len(settings.gamma) * len(settings.epsilon)
        return 1 + (compared if compared > 1 else 0)


SVR = SvrKind()
