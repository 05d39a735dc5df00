"""Laboratory of hystmpc: the studies that verify the product, and the competing models of the papers.

It is a separate distribution, `hystmpc-lab`. It adds its verbs (`study`, `gap`, `faults`, `bench`, `data`) and its
kinds of model to those of hystmpc; hystmpc itself does not depend on it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hystmpc.trials import lazily

if TYPE_CHECKING:
    from .datasets import make_dataset, read_dataset, write_dataset
    from .devices.rod import RodParameters, simulate_rod
    from .reconstruction.geometry import ReconstructionSettings
    from .reconstruction.protocol import Protocol, record_scans
    from .reconstruction.reconstruct import reconstruct

__all__ = [
    "Protocol",
    "ReconstructionSettings",
    "RodParameters",
    "make_dataset",
    "read_dataset",
    "reconstruct",
    "record_scans",
    "simulate_rod",
    "write_dataset",
]

if not TYPE_CHECKING:
    __getattr__ = lazily(
        __name__,
        ("hystmpc_lab.datasets", "make_dataset read_dataset write_dataset"),
        ("hystmpc_lab.devices.rod", "RodParameters simulate_rod"),
        ("hystmpc_lab.reconstruction.protocol", "Protocol record_scans"),
        ("hystmpc_lab.reconstruction.reconstruct", "reconstruct"),
        ("hystmpc_lab.reconstruction.geometry", "ReconstructionSettings"),
    )
