"""Simulation of the closed loop: one study, a sweep over many, one row of a sweep once more."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING

from hystmpc.trials.config import read_yaml
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.run_folder import require_resumable, require_vacant
from hystmpc.trials.types import Progress

from .inputs import Settings, allow_classes, changed, processes

if TYPE_CHECKING:
    from hystmpc.sim.config import SimulationConfig
    from hystmpc.sim.results import StudyResult
    from hystmpc.sim.sweep.run import ReproducedFigure, SweepOutcome


def simulate(
    config: Settings | SimulationConfig,
    out: Path | str | None = None,
    *,
    overrides: Iterable[str] = (),
    controllers: Mapping[str, Settings] | None = None,
    allow_python: bool = False,
    progress: Progress | None = None,
) -> StudyResult:
    """Run every controller of a study along every motion on a simulated device; Ctrl-C keeps the finished runs.

    Args:
        config: plant, model, motions and controllers: a YAML file, a mapping or the settings.
        out: a new or empty run folder for logs and report; nothing is written where left out.
        overrides: changes of a file or mapping, such as `plant.lag_s=0.1`.
        controllers: added under their names, each a YAML file or a mapping.
        allow_python: import classes that the file names as `python: MODULE:CLASS`; you trust it.
        progress: called with the steps done and their number.

    Raises:
        HystmpcError: if a setting is wrong or a model cannot be used.
        ConfigError: if `out` is not empty.
    """
    from hystmpc.sim.compare import compare
    from hystmpc.sim.config import SimulationConfig, load_simulation

    allow_classes(allow_python)
    changes = [*(_added(name, one) for name, one in (controllers or {}).items()), *overrides]
    if isinstance(config, Path | str):
        config = load_simulation(config, changes)
    elif isinstance(config, Mapping):
        config = SimulationConfig.parse(changed(config, changes))
    elif changes:
        raise ConfigError("simulate: --set does nothing with settings that are complete, expected a file or a mapping")
    if out is not None:
        require_vacant(out)
    return compare(config, out, progress)


def sweep(
    config: Path | str,
    out: Path | str,
    *,
    overrides: Iterable[str] = (),
    jobs: int | None = 1,
    cluster: str | None = None,
    allow_python: bool = False,
    progress: Progress | None = None,
) -> SweepOutcome:
    """Run many studies in one: a grid, draws and seeds; the same call goes on in the folder of a sweep.

    Args:
        config: a YAML file.
        out: a new or empty folder, or one of a sweep, whose rows are kept.
        overrides: changes of its settings, such as `count=200`.
        jobs: processes, None for one a core; with more than one a script needs `if __name__ == "__main__":`.
        cluster: Dask scheduler, `tcp://host:8786`; `local`: processes of this machine.
        allow_python: import classes that the file names as `python: MODULE:CLASS`; you trust it.
        progress: called with the runs done, their number and a note.

    Raises:
        HystmpcError: if a setting is wrong, or the folder holds something else.
    """
    from hystmpc.sim.jobs import backend_for
    from hystmpc.sim.sweep.run import run_sweep
    from hystmpc.sim.sweep.settings import load_sweep

    allow_classes(allow_python)
    workers = processes(jobs)
    settings = load_sweep(config, overrides)
    require_resumable(out)
    return run_sweep(settings, out, backend_for(workers, cluster, str(out)), progress, source=Path(config))


def reproduce(folder: Path | str, row: str, out: Path | str | None = None) -> tuple[ReproducedFigure, ...]:
    """Run one row of a sweep once more, from nothing but what its table says.

    Args:
        folder: of the sweep.
        row: its identity, or its first digits where no other begins with them.
        out: a new or empty run folder; nothing is written where left out.

    Returns:
        Every figure that does not depend on how fast the machine is: before, now, and whether they are equal.

    Raises:
        HystmpcError: if there is no such row, a model file has changed, or the run cannot be made.
    """
    from hystmpc.sim.sweep.run import reproduce as run_row

    if out is not None:
        require_vacant(out)
    return run_row(folder, row, out)


def _added(name: str, controller: Settings) -> str:
    """The override that puts a controller's settings into a study.

    Raises:
        ConfigError: if the name has a dot, or the file holds no controller.
    """
    if not name or "." in name:
        raise ConfigError(f"--controller {name}: expected NAME=FILE, a name without dots")
    data = read_yaml(controller) if isinstance(controller, Path | str) else controller
    if not isinstance(data, Mapping) or "kind" not in data:
        where = controller if isinstance(controller, Path | str) else f"--controller {name}"
        raise ConfigError(f"{where}: expected the settings of one controller, with the key 'kind'")
    return f"controllers.{name}={dumps(dict(data))}"
