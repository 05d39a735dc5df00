"""Studies on top of everything: the papers, reconstruction, control, the blind check, performance and faults."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hystmpc.trials import lazily

if TYPE_CHECKING:
    from .reconstruction.protocol import Protocol, record_scans
    from .reconstruction.reconstruct import reconstruct
    from .reconstruction.settings import ReconstructionSettings

__all__ = ["Protocol", "ReconstructionSettings", "reconstruct", "record_scans"]

if not TYPE_CHECKING:
    __getattr__ = lazily(
        __name__,
        ("hystmpc.studies.reconstruction.protocol", "Protocol record_scans"),
        ("hystmpc.studies.reconstruction.reconstruct", "reconstruct"),
        ("hystmpc.studies.reconstruction.settings", "ReconstructionSettings"),
    )
