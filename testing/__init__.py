"""Contract tests for external classes, simulated devices for these tests, and templates of classes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hystmpc.trials import lazily

if TYPE_CHECKING:
    from .effect import EffectContract as EffectContract
    from .law import ControllerContract as ControllerContract
    from .loop import LoopContract as LoopContract
    from .model import KindContract as KindContract
    from .model import ModelContract as ModelContract
    from .model import PlantContract as PlantContract
    from .wire import Connected as Connected
    from .wire import LineDevice as LineDevice
    from .wire import TransportContract as TransportContract

if not TYPE_CHECKING:
    __getattr__ = lazily(
        __name__,
        ("hystmpc.testing.effect", "EffectContract"),
        ("hystmpc.testing.law", "ControllerContract"),
        ("hystmpc.testing.loop", "LoopContract"),
        ("hystmpc.testing.model", "KindContract ModelContract PlantContract"),
        ("hystmpc.testing.wire", "Connected LineDevice TransportContract"),
    )
    __all__ = __getattr__.names
