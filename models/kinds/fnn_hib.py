"""The feed-forward network with a history buffer as a kind of model."""

from __future__ import annotations

from typing import ClassVar, final

from .network_fit import NetworkKind


@final
class FnnHibKind(NetworkKind):
    """Two ReLU layers of 64 over the last 50 commands, S2 section III-B; see `FeedForwardNet`."""

    name: ClassVar[str] = "fnn_hib"
    title: ClassVar[str] = "FNN-HIB"
    presets: ClassVar[tuple[str, ...]] = ("best", "paper", "s1")
