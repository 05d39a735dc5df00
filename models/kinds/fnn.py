"""The feed-forward network of the present command as a kind of model."""

from __future__ import annotations

from typing import ClassVar, final

from .network_fit import NetworkKind


@final
class FnnKind(NetworkKind):
    """Two ReLU layers of 64 over the present command alone, S2 section III-B; see `FeedForwardNet`."""

    name: ClassVar[str] = "fnn"
    title: ClassVar[str] = "FNN"
    presets: ClassVar[tuple[str, ...]] = ("best", "paper", "s1")
    recurrent: ClassVar[bool] = False
