"""What a closed-loop study found, in memory and in its run folder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hystmpc.ctrl.config import LimitsSettings
from hystmpc.ctrl.limits import CommandLimits
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.run_folder import RunFolder

from .closed_loop import ClosedLoopRun
from .config import SimulationConfig
from .metrics import TrackingMetrics, tracking_metrics
from .run_log import run_from

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Result:
    """One controller along one motion: names, the limits that it had, the run and its metrics."""

    motion: str
    controller: str
    limits: CommandLimits
    run: ClosedLoopRun
    metrics: TrackingMetrics


@dataclass(frozen=True, eq=False)
class StudyResult:
    """All runs of a study.

    Attributes:
        config: the settings as they ran: files, limits and tuned gains.
        results: motion by motion, in the order of the settings; without those that were not reached; at least one.
        meta: versions, host, start and model hashes; empty where no folder was written.
    """

    config: SimulationConfig
    results: tuple[Result, ...]
    meta: Mapping[str, Any]

    @property
    def unit(self) -> str:
        """Unit of the command."""
        return self.results[0].run.unit

    def of_motion(self, motion: str) -> tuple[Result, ...]:
        """The runs along one motion."""
        return tuple(result for result in self.results if result.motion == motion)

    @property
    def motions(self) -> tuple[str, ...]:
        """Motions that were run, in order."""
        return tuple(dict.fromkeys(result.motion for result in self.results))

    @property
    def controllers(self) -> tuple[str, ...]:
        """Controllers that were run, in order."""
        return tuple(dict.fromkeys(result.controller for result in self.results))

    def plot(self, motion: str | None = None) -> Figure:
        """Angle and command of every controller along one motion, the first where left out."""
        from .figures import colours, tracking_figure  # matplotlib, which a run does without

        return tracking_figure(self.of_motion(motion or self.motions[0]), colours(self.controllers), self.unit)

    def _repr_html_(self) -> str:
        from hystmpc.trials.report import Plot, Report, Table

        columns = ("motion", "controller", "RMSE [deg]", "max abs [deg]", "hold error [deg]", "limit violations")
        rows = []
        for run in self.results:
            m = run.metrics
            rows.append((run.motion, run.controller, m.rmse_deg, m.max_abs_deg, m.hold_error_deg, m.limit_violations))
        return Report("Closed loop in simulation", (Table(columns, rows), Plot(self.plot()))).fragment()


def result_of(config: SimulationConfig, motion: str, controller: str, run: ClosedLoopRun) -> Result:
    """A run with its metrics under the limits that its controller had."""
    limits = limits_of(config, controller)
    return Result(motion, controller, limits, run, tracking_metrics(run, limits))


def limits_of(config: SimulationConfig, controller: str) -> CommandLimits:
    """The device's limits, or the narrower ones of the controller.

    Raises:
        ConfigError: if the settings are not those of a run and leave the limits out.
    """
    limits: LimitsSettings | None = config.controllers[controller].limits or config.limits
    if limits is None:
        raise ConfigError("limits: got none, expected those of a run's resolved settings")
    return CommandLimits(limits.lower, limits.upper, limits.rate_per_s)


def load_results(path: Path | str) -> StudyResult:
    """Read the run folder of a study, or of one run of a study; nothing outside the folder is opened.

    Raises:
        LogError: if it holds no run of a simulation.
        ConfigError: if its settings are not those of a simulation.
    """
    folder = RunFolder.open(path)
    config = SimulationConfig.parse(folder.config(), str(folder.path / "config.yaml"))
    if config.limits is None:
        raise ConfigError(f"{folder.path / 'config.yaml'}: limits: got none, expected those that held")
    results = tuple(
        result_of(config, motion, controller, run_from(run.log(), config.limits.lower, str(run.path / "log.csv")))
        for motion, controller, run in _runs(folder, config)
    )
    if not results:
        raise LogError(f"{folder.path}: no log.csv in it, expected one for each motion and controller")
    return StudyResult(config, results, folder.meta)


def _runs(folder: RunFolder, config: SimulationConfig) -> Iterator[tuple[str, str, RunFolder]]:
    """Motion, controller and folder of every run that was finished."""
    for motion in config.motions:
        for controller in config.controllers:
            below = folder.path / motion / controller
            if (below / "log.csv").is_file():
                yield motion, controller, RunFolder.open(below)
            elif (folder.path / "log.csv").is_file():  # the folder of a single run
                yield motion, controller, folder
