"""What the benchmark controls: a model with its fast predictor, its inverse and its CasADi function."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hystmpc.ctrl.limits import CommandLimits
from hystmpc.models.chain import Chain
from hystmpc.models.chain_model import ChainModel
from hystmpc.models.contract.metadata import ModelMetadata, Range
from hystmpc.models.load import AnyModel
from hystmpc.models.lstm.weights import LstmWeights
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.operators.backlash import Backlash
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.prediction.build import predictor_and_inverse, predictor_for
from hystmpc.models.simulator import Identification, Simulator

from .lstm_model import lstm_model

_SCAN_HZ = 0.25
_SCAN_SHARE = 0.25  # amplitude as a share of the angle range


@dataclass(frozen=True, eq=False)
class Subject:
    """A model under control.

    Attributes:
        name: short, for headings.
        source: one line on where it comes from.
        metadata: limits and ranges.
        predictor, inverse: as controllers use them; the model's own state stands first in the predictor's.
        own: predictor of the model alone, without a companion for the inverse.
        function: CasADi function (state (S, 1), u) -> (theta, next state) for peers.
        weights: of a network; None for operators.
    """

    name: str
    source: str
    metadata: ModelMetadata
    predictor: Predictor
    inverse: Inverse
    own: Predictor
    function: Any
    weights: LstmWeights | None = None

    @property
    def limits(self) -> CommandLimits:
        """Hard limits of the device."""
        box = self.metadata.command_limits
        return CommandLimits(box.lower, box.upper, self.metadata.command_rate)

    @property
    def state_size(self) -> int:
        """Entries S of the model's own state."""
        return int(self.function.numel_in(0))

    def scan(self, first: int, horizon: int) -> NDArray[np.float64]:
        """Wanted angles (H,) [deg] from sample `first` on: a sinusoid in the middle half of the angle range."""
        angle = self.metadata.trained_angle
        t = self.metadata.dt_s * (first + np.arange(horizon))
        span = angle.upper - angle.lower
        return 0.5 * (angle.lower + angle.upper) - _SCAN_SHARE * span * np.cos(2.0 * np.pi * _SCAN_HZ * t)

    @property
    def scan_samples(self) -> int:
        """Samples of one period of the scan."""
        return round(1.0 / (_SCAN_HZ * self.metadata.dt_s))


def lstm_subject(hidden: int) -> Subject:
    """The network; its inverse is that of a backlash fitted to it."""
    model, source = lstm_model(hidden)
    return _subject("LSTM", source, model, model.casadi_function(), LstmWeights.from_arrays(model.initializers))


def operator_subjects() -> list[Subject]:
    """Backlash (forward fit of RA-L 2024, PMC11633443 (S2)), and a rate-dependent Prandtl-Ishlinskii model like it."""
    operators: dict[str, Operator] = {
        "backlash": Backlash(10.27, 10.70, 2.822, 2.003),
        "PI": PrandtlIshlinskii(3.0, (2.5, 2.0, 1.5, 1.2), 0.15, 0.012, 22.0),
    }
    subjects = []
    for name, operator in operators.items():
        simulator = _catheter(Chain(operator))
        function = simulator.chain.bound(simulator.dt_s)
        source = f"{operator.name}, " + ", ".join(f"{v:g}" for v in operator.values)
        subjects.append(_subject(name, source, ChainModel(simulator, "conditioned"), function))
    return subjects


def _subject(name: str, source: str, model: AnyModel, function: Any, weights: LstmWeights | None = None) -> Subject:
    predictor, inverse = predictor_and_inverse(model)
    own = predictor_for(model)
    return Subject(name, source, model.metadata, predictor, inverse, own, function, weights)


def _catheter(chain: Chain) -> Simulator:
    return Simulator(
        chain=chain,
        dt_s=0.04,
        command_unit="mm",
        command_limits=Range(lower=0.0, upper=6.0),
        command_rate_per_s=12.0,
        trained_command=Range(lower=0.0, upper=6.0),
        trained_angle_deg=Range(lower=29.0, upper=85.0),
        trained_rate_per_s=12.0,
        identification=Identification(method="chosen by hand"),
    )
