"""Results of a closed-loop study: metrics, log columns of the runs, and run folders read back."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hystmpc.ctrl.command import CommandLimits, LimitsSettings
from hystmpc.ctrl.loop import LoopLog
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings, SamplingMpcSettings
from hystmpc.trials.brief import brief, in_brief
from hystmpc.trials.clocks import runs
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.from_outside import only_reads
from hystmpc.trials.layouts import CANONICAL
from hystmpc.trials.run_folder import RunFolder
from hystmpc.trials.types import Vec

from .config import SimulationConfig
from .study import ClosedLoopRun
from .two_axes.columns import Column, apart, together
from .two_axes.config import AnyStudyConfig, TwoAxisSimulationConfig, parse_study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PREDICTIVE = (LinearisedMpcSettings, SamplingMpcSettings)
HOLD_S = 0.5
_STILL_DEG = 1e-9
_ROUNDING = 1e-9  # of the command's range: a limit that is met exactly is not violated
Limits = CommandLimits | tuple[CommandLimits, ...]
"""Hard limits of the command, or of every command of two axes."""
_STAGE = "stage_"
_LOOP = {
    "time_s": "time_s",
    "angle_deg": "measured_deg",
    "reference_deg": "reference_deg",
    "predicted_deg": "predicted_deg",
    "disturbance_deg": "disturbance_deg",
}
_TRUE = "true_angle_deg"
_COUNTED = "counted"  # 0 in the samples of an approach
_REST = "held_before"  # the command before the first sample


@dataclass(frozen=True)
class TrackingMetrics:
    """Metrics of one closed-loop run; of two axes errors are lengths in the plane of both angles.

    Errors are true angle minus reference; a hold is a reference at rest for 0.5 s or longer. Errors and holds of an
    approach do not count; commands and times do. Figures of holds are NaN without one.
    """

    rmse_deg: float
    max_abs_deg: float  # greatest absolute error [deg]
    hold_error_deg: float  # mean absolute error over the last halves of all holds [deg]
    hold_command_range: float  # greatest range of the command over the last half of a hold [cmd]
    command_travel: float  # sum of all command changes [cmd]
    limit_violations: int  # samples with a command, or its change, beyond the limits; anything but 0 is a fault
    step_mean_s: float  # execution time of a controller step [s]
    __repr__ = brief
    step_p99_s: float
    ladder: Mapping[str, int]  # samples by source of the command


def tracking_metrics(run: ClosedLoopRun, limits: Limits) -> TrackingMetrics:
    """Compute the metrics of one run under the limits of its controller."""
    size, command = distances(run.counted_deg), run.log.command[run.first :]
    halves = [(a + (b - a) // 2, b) for a, b in holds(run.log.reference_deg[run.first :], run.dt)]
    still = np.concatenate([size[a:b] for a, b in halves]) if halves else np.array([math.nan])
    step, changes = run.log.step_s, np.diff(run.log.command, axis=0, prepend=np.asarray(run.rest_command)[None])
    return TrackingMetrics(
        rmse_deg=math.sqrt(float(np.mean(size**2))),
        max_abs_deg=float(np.max(size)),
        hold_error_deg=float(np.mean(still)),
        hold_command_range=max((float(np.max(np.ptp(command[a:b], axis=0))) for a, b in halves), default=math.nan),
        command_travel=float(np.sum(np.abs(changes))),
        limit_violations=violations(run.log.command, run.rest_command, limits, run.dt),
        step_mean_s=float(np.mean(step)),
        step_p99_s=float(np.quantile(step, 0.99)),
        ladder=dict(Counter(run.log.source)),
    )


def distances(error_deg: Vec) -> Vec:
    """Sizes (N,) of errors (N,), or of those of both angles (N, 2)."""
    return np.abs(error_deg) if error_deg.ndim == 1 else np.hypot(*error_deg.T)


def holds(reference_deg: Vec, dt_s: float) -> list[tuple[int, int]]:
    """Return start and stop (exclusive) of every stretch of at least 0.5 s over which the reference rests."""
    starts, stops = runs(distances(np.diff(reference_deg, axis=0)) <= _STILL_DEG)
    pairs = zip(starts.tolist(), stops.tolist(), strict=True)
    return [(a, b + 1) for a, b in pairs if (b - a) * dt_s >= HOLD_S - _ROUNDING]


def violations(command: Vec, before: float | Vec, limits: Limits, dt_s: float) -> int:
    """Number of samples with a command, or its change from the one before, that is not finite or beyond the limits."""
    beyond = np.zeros(len(command), dtype=bool)
    each = limits if isinstance(limits, tuple) else (limits,)
    for u, start, one in zip(np.reshape(command, (len(command), -1)).T, np.ravel(before), each, strict=True):
        slack = _ROUNDING * (one.upper - one.lower)
        inside = (u >= one.lower - slack) & (u <= one.upper + slack)
        slow = np.abs(np.diff(u, prepend=start)) <= one.rate * dt_s + slack
        beyond |= ~(inside & slow)
    return int(np.sum(beyond))


def log_columns(run: ClosedLoopRun) -> dict[str, Sequence[str] | Vec]:
    """Return the columns (N,) of `log.csv`; every angle belongs to the end of its sample, the command to all of it.

    Of two axes, each axis and command has its own: `angle_x_deg`, `command_x_mm`; see `hystmpc.sim.two_axes.columns`.
    """
    log, count = run.log, len(run.true_deg)
    numbers = {column: getattr(log, field) for column, field in _LOOP.items()}
    stages = {f"{_STAGE}{name.replace(' ', '_')}_s": seconds for name, seconds in log.stage_s.items()}
    command = {f"command_{run.unit}": log.command}
    counted = {_COUNTED: (np.arange(count) >= run.first).astype(np.float64)}
    rest = {_REST: np.full((count, *np.shape(run.rest_command)), run.rest_command)}
    texts = {"source": log.source, "status": log.status}
    return apart({**command, **numbers, _TRUE: run.true_deg, **counted, **rest, **stages, **texts})


def run_from(columns: Mapping[str, Column], lowest: float, where: str) -> ClosedLoopRun:
    """Return the run of a log.

    Args:
        lowest: rest command of the plant, for logs of older versions without it.

    Raises:
        LogError: if a column is missing.
    """
    columns, wanted = together(columns), (*_LOOP, _TRUE, "source", "status")
    gone = CANONICAL.missing(list(columns)) + [name for name in wanted if name not in columns]
    if gone:
        raise LogError(f"{where}: lacks {', '.join(gone)}, expected the log of a simulation; got {', '.join(columns)}")
    command = CANONICAL.command_column(list(columns))
    numbers = {field: _numbers(columns[column]) for column, field in _LOOP.items()}
    stages = {
        name.removeprefix(_STAGE).removesuffix("_s").replace("_", " "): _numbers(values)
        for name, values in columns.items()
        if name.startswith(_STAGE)
    }
    source, status = (tuple(str(text) for text in columns[name]) for name in ("source", "status"))
    log = LoopLog(
        **numbers, command=_numbers(columns[command]), source=source, status=status, stage_s=stages, interrupted=False
    )
    # The first sample ends one sample time after the start.
    first = int(np.argmax(_numbers(columns[_COUNTED]))) if _COUNTED in columns else 0  # logs of older versions
    true, dt = _numbers(columns[_TRUE]), float(log.time_s[0])
    first_rest = _numbers(columns[_REST])[0] if _REST in columns else lowest
    rest = float(first_rest) if np.ndim(first_rest) == 0 else first_rest
    return ClosedLoopRun(log, true, rest, dt, CANONICAL.command[command], first)


def _numbers(column: Column) -> Vec:
    return np.asarray(column, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Result:
    """Result of one controller along one motion: names, limits, run and metrics."""

    motion: str
    controller: str
    limits: Limits
    run: ClosedLoopRun
    metrics: TrackingMetrics

    def __repr__(self) -> str:
        m = self.metrics
        errors = f"RMSE {m.rmse_deg:.4g} deg, at most {m.max_abs_deg:.4g} deg"
        return in_brief(self, f"{self.controller} along {self.motion}: {errors}")


@dataclass(frozen=True, eq=False)
class StudyResult:
    """Results of all runs of a study.

    Attributes:
        config: the settings as they ran: files, limits and tuned gains.
        results: finished runs, motion by motion, in the order of the settings; at least one.
        warnings: one sentence for each motion beyond the reach of the model.
    """

    config: AnyStudyConfig
    results: tuple[Result, ...]
    meta: Mapping[str, Any]
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        runs = (f"{run.controller} {run.metrics.rmse_deg:.4g} deg" for run in self.results)
        return in_brief(self, f"{len(self.results)} runs, RMSE {', '.join(runs)}")

    @property
    def unit(self) -> str:
        """Unit of the command."""
        return self.results[0].run.unit

    def of_motion(self, motion: str) -> tuple[Result, ...]:
        """Results along one motion."""
        return tuple(result for result in self.results if result.motion == motion)

    @property
    def motions(self) -> tuple[str, ...]:
        """Names of the motions that were run, in order."""
        return tuple(dict.fromkeys(result.motion for result in self.results))

    @property
    def controllers(self) -> tuple[str, ...]:
        """Names of the controllers that were run, in order."""
        return tuple(dict.fromkeys(result.controller for result in self.results))

    def plot(self, motion: str | None = None) -> Figure:
        """Draw angle and command of every controller along one motion, or the tip in the plane of two axes.

        Args:
            motion: the first one where left out.
        """
        results, look = self.of_motion(motion or self.motions[0]), looks(self.controllers)
        if results[0].run.true_deg.ndim > 1:
            return tip_figure(results, look)
        return controllers_figure(results, look, self.unit)

    def _repr_html_(self) -> str:
        from hystmpc.trials.report import Plot, Report, Table

        columns = ("motion", "controller", "RMSE [deg]", "max abs [deg]", "hold error [deg]", "limit violations")
        scores = [(run.motion, run.controller, run.metrics) for run in self.results]
        rows = [(*names, m.rmse_deg, m.max_abs_deg, m.hold_error_deg, m.limit_violations) for *names, m in scores]
        return Report("Closed loop in simulation", (Table(columns, rows), Plot(self.plot()))).fragment()


def best_figures(runs: Sequence[Result]) -> frozenset[tuple[str, str]]:
    """Return controller and metric for the least RMSE, greatest error and hold error, with ties to 0.001 deg."""
    names = ("rmse_deg", "max_abs_deg", "hold_error_deg") if len(runs) > 1 else ()
    figures = {(run.controller, name): round(getattr(run.metrics, name), 3) for run in runs for name in names}
    least = {name: min(value for (_, named), value in figures.items() if named == name) for name in names}
    return frozenset(key for key, value in figures.items() if value == least[key[1]])


def conclusion(result: StudyResult) -> str:
    """Return a sentence that compares the best controllers with and without prediction; empty with fewer than two."""
    errors: dict[str, float] = {}
    for name in result.controllers:
        rmse_deg = [run.metrics.rmse_deg for run in result.results if run.controller == name]
        if len(rmse_deg) == len(result.motions):
            errors[name] = math.sqrt(sum(value**2 for value in rmse_deg) / len(rmse_deg))
    if len(errors) < 2:
        return ""
    best = min(errors, key=errors.__getitem__)
    motions = "the motion" if len(result.motions) == 1 else f"the {len(result.motions)} motions"
    said = f"{best} tracks best: {errors[best]:.3g} deg RMS over {motions}"
    predicts = {name: isinstance(s, _PREDICTIVE) for name, s in result.config.controllers.items()}
    rivals = [name for name in errors if predicts[name] != predicts[best]]
    if not rivals:
        return f"{said}."
    rival = min(rivals, key=errors.__getitem__)
    sort = "with prediction" if predicts[rival] else "without prediction"
    percent = 100 * (1 - errors[best] / errors[rival])
    return f"{said}, {percent:.0f} % less than the best {sort} ({rival}, {errors[rival]:.3g} deg)."


def approach_sentence(result: StudyResult) -> str:
    """Return a sentence on the approaches, which do not count; empty without one."""
    led = {run.motion: run.run.first * run.run.dt for run in result.results if run.run.first}
    times = ", ".join(f"{seconds:.1f} s of {motion}" for motion, seconds in led.items())
    return f"The first {times} lead from the rest to the start of the reference and do not count." if led else ""


def colours(controllers: Sequence[str]) -> dict[str, str]:
    """Return one colour for each controller, the same in every figure of a study."""
    from hystmpc.trials.report import PALETTE  # matplotlib, which a run does not need

    return {name: PALETTE[k % (len(PALETTE) - 1)] for k, name in enumerate(controllers)}


def looks(controllers: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return colour and dashes of each controller, so that overlapping lines can be distinguished, also in grey."""
    from hystmpc.trials.report import DASHES

    colour = colours(controllers)
    return {name: {"color": colour[name], "linestyle": DASHES[k % len(DASHES)]} for k, name in enumerate(controllers)}


def controllers_figure(results: Sequence[Result], look: Mapping[str, Mapping[str, Any]], unit: str) -> Figure:
    """Draw angle and command of each controller over time along one motion, with reference and command limits."""
    from hystmpc.trials.figures import TrackedLine, TrackedMotion, tracking_figure

    lines = []
    for result in results:
        run, style = result.run, {**look[result.controller], "linewidth": 1.0, "label": result.controller}
        lines.append(TrackedLine(run.log.time_s, run.true_deg, run.log.command, style))
    run = results[0].run
    motion = TrackedMotion(run.log.time_s, run.log.reference_deg, lines, approach_s=run.first * run.dt)
    each = [result.limits for result in results if isinstance(result.limits, CommandLimits)]
    limits = sorted({edge for one in each for edge in (one.lower, one.upper)})
    return tracking_figure([motion], f"command [{unit}]", height=5.0, limits=limits, held=True)


def tip_figure(results: Sequence[Result], look: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw the tip of each controller in the plane of both angles, over the reference; the approach is left out."""
    from hystmpc.trials.figures import REFERENCE_LOOK, LoopPanel, loop_figure

    panels = []
    for result in results:
        run, style = result.run, {"color": look[result.controller]["color"], "linewidth": 1.0}
        wanted, tip = run.log.reference_deg[run.first :].T, run.true_deg[run.first :].T
        title = f"{result.controller}: {result.metrics.rmse_deg:.3g} deg"
        panels.append(LoopPanel(title, [(*wanted, REFERENCE_LOOK), (*tip, style)]))
    return loop_figure(panels, "deg", "deg", ("angle x [deg]", "angle y [deg]"))


def result_of(config: AnyStudyConfig, motion: str, controller: str, run: ClosedLoopRun) -> Result:
    """Return a run with its metrics under the limits of its controller."""
    limits = limits_of(config, controller)
    return Result(motion, controller, limits, run, tracking_metrics(run, limits))


def limits_of(config: AnyStudyConfig, controller: str) -> Limits:
    """Return the limits of the device, or the narrower ones of the controller.

    Raises:
        ConfigError: if the settings leave the limits out.
    """
    if isinstance(config, TwoAxisSimulationConfig):
        return config.command_limits()
    limits: LimitsSettings | None = config.controllers[controller].resolved().limits or config.limits
    if limits is None:
        raise ConfigError("limits: got none, expected those of a run's resolved settings")
    return CommandLimits(limits.lower, limits.upper, limits.rate_per_s)


@only_reads()
def load_results(path: Path | str) -> StudyResult:
    """Read the results in the run folder of a study or of one run; no file outside the folder is opened.

    Raises:
        LogError: if it holds no run of a simulation.
        ConfigError: if its settings are not those of a simulation.
    """
    folder = RunFolder.open(path)
    where = str(folder.path / "config.yaml")
    config = parse_study(folder.config(), where, folder.path)
    if config.limits is None:
        raise ConfigError(f"{where}: limits: got none, expected those that held")
    lowest = config.limits.lower if isinstance(config, SimulationConfig) else 0.0
    results = tuple(
        result_of(config, motion, controller, run_from(run.log(), lowest, str(run.path / "log.csv")))
        for motion, controller, run in _runs(folder, config)
    )
    if not results:
        raise LogError(f"{folder.path}: no log.csv in it, expected one for each motion and controller")
    return StudyResult(config, results, folder.meta)


def _runs(folder: RunFolder, config: AnyStudyConfig) -> Iterator[tuple[str, str, RunFolder]]:
    for motion in config.motions:
        for controller in config.controllers:
            below = folder.path / motion / controller
            if (below / "log.csv").is_file():
                yield motion, controller, RunFolder.open(below)
            elif (folder.path / "log.csv").is_file():  # the folder of a single run
                yield motion, controller, folder
