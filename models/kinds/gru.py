"""The stacked GRU as a kind of model."""

from __future__ import annotations

from typing import ClassVar, final

from .network_fit import NetworkKind


@final
class GruKind(NetworkKind):
    """Two layers of 64 units, S2 section III-B; see `GruNet`."""

    name: ClassVar[str] = "gru"
    title: ClassVar[str] = "GRU"
    presets: ClassVar[tuple[str, ...]] = ("best", "paper", "s1")
