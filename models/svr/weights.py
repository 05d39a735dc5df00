"""The numbers of a support-vector regression on a window of commands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hystmpc.trials.errors import ModelError

from ..model import Array


@dataclass(frozen=True)
class SvrWeights:
    """Radial basis functions around M support windows of the last L commands.

        w = (commands - u_offset) / u_scale,  commands = [u_k-(L-1)d, ..., u_k-d, u_k]
        theta = theta_offset + theta_scale (bias + sum_i a_i exp(-gamma |w - s_i|^2))

    The state is [u_k-(L-1)d, ..., u_k-1], S = (L - 1) d commands in their own unit, the newest last.

    Attributes:
        supports: s (M, L), scaled.
        coefficients: a (M,), the difference of the two multipliers.
        bias: scaled.
        gamma: width of the kernel.
        u_offset, u_scale: [cmd]; the trained commands become -1 to 1.
        theta_offset, theta_scale: [deg].
        stride: d, samples between the commands of a window.

    Source: S1 (SVR with a radial kernel, after Zhang 2017; the features are not stated there, the window is that of
    its LSTM).

    Raises:
        ModelError: if sizes do not fit, a number is not finite, or gamma or a scale is not positive.
    """

    supports: Array
    coefficients: Array
    bias: float
    gamma: float
    u_offset: float
    u_scale: float
    theta_offset: float
    theta_scale: float
    stride: int = 1

    def __post_init__(self) -> None:
        for name in ("supports", "coefficients"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if self.supports.ndim != 2 or self.coefficients.shape != self.supports.shape[:1] or self.supports.shape[1] < 2:
            raise ModelError(
                f"SVR: got supports {self.supports.shape} and coefficients {self.coefficients.shape}, "
                "expected (M, L) and (M,) with L >= 2"
            )
        scalars = [self.bias, self.gamma, self.u_offset, self.u_scale, self.theta_offset, self.theta_scale]
        finite = all(np.isfinite(a).all() for a in (self.supports, self.coefficients, scalars))
        if not finite or min(self.gamma, self.u_scale, self.theta_scale) <= 0 or self.stride < 1:
            raise ModelError(f"SVR: got {scalars}, expected finite numbers, gamma, scales and stride > 0")

    @property
    def lags(self) -> int:
        """Commands L in a window, the present one included."""
        return self.supports.shape[1]

    @property
    def state_size(self) -> int:
        """Number S = (L - 1) d of state entries."""
        return (self.lags - 1) * self.stride
