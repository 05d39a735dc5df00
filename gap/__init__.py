"""The sim-to-real diagnosis: where a simulator departs from its device, which effect causes it, how far it shrinks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .diagnosis import Diagnosis
    from .procedure import diagnose

__all__ = ["Diagnosis", "diagnose"]


def __getattr__(name: str) -> Any:
    """Open what is asked for: the engine compiles kernels, and readers of a diagnosis need none of it."""
    if name == "diagnose":
        from .procedure import diagnose

        return diagnose
    if name == "Diagnosis":
        from .diagnosis import Diagnosis

        return Diagnosis
    raise AttributeError(name)
