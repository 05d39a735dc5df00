"""The serial hybrid of LSTM and backlash as a kind of model."""

from __future__ import annotations

from typing import ClassVar, final

from .network_fit import NetworkKind


@final
class Hb1Kind(NetworkKind):
    """An LSTM that gives the four parameters of a backlash at every sample, S2 eq. (6); see `SerialNet`."""

    name: ClassVar[str] = "hb1"
    title: ClassVar[str] = "HB1"
    presets: ClassVar[tuple[str, ...]] = ("best", "paper", "paper-batch-4")
