"""Comparison of exported FMUs with the Python simulator: greatest difference of any angle, by simulator and version.

    python lab/benchmarks/exported_fmu.py [--case NAME]

fmpy simulates the FMU over a sinusoid and a point-to-point motion of S2, as in `tests/codegen/test_fmu.py`.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from kit import asked

from tests.codegen.importer import VERSIONS, greatest_difference, written
from tests.codegen.test_fmu import PLANES, PLANTS, device_of


def main() -> None:
    """Print one line a simulator, then the maximum over all."""
    chosen = asked(__doc__, case={"choices": [*PLANTS, *PLANES], "action": "append"}).case or (*PLANTS, *PLANES)
    worst = dict.fromkeys(VERSIONS, 0.0)
    for name in chosen:
        device, off = device_of(name), {}
        with tempfile.TemporaryDirectory() as folder:
            for version in VERSIONS:
                fmu = written(device, Path(folder) / f"device{version[0]}.fmu", version)
                off[version] = greatest_difference(fmu, device)
                worst[version] = max(worst[version], off[version])
        print(f"{name}: {', '.join(f'FMI {v} {value:.2g} deg' for v, value in off.items())}", flush=True)
    print(f"greatest: {', '.join(f'FMI {version} {value:.2g} deg' for version, value in worst.items())}")


if __name__ == "__main__":
    main()
