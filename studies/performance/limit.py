"""What the machine allows: the best matrix product of this process, and the operations that a job cannot avoid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .onnxruntime_ import product_call
from .timing import Job, Times

_RUN_FLOPS = 2e7  # a run of one job: long enough for the clock, short enough to be interrupted


def step_flops(hidden: int, layers: int) -> int:
    """Floating-point operations of one sample of one row of a stacked LSTM with one input and one output.

    F = 8 h^2 (2 L - 1) + 10 h: 2 (4 h) h for each of the L recurrent and L - 1 input products, 2 (4 h) for the scalar
    command, 2 h for the head; 98,944 for two layers of 64. Gates are not counted.
    """
    return 8 * hidden**2 * (2 * layers - 1) + 10 * hidden


def rollout_flops(hidden: int, layers: int, plans: int, horizon: int) -> int:
    """N H F: every plan (N) at every sample (H)."""
    return plans * horizon * step_flops(hidden, layers)


def jacobian_flops(hidden: int, layers: int, horizon: int) -> int:
    """(H + H (H + 1) / 2) F: forward sensitivity, one row for the motion and one for each command given so far.

    A tangent row takes the same matrix products as the motion; command j has none before sample j, so that sample k
    has k of them (triangular growth): 230 rows at H = 20.
    """
    return (horizon + horizon * (horizon + 1) // 2) * step_flops(hidden, layers)


@dataclass(frozen=True)
class Product:
    """A float32 matrix product (rows, inner) (inner, columns) by one library, `numpy` or `onnxruntime`."""

    library: str
    rows: int
    inner: int
    columns: int

    @property
    def name(self) -> str:
        """As jobs are called."""
        return f"{self.library} {self.rows}x{self.inner}x{self.columns}"

    @property
    def calls(self) -> int:
        """Products in one run of the job."""
        return max(1, round(_RUN_FLOPS / self._flops))

    @property
    def run_flops(self) -> int:
        """Operations of one run of the job."""
        return self.calls * self._flops

    @property
    def _flops(self) -> int:
        return 2 * self.rows * self.inner * self.columns

    def job(self, threads: int) -> Job:
        """The product, as often as one run needs."""
        rng = np.random.default_rng(0)
        a = rng.standard_normal((self.rows, self.inner)).astype(np.float32)
        b = rng.standard_normal((self.inner, self.columns)).astype(np.float32)
        out = np.empty((self.rows, self.columns), np.float32)
        once = product_call(a, b, threads) if self.library == "onnxruntime" else lambda: np.matmul(a, b, out=out)

        def run() -> None:
            for _ in range(self.calls):
                once()

        return Job(self.name, run)


def products(hidden: int, plans: int, horizon: int) -> list[Product]:
    """Shapes of the work, batches of rows through the gates of one layer, and a square one, by both libraries."""
    rows = sorted({horizon + 1, 64, plans})
    shapes = [*((r, hidden, 4 * hidden) for r in rows), (plans, 2 * hidden, 4 * hidden), (512, 512, 512)]
    return [Product(library, *shape) for library in ("numpy", "onnxruntime") for shape in shapes]


def best_rate(candidates: Sequence[Product], times: Mapping[str, Times]) -> tuple[str, float] | None:
    """Product with the greatest rate, and that rate [FLOP/s] by the median; None where none has been timed."""
    rates = {p.name: p.run_flops / times[p.name].median_s for p in candidates if p.name in times}
    return max(rates.items(), key=lambda item: item[1]) if rates else None
