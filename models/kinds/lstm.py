"""The stacked LSTM as a kind of model."""

from __future__ import annotations

from typing import ClassVar, final

from .network_fit import NetworkKind


@final
class LstmKind(NetworkKind):
    """Two layers of 64 cells, S1 eq. (1) and S2 section III-B; see `LstmWeights`."""

    name: ClassVar[str] = "lstm"
    title: ClassVar[str] = "LSTM"
    presets: ClassVar[tuple[str, ...]] = ("best", "kernel", "paper", "s1")
