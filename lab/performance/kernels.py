"""Section on roll-outs and Jacobian of the network compared with the matrix-product limit of the machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import onnxruntime
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from hystmpc.models.model import Predictor
from hystmpc.models.prediction.exported import RoutedPredictor

from .report import Comparison, Reads
from .subjects import BenchSettings, Clock, Subject, TimedCall, Times

Float32 = NDArray[np.float32]
_RUN_FLOPS = 2e7  # a run of one job: long enough for the clock, short enough to be interrupted
_GOAL = 1.0 / 0.6  # at least 60 % of the limit
_JACOBIAN, _ROLLOUT = "Jacobian", "roll-outs"


def product_call(a: Float32, b: Float32, threads: int) -> Callable[[], object]:
    """Call of the product of `a` (M, K) and the constant `b` (K, N), with preallocated output."""
    shapes = {"a": a.shape, "c": (a.shape[0], b.shape[1])}
    tensors = {name: helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in shapes.items()}
    node = helper.make_node("MatMul", ["a", "b"], ["c"])
    graph = helper.make_graph([node], "product", [tensors["a"]], [tensors["c"]], [numpy_helper.from_array(b, "b")])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    # waiting threads must not burn the cores of the job that is timed next
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    binding = session.io_binding()
    binding.bind_ortvalue_input("a", onnxruntime.OrtValue.ortvalue_from_numpy(a))
    binding.bind_ortvalue_output("c", onnxruntime.OrtValue.ortvalue_from_numpy(np.empty(shapes["c"], np.float32)))
    return lambda: session.run_with_iobinding(binding)


def step_flops(hidden: int, layers: int) -> int:
    """Floating-point operations of one sample of one row of a stacked LSTM with one input and one output.

    F = 8 h^2 (2 L - 1) + 10 h: 2 (4 h) h for each of the L recurrent and L - 1 input products, 2 (4 h) for the scalar
    command, 2 h for the head; 98,944 for two layers of 64. Gates are not counted.
    """
    return 8 * hidden**2 * (2 * layers - 1) + 10 * hidden


def rollout_flops(hidden: int, layers: int, plans: int, horizon: int) -> int:
    """Operations of the roll-outs, N H F: every plan (N) at every sample (H)."""
    return plans * horizon * step_flops(hidden, layers)


def jacobian_flops(hidden: int, layers: int, horizon: int) -> int:
    """Operations of the Jacobian, (H + H (H + 1) / 2) F, by forward sensitivity.

    There is one row for the motion and one tangent row for each command given so far, with the same matrix products.
    Command j has no tangent row before sample j, so that sample k has k of them (triangular): 230 rows at H = 20.
    """
    return (horizon + horizon * (horizon + 1) // 2) * step_flops(hidden, layers)


@dataclass(frozen=True)
class Product:
    """Float32 matrix product (rows, inner) (inner, columns) by one library, `numpy` or `onnxruntime`."""

    library: str
    rows: int
    inner: int
    columns: int

    @property
    def name(self) -> str:
        """Name of the job."""
        return f"{self.library} {self.rows}x{self.inner}x{self.columns}"

    @property
    def calls(self) -> int:
        """Number of products in one run of the job."""
        return max(1, round(_RUN_FLOPS / self._flops))

    @property
    def run_flops(self) -> int:
        """Operations of one run of the job."""
        return self.calls * self._flops

    @property
    def _flops(self) -> int:
        return 2 * self.rows * self.inner * self.columns

    def job(self, threads: int) -> TimedCall:
        """Timed job with all products of one run."""
        rng = np.random.default_rng(0)
        a = rng.standard_normal((self.rows, self.inner)).astype(np.float32)
        b = rng.standard_normal((self.inner, self.columns)).astype(np.float32)
        out = np.empty((self.rows, self.columns), np.float32)
        once = product_call(a, b, threads) if self.library == "onnxruntime" else lambda: np.matmul(a, b, out=out)

        def run() -> None:
            for _ in range(self.calls):
                once()

        return TimedCall(self.name, run)


def products(hidden: int, plans: int, horizon: int) -> list[Product]:
    """Products of typical shapes by both libraries: batches of rows through one layer's gates, and a square one."""
    rows = sorted({horizon + 1, 64, plans})
    shapes = [*((r, hidden, 4 * hidden) for r in rows), (plans, 2 * hidden, 4 * hidden), (512, 512, 512)]
    return [Product(library, *shape) for library in ("numpy", "onnxruntime") for shape in shapes]


def best_rate(candidates: Sequence[Product], times: Mapping[str, Times]) -> tuple[str, float] | None:
    """Product with the greatest rate, and that rate [FLOP/s] by the median; None where none has been timed."""
    rates = {p.name: p.run_flops / times[p.name].median_s for p in candidates if p.name in times}
    return max(rates.items(), key=lambda item: item[1]) if rates else None


def kernel_rows(subject: Subject, settings: BenchSettings, clock: Clock, threads: int) -> list[Comparison]:
    """Rows of the Jacobian (one thread only, since it has few rows) and of N roll-outs, relative to the limit.

    The limit is the job's unavoidable operations (`jacobian_flops`, `rollout_flops`) at the rate of the best float32
    matrix product that NumPy's BLAS or onnxruntime makes on as many threads.
    """
    shapes = products(settings.hidden, settings.samples, settings.horizon)
    jobs = _jobs(subject, settings, threads)
    times = clock.measure([*jobs, *(shape.job(threads) for shape in shapes)], threads)
    best = best_rate(shapes, times)
    size = (settings.hidden, 2)
    jacobian = jacobian_flops(*size, settings.horizon)
    flops = {_JACOBIAN: jacobian, _ROLLOUT: rollout_flops(*size, settings.samples, settings.horizon)}
    names = {
        _JACOBIAN: f"Jacobian H={settings.horizon}",
        _ROLLOUT: f"{settings.samples} roll-outs",
    }
    rows = []
    for job in jobs:
        row = Comparison(
            section=f"{subject.name}, kernels, {_threads(threads)}",
            ours=names[job.name],
            other="matrix-product limit",
            reads=Reads.OVER_LIMIT,
            goal=_GOAL,
            times=times.get(job.name),
            note=_route(subject.own),
        )
        rows.append(_over_limit(row, flops[job.name], best))
    return rows


def _jobs(subject: Subject, settings: BenchSettings, threads: int) -> list[TimedCall]:
    state = subject.own.initial(subject.metadata.trained_angle.lower, subject.limits.lower)
    rng = np.random.default_rng(0)
    box = subject.limits
    plans = rng.uniform(box.lower, box.upper, (settings.samples, settings.horizon))
    rollouts = TimedCall(_ROLLOUT, lambda: subject.own.rollout(state, plans))
    if threads > 1:
        return [rollouts]
    return [TimedCall(_JACOBIAN, lambda: subject.own.linearise(state, plans[0])), rollouts]


def _route(predictor: Predictor) -> str:
    return predictor.route.name if isinstance(predictor, RoutedPredictor) else ""


def _over_limit(row: Comparison, flops: int, best: tuple[str, float] | None) -> Comparison:
    if row.times is None or best is None:
        return row
    name, rate = best
    limit_s = flops / rate
    facts = {"limit_gflop_per_s": rate / 1e9, "mflop": flops / 1e6}
    note = "; ".join(filter(None, (f"{rate / 1e9:.0f} GFLOP/s by {name}", row.note)))
    return row.measured(row.times.median_s / limit_s, limit_s=limit_s, facts=facts, note=note)


def _threads(count: int) -> str:
    return "one thread" if count == 1 else f"{count} threads"
