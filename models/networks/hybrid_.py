"""The two hybrids of S2: an LSTM that steers a backlash, and an LSTM beside one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import torch
from onnx import TensorProto

from hystmpc.trials.errors import ModelError

from ..lstm.torch_ import LstmNet
from ..operators.operator import Operator
from ..symbolic.onnx_nodes import operator_nodes
from .network_ import Network, numbers
from .nodes import GraphWriter
from .operator_ import OperatorLayer
from .operator_step import OperatorStep, operator_step

STEERED = 4  # m_lo, m_up, c_lo, c_up


@final
class SerialNet(Network):
    """HB1: an LSTM gives the four parameters of a backlash at every sample (S2 eq. (6)).

        (m_lo, m_up, c_lo, c_up)_k = LSTM(v_1 ... v_k),  y_k = backlash(v_k, y_{k-1}; (m_lo, m_up, c_lo, c_up)_k)

    The inverse map has the inverse backlash (S2 eq. (3)) in its place, with v_{k-1} and its own y_{k-1}. The state is
    [LSTM state, operator state]; the head's bias starts at the operator's parameters.

    Args:
        lstm: with four outputs.
        operator: `Backlash` or `InverseBacklash` in scaled units; what follows its four parameters stays fixed.
        head_gain: factor on the head's initial weights, so that the start is near the operator itself.

    Raises:
        ModelError: if the LSTM has another number of outputs.
    """

    def __init__(self, lstm: LstmNet, operator: Operator, head_gain: float) -> None:
        super().__init__()
        if lstm.head.out_features != STEERED:
            raise ModelError(f"serial hybrid: LSTM of {lstm.head.out_features} outputs, expected {STEERED}")
        self.lstm, self.layer = lstm, OperatorLayer(operator_step(operator))
        values = torch.tensor(operator.values, dtype=torch.float32)
        self.fixed: torch.Tensor
        self.register_buffer("fixed", values[STEERED:])
        with torch.no_grad():
            lstm.head.weight.mul_(head_gain)
            lstm.head.bias.copy_(values[:STEERED])
        self.measured = self.layer.step.size
        self.state_size = lstm.state_size + self.measured

    def start(self, y: torch.Tensor) -> torch.Tensor:
        return torch.cat([self.lstm.start(y), self.layer.start(y)], dim=1)

    def begin(self, past: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        del past
        return self.start(y)

    def forward(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        memory, held = state.tensor_split([self.lstm.state_size], dim=1)
        steered, memory = self.lstm.outputs(v, memory)
        y, held = self.layer(v, torch.cat([steered, self.fixed.expand(*v.shape, -1)], dim=2), held)
        return y, torch.cat([memory, held], dim=1)

    def shown(self, v: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        del v
        return y

    def write(self, writer: GraphWriter, v: str, state: str) -> tuple[str, list[str]]:
        writer.split(state, [self.lstm.state_size, self.measured], ["memory", "held"])
        steered, following = self.lstm.write(writer, v, "memory")
        columns = writer.split(steered, [1] * STEERED, [f"parameter_{k}" for k in range(STEERED)])
        y, held = _write_operator(writer, self.layer.step, v, columns + _columns(writer, self.fixed))
        return y, [*following, *held]


@final
class ParallelNet(Network):
    """HB2: a fixed backlash, fitted beforehand, and an LSTM that learns what it leaves (S2 eq. (7)).

        y_k = backlash(v_k, b_{k-1}) + LSTM(v_1 ... v_k),  b_k the backlash's own output

    The inverse map adds an inverse backlash and an LSTM. The state is [LSTM state, operator state].

    Args:
        lstm: with one output.
        operator: in scaled units, fitted to the training trials.
        head_gain: factor on the head's initial weights.
    """

    def __init__(self, lstm: LstmNet, operator: Operator, head_gain: float) -> None:
        super().__init__()
        self.lstm, self.layer = lstm, OperatorLayer(operator_step(operator))
        self.fixed: torch.Tensor
        self.register_buffer("fixed", torch.tensor(operator.values, dtype=torch.float32))
        with torch.no_grad():
            lstm.head.weight.mul_(head_gain)
            lstm.head.bias.mul_(head_gain)
        self.measured = self.layer.step.size
        self.state_size = lstm.state_size + self.measured

    def start(self, y: torch.Tensor) -> torch.Tensor:
        return torch.cat([self.lstm.start(y), self.layer.start(y)], dim=1)

    def begin(self, past: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        del past
        return self.start(y)

    def forward(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        memory, held = state.tensor_split([self.lstm.state_size], dim=1)
        rest, memory = self.lstm(v, memory)
        main, held = self._main(v, held)
        return main + rest, torch.cat([memory, held], dim=1)

    def shown(self, v: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        """The backlash's own output: it runs over whole trials, of which a window is a part."""
        return self._main(v, self.layer.start(y[:, 0]))[0]

    def write(self, writer: GraphWriter, v: str, state: str) -> tuple[str, list[str]]:
        writer.split(state, [self.lstm.state_size, self.measured], ["memory", "held"])
        rest, following = self.lstm.write(writer, v, "memory")
        main, held = _write_operator(writer, self.layer.step, v, _columns(writer, self.fixed))
        return writer.node("Add", [main, rest], "y_sum"), [*following, *held]

    def _main(self, v: torch.Tensor, held: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.layer(v, self.fixed.expand(*v.shape, -1), held)


def _columns(writer: GraphWriter, values: torch.Tensor) -> list[str]:
    """Fixed parameters as initializers (1, 1)."""
    return [writer.weight(f"fixed_{k}", [[value]]) for k, value in enumerate(numbers(values).tolist())]


def _write_operator(
    writer: GraphWriter, step: OperatorStep, v: str, parameters: Sequence[str]
) -> tuple[str, list[str]]:
    """Nodes of one step from the state columns `held`: the output and the next state's columns."""
    columns = writer.split("held", [1] * step.size, [f"held_{k}" for k in range(step.size)])
    program = operator_nodes(step.function, [columns, [v], parameters], "operator_", TensorProto.FLOAT)
    for name, value in program.constants.items():
        writer.weight(name, [[value]])
    writer.nodes += program.nodes
    (y,), following = program.outputs
    return y, [_batched(writer, name, v) if name in program.constants else name for name in following]


def _batched(writer: GraphWriter, constant: str, v: str) -> str:
    """A constant as a column (N, 1), as many rows as `v`."""
    zero = writer.weight("zero", [[0.0]])
    return writer.node("Add", [writer.node("Mul", [v, zero], f"{constant}_rows"), constant], f"{constant}_column")
