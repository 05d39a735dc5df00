"""Networks of S2 (RA-L 2024): feed-forward over one command or a window, hybrids of an LSTM and a backlash."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, ClassVar, final

import casadi as ca
import numpy as np
import torch
from onnx import TensorProto

from hystmpc.models.contract.onnx_nodes import operator_nodes
from hystmpc.models.networks.network_ import Network, numbers
from hystmpc.models.networks.nodes import GraphWriter
from hystmpc.models.networks.recurrent_ import LstmNet
from hystmpc.models.operators.operator import Operator
from hystmpc.models.program import dense
from hystmpc.trials.types import Vec


@final
class FeedForwardNet(Network):
    """Feed-forward network y_k = W_n relu(... relu(W_1 [v_{k-n+1}, ..., v_k] + b_1) ...) + b_n, FNN and FNN-HIB.

    Source: S2 (RA-L 2024) section III-B.

    The state holds the n - 1 past inputs, oldest first. With n = 1 it is the last input, which is not read: a step of
    the contract has at least one entry.

    Args:
        history: n.
        rest: scaled input with which the buffer is filled at the start (S2 pads with u = 0 or theta = 30 deg).
    """

    def __init__(self, hidden: Sequence[int], history: int, rest: float) -> None:
        super().__init__()
        widths = [history, *hidden]
        self.hidden = torch.nn.ModuleList(torch.nn.Linear(a, b) for a, b in pairwise(widths))
        self.head = torch.nn.Linear(widths[-1], 1)
        self.history, self.rest = history, rest
        self.context, self.state_size = history - 1, max(1, history - 1)

    def start(self, y: torch.Tensor) -> torch.Tensor:
        return torch.full((len(y), self.state_size), self.rest, dtype=y.dtype)

    def begin(self, past: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        return past if self.context else self.start(y)

    def forward(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        line = torch.cat([state, v], dim=1)
        x = line[:, self.state_size - self.context :].unfold(1, self.history, 1)
        for layer in self.hidden:
            x = torch.relu(layer(x))
        return self.head(x)[..., 0], line[:, -self.state_size :]

    def shown(self, v: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        del v
        return y

    def write(self, writer: GraphWriter, v: str, state: str) -> tuple[str, list[str]]:
        x = writer.join([state, v], "line") if self.context else v
        for k, layer in enumerate(self.hidden):
            z = writer.affine(x, f"hidden.{k}", *_numbers_of(layer), f"z_{k}")
            x = writer.node("Relu", [z], f"x_{k}")
        y = writer.affine(x, "head", *_numbers_of(self.head), "y")
        if self.state_size == 1:
            return y, [v]
        kept = writer.split(state, [1, self.state_size - 1], ["oldest", "kept"])[1]
        return y, [kept, v]


def _numbers_of(layer: torch.nn.Module) -> tuple[np.ndarray, np.ndarray]:
    return numbers(layer.get_parameter("weight")), numbers(layer.get_parameter("bias"))


@dataclass(frozen=True)
class OperatorStep:
    """One sample of an operator of which only the last output is known at the start.

    Attributes:
        function: CasADi function (x (S,1), u, p (P,1)) -> (y, next x (S,1)).
        offset, slope: initial state x = offset + slope y (S,), y the output that is seen.
    """

    function: Any
    offset: Vec
    slope: Vec

    @property
    def size(self) -> int:
        """Entries S of the state."""
        return self.offset.size


def operator_step(operator: Operator, dt: float = 1.0) -> OperatorStep:
    """Step of an operator of this structure; `dt` [s] matters for rate-dependent ones.

    An operator whose state at rest follows from its output alone (a backlash) has just that state. One that has to
    see its first input (the inverse backlash, which compares inputs) gets two further entries, the output that was
    seen and whether a sample has been: its first sample finds it at rest at that input and that output.
    """
    size, count = len(operator.states), len(operator.parameters)
    x, u, y, p = ca.SX.sym("x", size), ca.SX.sym("u"), ca.SX.sym("y"), ca.SX.sym("p", count)
    rest = ca.densify(ca.SX(operator.at_rest(u, y, p)))
    if not ca.depends_on(rest, ca.vertcat(u, p)):
        following, output = operator.equation(x, u, p, dt)
        at = [np.asarray(ca.Function("rest", [y], [rest])(v)).ravel() for v in (0.0, 1.0)]
        return OperatorStep(dense("operator", [x, u, p], [output, following]), at[0], at[1] - at[0])
    seen = ca.SX.sym("seen")
    own = ca.vertcat(*(ca.if_else(seen > 0.5, x[i], rest[i]) for i in range(size)))
    following, output = operator.equation(own, u, p, dt)
    whole = ca.vertcat(x, y, seen)
    function = dense("operator", [whole, u, p], [output, ca.vertcat(following, y, 1.0)])
    return OperatorStep(function, np.zeros(size + 2), np.eye(size + 2)[size])


@final
class OperatorLayer:
    """Recursion of an `OperatorStep` over a sequence, with parameters that may change from sample to sample.

    A sequence in PyTorch's own operations costs a dozen of them a sample; CasADi evaluates all rows of a sample at
    once. Derivatives are those of the active branch: step functions have none (S2 section III-C).
    """

    def __init__(self, step: OperatorStep) -> None:
        self.step, self._text = step, step.function.serialize()
        self._offset, self._slope = torch.tensor(step.offset), torch.tensor(step.slope)

    def start(self, y: torch.Tensor) -> torch.Tensor:
        """States (N, S) that match outputs y (N,)."""
        return self._offset.to(y) + self._slope.to(y) * y[:, None]

    def __call__(self, u: torch.Tensor, p: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Outputs (N, T) and last states (N, S) from inputs (N, T), parameters (N, T, P) and states (N, S)."""
        y, following = _Recursion.apply(u, p, state, self._text)
        return y, following

    def __deepcopy__(self, memo: dict[int, Any]) -> OperatorLayer:
        return self  # it never changes, and a CasADi function cannot be copied


class _Recursion(torch.autograd.Function):
    """Arrays are (T, N, ...) within, so that one sample of all rows is one block of memory."""

    @staticmethod
    def forward(ctx: Any, u: Any, p: Any, state: Any, step: str) -> tuple[torch.Tensor, torch.Tensor]:
        inputs, parameters = (_by_sample(part) for part in (u, p))
        samples, rows = inputs.shape
        states, y = np.empty((samples + 1, rows, state.shape[1])), np.empty((samples, rows))
        states[0] = state.detach().numpy()
        _evaluate(_run(step, rows, samples), (states[0], inputs, parameters), (y, states[1:]))
        ctx.step, ctx.arrays = step, (states, inputs, parameters)
        return torch.from_numpy(y.T.copy()).to(u.dtype), torch.from_numpy(states[-1].copy()).to(u.dtype)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Any) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, None]:
        states, inputs, parameters = ctx.arrays
        by_y, last = _by_sample(grad_outputs[0]), grad_outputs[1].double().numpy()
        (samples, rows), size, count = inputs.shape, states.shape[2], parameters.shape[2]
        # Derivatives of the next state x by x, u and p, and of y by them; matrices of CasADi are column-major.
        shapes = ((size, size), (size,), (size,), (), (count, size), (count,))
        slopes = [np.empty((samples, rows, *shape)) for shape in shapes]
        _evaluate(_partials(ctx.step, samples * rows), (states[:-1], inputs, parameters), slopes)
        a, b, c, d, e, f = slopes
        by_next = np.empty((samples, rows, size))  # of the loss by the state after each sample
        now = np.array(last)
        for t in range(samples - 1, -1, -1):
            by_next[t], through = now, a[t] * now[:, None, :]
            now = by_y[t][:, None] * c[t]
            for i in range(size):
                now += through[:, :, i]
        by_u, by_p = by_y * d, by_y[:, :, None] * f
        for i in range(size):
            by_u += by_next[:, :, i] * b[:, :, i]
            by_p += by_next[:, :, i, None] * e[:, :, :, i]
        dtype = grad_outputs[0].dtype
        first, second = (torch.from_numpy(np.swapaxes(part, 0, 1).copy()).to(dtype) for part in (by_u, by_p))
        return first, second, torch.from_numpy(now).to(dtype), None


def _by_sample(part: torch.Tensor) -> Vec:
    """Rows (N, T, ...) as one array (T, N, ...)."""
    return np.ascontiguousarray(np.swapaxes(part.detach().double().numpy(), 0, 1))


def _evaluate(function: Any, inputs: Sequence[Any], outputs: Sequence[Any]) -> None:
    """Evaluate a CasADi function on the memory of contiguous arrays."""
    buffer, evaluate = function.buffer()
    for k, part in enumerate(inputs):
        buffer.set_arg(k, memoryview(part))
    for k, part in enumerate(outputs):
        buffer.set_res(k, memoryview(part))
    evaluate()


@lru_cache(maxsize=64)
def _run(serialized: str, rows: int, samples: int) -> Any:
    """The step over a sequence of all rows."""
    return ca.Function.deserialize(serialized).map(rows).mapaccum("run", samples, [0], [1])


@lru_cache(maxsize=64)
def _partials(serialized: str, columns: int) -> Any:
    """The derivatives of the step, on so many columns."""
    function = ca.Function.deserialize(serialized)
    x, p = ca.SX.sym("x", function.numel_in(0)), ca.SX.sym("p", function.numel_in(2))
    u = ca.SX.sym("u")
    y, following = function(x, u, p)
    by = ca.jacobian
    parts = [by(following, x), by(following, u), by(y, x), by(y, u), by(following, p), by(y, p)]
    return dense("partials", [x, u, p], parts).map(columns)


STEERED = 4  # m_lo, m_up, c_lo, c_up


class Hybrid(Network):
    """Hybrid of an LSTM and an operator; the state is [LSTM state, operator state].

    Args:
        lstm: with `outputs` outputs.
        operator: `Backlash` or `InverseBacklash` in scaled units, fitted to the training trials.
        head_gain: factor on the initial weights of the LSTM's head.

    Attributes:
        outputs: numbers that the LSTM has to give a sample.
        steered: leading parameters of the operator that the LSTM gives; the others stay fixed.
    """

    outputs: ClassVar[int]
    steered: ClassVar[int]

    def __init__(self, lstm: LstmNet, operator: Operator, head_gain: float) -> None:
        super().__init__()
        self.lstm, self.layer = lstm, OperatorLayer(operator_step(operator))
        self.fixed: torch.Tensor
        self.register_buffer("fixed", torch.tensor(operator.values, dtype=torch.float32)[self.steered :])
        with torch.no_grad():
            self.lstm.head.weight.mul_(head_gain)
        self.measured = self.layer.step.size
        self.state_size = self.lstm.state_size + self.measured

    def start(self, y: torch.Tensor) -> torch.Tensor:
        return torch.cat([self.lstm.start(y), self.layer.start(y)], dim=1)

    def begin(self, past: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        del past
        return self.start(y)

    def parts(self, state: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """State of the LSTM and state of the operator."""
        return state.tensor_split([self.lstm.state_size], dim=1)

    def write_lstm(self, writer: GraphWriter, v: str, state: str) -> tuple[str, list[str]]:
        """Nodes of the LSTM: its outputs and next state; the operator's state is named `held`."""
        writer.split(state, [self.lstm.state_size, self.measured], ["memory", "held"])
        return self.lstm.write(writer, v, "memory")

    def write_operator(self, writer: GraphWriter, v: str, steered: Sequence[str] = ()) -> tuple[str, list[str]]:
        """Nodes of the operator's step from the columns `held`: the output and the next state's columns."""
        fixed = [writer.weight(f"fixed_{k}", [[value]]) for k, value in enumerate(numbers(self.fixed).tolist())]
        size = self.layer.step.size
        columns = writer.split("held", [1] * size, [f"held_{k}" for k in range(size)])
        inputs = [columns, [v], [*steered, *fixed]]
        program = operator_nodes(self.layer.step.function, inputs, "operator_", TensorProto.FLOAT)
        for name, value in program.constants.items():
            writer.weight(name, [[value]])
        writer.nodes += program.nodes
        (y,), following = program.outputs
        return y, [_batched(writer, name, v) if name in program.constants else name for name in following]


@final
class SerialNet(Hybrid):
    """Serial hybrid HB1: an LSTM gives the four parameters of a backlash at every sample (S2 eq. (6)).

        (m_lo, m_up, c_lo, c_up)_k = LSTM(v_1 ... v_k),  y_k = backlash(v_k, y_{k-1}; (m_lo, m_up, c_lo, c_up)_k)

    The inverse map has the inverse backlash (S2 eq. (3)) in its place, with v_{k-1} and its own y_{k-1}. The bias of
    the LSTM's head starts at the operator's parameters.
    """

    outputs = steered = STEERED

    def __init__(self, lstm: LstmNet, operator: Operator, head_gain: float) -> None:
        super().__init__(lstm, operator, head_gain)
        with torch.no_grad():
            self.lstm.head.bias.copy_(torch.tensor(operator.values, dtype=torch.float32)[:STEERED])

    def forward(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        memory, held = self.parts(state)
        steered, memory = self.lstm.outputs(v, memory)
        y, held = self.layer(v, torch.cat([steered, self.fixed.expand(*v.shape, -1)], dim=2), held)
        return y, torch.cat([memory, held], dim=1)

    def shown(self, v: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        del v
        return y

    def write(self, writer: GraphWriter, v: str, state: str) -> tuple[str, list[str]]:
        steered, following = self.write_lstm(writer, v, state)
        columns = writer.split(steered, [1] * STEERED, [f"parameter_{k}" for k in range(STEERED)])
        y, held = self.write_operator(writer, v, columns)
        return y, [*following, *held]


@final
class ParallelNet(Hybrid):
    """Parallel hybrid HB2: a fixed backlash, fitted beforehand, and an LSTM for its residual (S2 eq. (7)).

        y_k = backlash(v_k, b_{k-1}) + LSTM(v_1 ... v_k),  b_k the backlash's own output

    The inverse map adds an inverse backlash and an LSTM.
    """

    outputs, steered = 1, 0

    def __init__(self, lstm: LstmNet, operator: Operator, head_gain: float) -> None:
        super().__init__(lstm, operator, head_gain)
        with torch.no_grad():
            self.lstm.head.bias.mul_(head_gain)

    def forward(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        memory, held = self.parts(state)
        rest, memory = self.lstm(v, memory)
        main, held = self._backlash(v, held)
        return main + rest, torch.cat([memory, held], dim=1)

    def shown(self, v: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        """Output of the backlash, which runs over whole trials that contain the windows."""
        return self._backlash(v, self.layer.start(y[:, 0]))[0]

    def write(self, writer: GraphWriter, v: str, state: str) -> tuple[str, list[str]]:
        rest, following = self.write_lstm(writer, v, state)
        main, held = self.write_operator(writer, v)
        return writer.node("Add", [main, rest], "y_sum"), [*following, *held]

    def _backlash(self, v: torch.Tensor, held: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.layer(v, self.fixed.expand(*v.shape, -1), held)


def _batched(writer: GraphWriter, constant: str, v: str) -> str:
    """Constant as a column (N, 1) with as many rows as `v`."""
    zero = writer.weight("zero", [[0.0]])
    return writer.node("Add", [writer.node("Mul", [v, zero], f"{constant}_rows"), constant], f"{constant}_column")
