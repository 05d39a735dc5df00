"""The increment-gated LSTM in PyTorch: plays of the command, and a state that changes only with the command."""

from __future__ import annotations

import math
from typing import final

import numpy as np
import torch

from .lstm import LstmLayer, write_layer
from .network_ import Network, numbers
from .nodes import GraphWriter

SETTLED = 1e-5  # share of half the command range at which a lag has settled


@final
class GatedLstmNet(Network):
    """One LSTM layer over a command and its plays, with a state gated by the path of the command.

        w' = v + sign(w - v) max(k |w - v| - e, 0)                      lag, e = 1e-5; k = 0 for none
        p_i' = max(w' - r_i, min(w' + r_i, p_i)),  x = [w', p_1' ... p_n']
        m = 1 - exp(-|w' - w| / s)                                      share of the step that is taken
        (a, b) = LSTM(x, h, c)                                          see `LstmWeights`: its next h and c
        h' = h + m (a - h),  c' = c + m (b - c),  y = W [h', x] + bias

    Under a constant command the state stays constant after any history, since the lag ends after finitely many samples
    and then m = 0. Without the lag the motion depends on the path of the command alone: s is the path over which the
    cell forgets. The plays represent the hysteresis exactly; the cell learns what a sum of them cannot express.

    The state is [w, p_1 ... p_n, h, c]. Source: plays, Krejci, Hysteresis, Convexity and Dissipation in Hyperbolic
    Equations (1996); LSTM, S1 (RA-L 2021) eq. (1); the gate is ours.

    Args:
        hidden: cells H.
        radii: r (n,), positive, scaled.
        rest: scaled command at which a trial starts.
        keep: k in [0, 1), exp(-dt / tau) of a lag tau.
        path: s, scaled; None for an LSTM without the gate, m = 1.
    """

    def __init__(self, hidden: int, radii: np.ndarray, rest: float, keep: float, path: float | None) -> None:
        super().__init__()
        self.hidden, self.inputs, self.rest, self.keep, self.path = hidden, 1 + radii.size, rest, keep, path
        self.radii: torch.Tensor
        self.register_buffer("radii", torch.tensor(radii, dtype=torch.float32))
        self.w_ih = _drawn(4 * hidden, self.inputs)
        self.w_hh = _drawn(4 * hidden, hidden)
        self.bias = torch.nn.Parameter(torch.zeros(4 * hidden))
        self.head = torch.nn.Linear(hidden + self.inputs, 1)
        self.state_size = self.inputs + 2 * hidden

    def start(self, y: torch.Tensor) -> torch.Tensor:
        state = y.new_zeros(len(y), self.state_size)
        state[:, : self.inputs] = self.rest
        return state

    def forward(self, v: torch.Tensor, state: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        front, h, c = state.split([self.inputs, self.hidden, self.hidden], dim=1)
        x, share = self._front(v, front)
        outputs, recurrent = [], self.w_hh.T
        for driven, taken in zip((x @ self.w_ih.T + self.bias).unbind(1), share.unbind(1), strict=True):
            i, f, g, o = torch.addmm(driven, h, recurrent).chunk(4, dim=1)
            cell = torch.sigmoid(f) * c + torch.sigmoid(i) * torch.tanh(g)
            h = h + taken * (torch.sigmoid(o) * torch.tanh(cell) - h)
            c = c + taken * (cell - c)
            outputs.append(h)
        y = self.head(torch.cat([torch.stack(outputs, dim=1), x], dim=2))
        return y[..., 0], torch.cat([x[:, -1], h, c], dim=1)

    def _front(self, v: torch.Tensor, front: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Inputs x (N, T, 1 + n) and gates m (N, T, 1); at a kink the branch that moves counts."""
        last, plays = front[:, :1], front[:, 1:]
        rows, paths = [], []
        for w in v.split(1, dim=1):
            if self.keep:
                behind = last - w
                left = self.keep * behind.abs() - SETTLED
                w = w + behind.sign() * torch.where(left > 0, left, torch.zeros_like(left))
            pulled, pushed = w + self.radii, w - self.radii
            held = torch.where(pulled <= plays, pulled, plays)
            plays = torch.where(pushed >= held, pushed, held)
            rows.append(torch.cat([w, plays], dim=1))
            paths.append((w - last).abs())
            last = w
        x, path = torch.stack(rows, dim=1), torch.stack(paths, dim=1)
        return x, torch.ones_like(path) if self.path is None else 1.0 - torch.exp(path * (-1.0 / self.path))

    def write(self, writer: GraphWriter, v: str, state: str) -> tuple[str, list[str]]:
        plays, hidden = self.inputs - 1, self.hidden
        writer.split(state, [1, plays, hidden, hidden], ["w_last", "p_last", "h_0", "c_0"])
        w = self._write_lag(writer, v) if self.keep else writer.node("Identity", [v], "w")
        x = w
        if plays:
            radii = writer.weight("gated.radii", [numbers(self.radii)])
            writer.node("Min", [writer.node("Add", [w, radii], "pulled"), "p_last"], "held")
            writer.node("Max", [writer.node("Sub", [w, radii], "pushed"), "held"], "p")
            x = writer.join([w, "p"], "x")
        layer = LstmLayer(numbers(self.w_ih), numbers(self.w_hh), numbers(self.bias))
        following = write_layer(writer, 0, layer, x)
        if self.path is not None:
            following = self._write_gate(writer, w, following)
        shown = writer.join([following[0], x], "shown")
        y = writer.affine(shown, "gated.head", numbers(self.head.weight), numbers(self.head.bias), "y")
        return y, [x, *following]

    def _write_lag(self, writer: GraphWriter, v: str) -> str:
        keep, settled = writer.weight("gated.keep", [[self.keep]]), writer.weight("gated.settled", [[SETTLED]])
        writer.node("Sub", ["w_last", v], "behind")
        writer.node("Mul", [writer.node("Abs", ["behind"], "distance"), keep], "kept")
        writer.node("Sub", ["kept", settled], "left")
        writer.node("Max", ["left", writer.weight("zero", [[0.0]])], "remaining")
        writer.node("Mul", [writer.node("Sign", ["behind"], "side"), "remaining"], "lag")
        return writer.node("Add", [v, "lag"], "w")

    def _write_gate(self, writer: GraphWriter, w: str, following: list[str]) -> list[str]:
        assert self.path is not None
        rate = writer.weight("gated.rate", [[-1.0 / self.path]])
        path = writer.node("Abs", [writer.node("Sub", [w, "w_last"], "move")], "path")
        decay = writer.node("Exp", [writer.node("Mul", [path, rate], "exponent")], "decay")
        share = writer.node("Sub", [writer.weight("one", [[1.0]]), decay], "share")
        gated = []
        for now, then in zip(("h_0", "c_0"), following, strict=True):
            way = writer.node("Mul", [share, writer.node("Sub", [then, now], f"{now}_ahead")], f"{now}_way")
            gated.append(writer.node("Add", [now, way], f"{now}_gated"))
        return gated


def _drawn(rows: int, columns: int) -> torch.nn.Parameter:
    """Weights uniform within 1 / sqrt(columns), as in PyTorch's layers."""
    return torch.nn.Parameter(torch.empty(rows, columns).uniform_(-1.0, 1.0) / math.sqrt(columns))
