"""Tasks of the closed loop: a controller, a simulated study, a sweep of studies, and a search of settings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hystmpc.trials.config import read_yaml
from hystmpc.trials.errors import ConfigError, ControllerError
from hystmpc.trials.run_folder import require_resumable, require_vacant
from hystmpc.trials.types import Progress

from .inputs import Model, Settings, allow_classes, opened, processes, settings_of

if TYPE_CHECKING:
    from hystmpc.ctrl.command import CommandLimits
    from hystmpc.ctrl.config import AnyControllerSettings
    from hystmpc.ctrl.guarded import GuardedController
    from hystmpc.sim.config import SimulationConfig
    from hystmpc.sim.results import StudyResult
    from hystmpc.sim.sweep.run import ReproducedFigure, SweepOutcome
    from hystmpc.sim.tuning.objective import Tuning
    from hystmpc.sim.two_axes.config import TwoAxisSimulationConfig


def simulate(
    config: Settings | SimulationConfig | TwoAxisSimulationConfig,
    out: Path | str | None = None,
    *,
    overrides: Iterable[str] = (),
    controllers: Mapping[str, Settings] | None = None,
    allow_python: bool = False,
    progress: Progress | None = None,
) -> StudyResult:
    """Run every controller of a study along every motion on a simulated device; Ctrl-C keeps the finished runs.

    A model of two axes has motions in the plane of both angles.

    Args:
        config: study of plant, model, motions and controllers: a YAML file, a mapping or the settings.
        out: run folder for logs and report, new or empty, or that of a sweep to go on; without it nothing is written.
        overrides: change a setting of the file: KEY.KEY=VALUE.
        controllers: added under their names, each a YAML file or a mapping.
        allow_python: import classes that the file names as python: MODULE:CLASS; you trust it.
        progress: called with the steps done and their number.

    Raises:
        HystmpcError: if a setting is wrong or a model cannot be used.
        ConfigError: if `out` is not empty.
    """
    from hystmpc.sim.compare import compare
    from hystmpc.sim.config import SimulationConfig, load_simulation
    from hystmpc.sim.two_axes.config import (
        TwoAxisSimulationConfig,
        file_of_two_axes,
        load_two_axis_simulation,
        says_two_axes,
    )

    allow_classes(allow_python)
    changes = [*(_added(name, one) for name, one in (controllers or {}).items()), *overrides]
    if isinstance(config, Path | str):
        config = (
            load_two_axis_simulation(config, changes) if file_of_two_axes(config) else load_simulation(config, changes)
        )
    elif isinstance(config, Mapping):
        if says_two_axes(config, Path()):
            config = settings_of(TwoAxisSimulationConfig, config, changes)
        else:
            config = settings_of(SimulationConfig, config, changes)
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
    """Simulate many studies: a grid, draws and seeds; the same call continues an unfinished sweep.

    Args:
        config: a YAML file.
        out: a new or empty folder, or one of a sweep, whose rows are kept.
        overrides: change a setting of the file: KEY.KEY=VALUE.
        jobs: processes of one thread each; None for one a core. A script with more than one needs
            `if __name__ == "__main__":`.
        cluster: Dask scheduler, tcp://host:8786; `local`: processes of this machine.
        allow_python: import classes that the file names as python: MODULE:CLASS; you trust it.
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
    """Simulate one row of a sweep a second time, from the settings in its table.

    Args:
        folder: of the sweep.
        row: its identity, or its first digits if unique.
        out: a new or empty run folder; nothing is written if left out.

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
    if not name or "." in name:
        raise ConfigError(f"--controller {name}: expected NAME=FILE, a name without dots")
    data = read_yaml(controller) if isinstance(controller, Path | str) else controller
    if not isinstance(data, Mapping) or "kind" not in data:
        where = controller if isinstance(controller, Path | str) else f"--controller {name}"
        raise ConfigError(f"{where}: expected the settings of one controller, with the key 'kind'")
    return f"controllers.{name}={dumps(dict(data))}"


def tune(
    config: Settings,
    out: Path | str,
    *,
    overrides: Iterable[str] = (),
    jobs: int | None = 1,
    cluster: str | None = None,
    storage: str | None = None,
    allow_python: bool = False,
    progress: Progress | None = None,
) -> Tuning:
    """Search the settings of a controller on simulated plants with drawn effects; verify them on other plants.

    Args:
        config: a tuning of study, ranges and plants: a YAML file or a mapping.
        out: run folder; an unfinished tuning in it goes on.
        overrides: change a setting of the file: KEY.KEY=VALUE.
        jobs: processes of one thread each; None for one a core. A script with more than one needs
            `if __name__ == "__main__":`.
        cluster: Dask scheduler, tcp://host:8786, with a shared storage; `local`: processes of this machine.
        storage: where trials are kept, such as postgresql://host/db, which several machines share; a file in `out`
            where left out.
        allow_python: import classes that the file names as python: MODULE:CLASS; you trust it.
        progress: called with trials done, their number and a note.

    Raises:
        HystmpcError: if a setting is wrong, the folder holds something else, or no trial came to an end.
    """
    from hystmpc.sim.jobs import backend_for
    from hystmpc.sim.tuning.run import run_tuning
    from hystmpc.sim.tuning.settings import TuneSettings, complete

    allow_classes(allow_python)
    workers = processes(jobs)
    place = Path("mapping") if isinstance(config, Mapping) else Path(config)
    settings = complete(settings_of(TuneSettings, config, overrides), place)
    require_resumable(out)
    return run_tuning(settings, out, backend_for(workers, cluster, str(out)), storage, progress)


def build_controller(
    controller: str | Mapping[str, Any] | AnyControllerSettings,
    model: Model,
    *,
    inverse: Path | str | None = None,
    limits: CommandLimits | None = None,
    actuator_lag_s: float = 0.0,
) -> GuardedController:
    """Build a controller of the tip angle, with methods `init` and `step` and explicit state.

    Args:
        controller: `inverse`, `pid`, `inverse_pid`, `linearised_mpc` or `sampling_mpc`; or its settings.
        model: that it predicts with: a fit, simulator, opened model or file.
        inverse: file of the map to invert in place of the model, for a network.
        limits: hard limits of command and rate; those of the model if left out.
        actuator_lag_s: first-order lag of the command that the model does not contain [s].

    Raises:
        ConfigError: on an unknown controller or setting.
        ControllerError: if the settings contradict each other, or the limits go beyond the model's.
        ModelError: if a model cannot be used.
        FitError: if a network has no `inverse` and none can be fitted.
    """
    from hystmpc.ctrl.build import build_controller as build
    from hystmpc.ctrl.build import pair_for
    from hystmpc.ctrl.command import limits_of_model
    from hystmpc.ctrl.config import parse_controller
    from hystmpc.models.prediction.build import controller_model

    if isinstance(controller, str):
        controller = {"kind": controller}
    settings = parse_controller(dict(controller), "controller") if isinstance(controller, Mapping) else controller
    runs = opened(model, "conditioned")
    made_for = limits_of_model(runs.metadata)
    if limits is not None and not made_for.contains(limits):
        raise ControllerError(f"limits: got {limits}, expected them within what the model was made for, {made_for}")
    pair = pair_for(settings, controller_model(runs, inverse, actuator_lag_s))
    return build(settings, *pair, limits or made_for)
