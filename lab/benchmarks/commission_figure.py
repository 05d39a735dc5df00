"""The picture in the README: before and after a commissioning, from its folder.

Run: hystmpc commission examples/commission.yaml --out runs/commission (beside `hystmpc device
examples/bench_device.yaml`), then
python lab/benchmarks/commission_figure.py runs/commission docs/figures/commission.png
"""

from __future__ import annotations

import sys
from pathlib import Path

from hystmpc.commissioning.report import before_and_after
from hystmpc.commissioning.verify import load_tracks
from hystmpc.trials.config import read_yaml


def main() -> None:
    """Draw the references of the verification."""
    source, target = map(Path, sys.argv[1:3])
    figure = before_and_after(load_tracks(source / "7-verify"), read_yaml(source / "config.yaml")["command_unit"])
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=150)


if __name__ == "__main__":
    main()
