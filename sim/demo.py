"""The demonstration: shipped models, a simulated tendon catheter, every controller."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from .compare import Progress, compare
from .config import SimulationConfig, load_simulation
from .results import StudyResult


def demo_config() -> SimulationConfig:
    """The study that `demo` runs; `sim/demo.yaml`."""
    return load_simulation(Path(str(files("hystmpc.sim").joinpath("demo.yaml"))))


def demo(out: Path | str | None = None, progress: Progress | None = None) -> StudyResult:
    """Track a point-to-point motion and a scan with every controller; see `compare`.

    Args:
        out: a new or empty folder for logs and report.html.
        progress: called with the steps done and their number.

    Raises:
        ConfigError: if `out` is not vacant.
        KeyboardInterrupt: if the user ends it before the first run is finished.
    """
    return compare(demo_config(), out, progress)
