"""How many numbers a processor's vectors hold, and how many rows of a product fit into its vector registers."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

from llvmlite import binding  # type: ignore[import-untyped]


@dataclass(frozen=True)
class VectorShape:
    """Sizes of the vector kernel.

    One row takes four registers, one a gate; beside the rows there must be room for the weights of four gates and the
    row's input: 4 rows + 5 registers of the 32 that AVX-512 has and of the 16 that AVX2 has. One row more, and the
    sums are spilled to memory in every turn of the inner loop.

    Attributes:
        lanes: float32 numbers in a vector.
        rows: rows of the batch whose sums are in registers.
    """

    lanes: int
    rows: int


AVX512 = VectorShape(lanes=16, rows=6)
AVX2 = VectorShape(lanes=8, rows=2)
SHAPES = {"avx512": AVX512, "avx2": AVX2}


def host_shape() -> VectorShape | None:
    """Sizes for this processor; None where it has no long vectors, or numba is told to compile for another."""
    if os.environ.get("NUMBA_CPU_NAME") or os.environ.get("NUMBA_CPU_FEATURES"):
        return None
    return shape_for(binding.get_host_cpu_features())


def shape_for(features: Mapping[str, bool]) -> VectorShape | None:
    """Sizes for a processor with these features, as LLVM calls them; None without AVX-512 and AVX2."""
    if features.get("avx512f"):
        return AVX512
    return AVX2 if features.get("avx2") and features.get("fma") else None
