"""Contract tests that a lab runs against its own classes, simulated devices for them, and templates to begin with."""

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
    _HOMES = (
        ("hystmpc.testing.effect", "EffectContract"),
        ("hystmpc.testing.law", "ControllerContract"),
        ("hystmpc.testing.loop", "LoopContract"),
        ("hystmpc.testing.model", "KindContract ModelContract PlantContract"),
        ("hystmpc.testing.wire", "Connected LineDevice TransportContract"),
    )
    __all__ = [name for _, names in _HOMES for name in names.split()]
    __getattr__ = lazily(__name__, *_HOMES)
