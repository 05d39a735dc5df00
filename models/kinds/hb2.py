"""The parallel hybrid of backlash and LSTM as a kind of model."""

from __future__ import annotations

from typing import ClassVar, final

from .network_fit import NetworkKind


@final
class Hb2Kind(NetworkKind):
    """A backlash fitted beforehand and an LSTM that adds what it leaves, S2 eq. (7); see `ParallelNet`."""

    name: ClassVar[str] = "hb2"
    title: ClassVar[str] = "HB2"
    presets: ClassVar[tuple[str, ...]] = ("best", "paper")
