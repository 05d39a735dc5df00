"""From settings to an untrained network."""

from __future__ import annotations

import math

import torch

from ..operators.operator import Operator
from .hybrid_ import STEERED, ParallelNet, SerialNet
from .network_ import FeedForwardNet, Network
from .recurrent_ import GruNet, LstmNet
from .settings import CellSettings, FeedForwardSettings, HybridSettings, RecurrentSettings


def new_network(
    form: FeedForwardSettings | RecurrentSettings | HybridSettings, rest: float, operator: Operator | None
) -> Network:
    """A network with initial weights drawn from torch's generator.

    Args:
        form: what it is made of.
        rest: scaled input of a device at rest, for the buffer of a feed-forward network.
        operator: the fitted backlash in scaled units, for hybrids.
    """
    if isinstance(form, FeedForwardSettings):
        return FeedForwardNet(form.hidden, form.history, rest)
    if isinstance(form, RecurrentSettings):
        return _lstm(form) if form.cell == "lstm" else _gru(form)
    if operator is None:
        raise TypeError("a hybrid needs its operator, got None")
    if form.form == "serial":
        return SerialNet(_lstm(form, STEERED), operator, form.head_gain)
    return ParallelNet(_lstm(form), operator, form.head_gain)


def _lstm(form: CellSettings, outputs: int = 1) -> LstmNet:
    """PyTorch's initial weights with a gain on the input and, with `memory_samples`, gates that remember.

    Memories tau from 1 to that many samples, log(tau) uniform: forget bias log(tau), input bias -log(tau), after Tallec
    and Ollivier, ICLR 2018.
    """
    net = LstmNet(form.hidden, form.layers, outputs)
    net.lstm.get_parameter("weight_ih_l0").data.mul_(form.command_gain)
    if form.memory_samples:
        for k in range(form.layers):
            bias = net.lstm.get_parameter(f"bias_ih_l{k}").data
            memory = torch.rand(form.hidden) * math.log(form.memory_samples)
            bias[: form.hidden] = -memory
            bias[form.hidden : 2 * form.hidden] = memory
    return net


def _gru(form: CellSettings) -> GruNet:
    """As for the LSTM; the gate z of a GRU keeps what was: z = 1 - 1 / tau has the bias log(tau - 1)."""
    net = GruNet(form.hidden, form.layers)
    net.gru.get_parameter("weight_ih_l0").data.mul_(form.command_gain)
    if form.memory_samples:
        for k in range(form.layers):
            bias = net.gru.get_parameter(f"bias_ih_l{k}").data
            memory = torch.rand(form.hidden) * math.log(form.memory_samples)
            bias[form.hidden : 2 * form.hidden] = memory
    return net
