"""Contract tests that a lab runs against its own classes, simulated devices for them, and templates to begin with."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hystmpc.trials import lazily

if TYPE_CHECKING:
    from .effect import EffectContract
    from .law import ControllerContract
    from .line_device import LineDevice
    from .loop import LoopContract
    from .model import KindContract, ModelContract
    from .plant import PlantContract
    from .wire import Connected, TransportContract

__all__ = [
    "Connected",
    "ControllerContract",
    "EffectContract",
    "KindContract",
    "LineDevice",
    "LoopContract",
    "ModelContract",
    "PlantContract",
    "TransportContract",
]

if not TYPE_CHECKING:
    __getattr__ = lazily(
        __name__,
        ("hystmpc.testing.effect", "EffectContract"),
        ("hystmpc.testing.law", "ControllerContract"),
        ("hystmpc.testing.line_device", "LineDevice"),
        ("hystmpc.testing.loop", "LoopContract"),
        ("hystmpc.testing.model", "KindContract ModelContract"),
        ("hystmpc.testing.plant", "PlantContract"),
        ("hystmpc.testing.wire", "Connected TransportContract"),
    )
