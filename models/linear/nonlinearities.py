"""Operators and models as nonlinearities of python-control, for its describing function plots."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from control import DescribingFunctionNonlinearity

from hystmpc.trials.errors import ModelError

from ..model import LoadedModel, Predictor
from ..operators.operator import Memoryless, Operator
from ..prediction.build import predictor_for
from ..stages import prepared
from .describing import closed_form, settled_cycle, whole_cycle


@final
class OperatorNonlinearity(DescribingFunctionNonlinearity):
    """Operator with a describing function in closed form, for `control.describing_function_plot` and `_response`.

        H(i omega) N(A) = -1

    Calls go through the operator's memory, less its output at the centre: F(0) = 0 at first. The centre is the mean of
    its input.

    Parameters
    ----------
    operator : Operator
        Play, stop, line, backlash, Prandtl-Ishlinskii sum, Maxwell slip or dead zones, without a rate.
    centre : float, optional
        Mean of the input, in its unit; 0 if left out. It matters where lines differ in slope, and for dead zones.

    Raises:
        ModelError: if there is no closed form: `SettledNonlinearity` has any model.

    Source: see `hystmpc.models.linear.describing`.
    """

    def __init__(self, operator: Operator, centre: float = 0.0) -> None:
        super().__init__()
        if closed_form(operator, np.ones(1), centre) is None:
            raise ModelError(
                f"describing function: {operator.name} has no closed form here, expected a play, stop, line, backlash, "
                "Prandtl-Ishlinskii sum, Maxwell slip or dead zones without a rate; use SettledNonlinearity"
            )
        self.operator, self.centre = operator, float(centre)
        self._run = prepared((operator,), 1.0)
        self._state = np.array(operator.at_rest(self.centre, self.centre, list(operator.values)), dtype=float).ravel()
        self._middle, self._state = self._run.step(self._state, self.centre)

    def __call__(self, A: float) -> float:
        """Evaluate the operator at a scalar input and keep its memory.

        Parameters
        ----------
        A : float
            Input, from the centre.

        Returns
        -------
        float
            Output, from that at the centre.

        """
        angle, self._state = self._run.step(self._state, self.centre + float(A))
        return angle - self._middle

    def _isstatic(self) -> Any:
        return isinstance(self.operator, Memoryless)

    def describing_function(self, A: float) -> complex:
        """Return the describing function in closed form.

        Parameters
        ----------
        A : float
            Amplitude of the sinusoidal input; at 0 the limit of small amplitudes.

        Returns
        -------
        complex
            Value of the describing function at the given amplitude.

        Raises:
            ModelError: if it is negative, or the lines of a backlash cross within the range.
        """
        form = closed_form(self.operator, np.array([_amplitude(A)]), self.centre)
        if form is None:
            raise ModelError(f"describing function: lines of {self.operator.name} cross within {A:.6g} of the centre")
        return complex(form[0])


@final
class SettledNonlinearity(DescribingFunctionNonlinearity):
    """Any model as a nonlinearity at one frequency: its describing function is that of the settled cycle.

    Networks, Bouc-Wen and whole chains have it. DF(A, omega) of a model that depends on the rate is that of
    `SettledNonlinearity(model, centre, omega)`.

    Parameters
    ----------
    model : LoadedModel or Predictor
        As `hystmpc.load_model` opens it.
    centre : float
        Mean of the command.
    omega : float, optional
        Frequency [rad/s]; that of 400 samples a period where left out, slow enough for a model without a rate.

    Raises:
        ModelError: if there are fewer than three samples a period.
    """

    def __init__(self, model: LoadedModel | Predictor, centre: float, omega: float | None = None) -> None:
        super().__init__()
        predictor = predictor_for(model) if isinstance(model, LoadedModel) else model
        self.predictor, self.centre = predictor, float(centre)
        self.samples, self.periods = (_SLOW, 1) if omega is None else whole_cycle(omega * predictor.dt)
        self._state = predictor.initial(0.0, self.centre)
        self._middle, self._state = predictor.advance(self._state, self.centre)

    def __call__(self, A: float) -> float:
        """Advance the model by one sample and keep its memory.

        Parameters
        ----------
        A : float
            Command, from the centre.

        Returns
        -------
        float
            Angle, from that at the centre.

        """
        angle, self._state = self.predictor.advance(self._state, self.centre + float(A))
        return angle - self._middle

    def describing_function(self, A: float) -> complex:
        """Return the describing function of the settled cycle.

        Parameters
        ----------
        A : float
            Amplitude of the sinusoidal command, above 0.

        Returns
        -------
        complex
            Value of the describing function at the given amplitude.

        Raises:
            ModelError: if it is not above 0.
        """
        amplitudes = np.array([_amplitude(A)])
        return complex(settled_cycle(self.predictor, self.centre, amplitudes, self.samples, self.periods).first[0])


_SLOW = 400


def _amplitude(value: float) -> float:
    if not value >= 0:
        raise ModelError(f"describing function: got an amplitude of {value}, expected 0 or more")
    return float(value)
