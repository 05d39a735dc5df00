"""The exported C beside the Python controller: greatest difference of the commands, step times, memory.

    python benchmarks/exported_c.py [--steps 100000] [--case NAME] [--float32]

Both run a closed loop on a device of their own with noise, sensor faults and stops, as in `tests/codegen/`. The C is
compiled as `realtime.backend: c` compiles it (`codegen.build`), and called through ctypes, whose call is part of its
time. Times are processor time.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hystmpc.codegen import export_controller
from hystmpc.codegen.build import FLAGS
from tests.codegen.compiled import EXAMPLES, Library
from tests.codegen.loops import compare
from tests.codegen.networks import small_network
from tests.codegen.test_commands import CASES, PLAIN, tip

GRU: dict[str, dict[str, Any]] = {"gru": dict(PLAIN), "gru-that-learns": {}}


@cache
def _file() -> str:
    """A GRU with two layers of 64, which stays until the end."""
    return small_network("gru", 64, 2, Path(tempfile.mkdtemp()))


def _gru(controller: dict[str, Any]) -> tuple[dict[str, Any], float]:
    return tip(_file(), **controller), 0.0


def main() -> None:
    """One line a case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--case", choices=[*CASES, *GRU], action="append")
    parser.add_argument("--float32", action="store_true")
    given = parser.parse_args()
    for name in given.case or [*CASES, *GRU]:
        settings, lag_s = CASES[name] if name in CASES else _gru(GRU[name])
        export = export_controller(settings, single=given.float32, folder=EXAMPLES)
        with tempfile.TemporaryDirectory() as folder:
            found = compare(settings, Library(export, Path(folder), given.float32, FLAGS), given.steps, lag_s)
        off = np.abs(found.python - found.c)
        per_step = 1e6 / given.steps
        print(
            f"{name}: {given.steps} steps, difference up to {found.greatest:.2g} mm, "
            f"99 % within {np.quantile(off, 0.99):.2g} mm, median {np.median(off):.2g} mm, "
            f"{int(np.sum(off > 1e-6))} steps over 1e-6 mm; Python {found.python_s * per_step:.0f} us, C "
            f"{found.c_s * per_step:.0f} us a step, ratio {found.python_s / found.c_s:.1f}; "
            f"{export.memory_bytes} bytes, {export.remembered_bytes} remembered; {dict(found.sources)}",
            flush=True,
        )


if __name__ == "__main__":
    main()
