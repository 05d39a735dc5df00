"""The estimator of a model that learns: the model's own estimate, the filters of the learned part, a disturbance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from hystmpc.trials.types import Vec

from ..estimation.observer import Estimate, EstimatorSettings, Observer, OutputEstimator, usable_angle
from ..frozen import replace
from .bank import BankState
from .predictor import LearnedPredictor


@dataclass(frozen=True, eq=False)
class Learning:
    """What a `LearningEstimator` remembers.

    Attributes:
        model: the estimate of the model alone.
        bank: filters of the learned part.
        added: what the learned part adds to each of the model's angles [deg].
    """

    model: Estimate
    bank: BankState
    added: tuple[float, ...]


@final
class LearningEstimator(Observer):
    """An `OutputEstimator` whose model learns: y_k = m_k + s w' f_k + d_k + v_k.

    Weights w and share s are those of a `FilterBank`, d that of a `NoiseBank`, which sees what model and learned part
    leave over. Where weights or share change, d takes up the difference, so that the angle of now has no jump.

    An angle that is far from the prediction is accepted where the device can have gone there from the last one.
    """

    def __init__(self, predictor: LearnedPredictor, settings: EstimatorSettings) -> None:
        self._predictor, self._settings = predictor, settings
        self._plain = OutputEstimator(predictor.model, settings)
        self.delay_samples = settings.delay_samples
        self._bank = predictor.filters(settings.delay_samples)

    def init(self, y: float, u: float) -> Estimate:
        model = self._plain.init(y, u)
        bank = self._bank.init(model.angles[0], u, y)
        return self._whole(model, bank, model.bank, model.disturbance, model.variance)

    def sigma_ahead_deg(self, estimate: Estimate, travels: Vec) -> Vec:
        """As the plain estimator has it: the disturbance is what model and learned part leave over."""
        return self._plain.sigma_ahead_deg(estimate, travels)

    def correct(self, estimate: Estimate, y: float) -> Estimate:
        learning, angle, far = _learning(estimate), usable_angle(y), self._settings.outlier_deg
        offset = angle - estimate.angles[0]
        reach = far + self._bank.reach(learning.bank)
        if not (abs(offset - estimate.disturbance) <= far or abs(angle - estimate.measured) <= reach):
            return replace(estimate, missing=estimate.missing + 1)
        model = learning.model
        bank = self._bank.correct(learning.bank, angle, model.angles[0], model.disturbance)
        model = replace(self._plain.correct(model, angle), command=estimate.command, measured=angle, missing=0)
        change = self._bank.added(bank, model.angles[0], self.delay_samples) - learning.added[0]
        noise = estimate.bank.copy()
        noise[0] -= change
        if not model.responsive[0]:  # inside the dead band, where one is set
            return self._whole(model, bank, noise, estimate.disturbance - change, estimate.variance)
        noise, disturbance, variance = self._plain.bank.correct(noise, offset - change)
        return self._whole(model, bank, noise, disturbance, variance)

    def advance(self, estimate: Estimate, u: float) -> Estimate:
        return self._later(estimate, self._plain.advance(_model(estimate), u), u)

    def coast(self, estimate: Estimate, u: float) -> Estimate:
        return self._later(estimate, self._plain.coast(_model(estimate), u), u)

    def _later(self, before: Estimate, model: Estimate, u: float) -> Estimate:
        bank = self._bank.advance(_learning(before).bank, u)
        noise, variance = self._plain.bank.advance(before.bank, model.moves[0], before.disturbance)
        after = self._whole(model, bank, noise, before.disturbance, variance)
        return replace(after, missing=before.missing) if before.missing else after

    def _whole(self, model: Estimate, bank: BankState, noise: Vec, disturbance: float, variance: float) -> Estimate:
        back = self.delay_samples
        added = tuple(self._bank.added(bank, angle, back - k) for k, angle in enumerate(model.angles))
        return replace(
            model,
            state=self._predictor.with_learned(model.state, bank),
            angles=tuple(angle + more for angle, more in zip(model.angles, added, strict=True)),
            disturbance=disturbance,
            variance=variance,
            bank=noise,
            added=added[0],
            learning=Learning(model, bank, added),
            distrust=bank.distrust,
        )


def _model(estimate: Estimate) -> Estimate:
    """The estimate of the model alone, with the command that the device really holds."""
    model = _learning(estimate).model
    return model if model.command == estimate.command else replace(model, command=estimate.command)


def _learning(estimate: Estimate) -> Learning:
    assert isinstance(estimate.learning, Learning)
    return estimate.learning
