"""The real-time control loop at a bench: transports, safety, preparation, safe stop, recording, live view."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hystmpc.trials import lazily

if TYPE_CHECKING:
    from .transports.transport import Reading, Transport

__all__ = ["Reading", "Transport"]

if not TYPE_CHECKING:
    __getattr__ = lazily(__name__, ("hystmpc.rig.transports.transport", "Reading Transport"))
