"""Comparison of all controllers of a study along all motions: run folders, report, and the demonstration study."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.feedback import InversePidControllerSettings, PidControllerSettings
from hystmpc.ctrl.linear.report import loops_of
from hystmpc.models.load import load_model, model_path
from hystmpc.trials.config import dump_yaml
from hystmpc.trials.errors import ModelError
from hystmpc.trials.figures import LIMIT_LOOK, LoopPanel, loop_figure
from hystmpc.trials.files import write_atomically
from hystmpc.trials.report import REFERENCE, Heading, KeyValues, Paragraph, Piece, Plot, Report, Table, new_figure
from hystmpc.trials.run_folder import RunFolder, take_back
from hystmpc.trials.types import Progress, parts

from .config import SimulationConfig, load_simulation
from .results import (
    Result,
    StudyResult,
    approach_sentence,
    best_figures,
    colours,
    conclusion,
    controllers_figure,
    distances,
    limits_of,
    load_results,
    log_columns,
    looks,
    result_of,
    tip_figure,
)
from .study import prepare
from .tuning.gains import PidLike, tuned_study
from .two_axes.config import AnyStudyConfig, TwoAxisSimulationConfig
from .two_axes.report import set_up_rows, signals_figure
from .two_axes.study import AnyStudy, prepare_two_axes

_STEP_S, _PID_STEP_S = 2e-3, 3e-4  # of a closed loop, with the mean controller and with one that is tuned
_REPORT_S, _RUN_REPORT_S = 3.0, 0.4  # of the page, and of a run on it


def compare(config: AnyStudyConfig, out: Path | str | None = None, progress: Progress | None = None) -> StudyResult:
    """Run a study: prepare it, tune where requested, run every controller along every motion, and report.

    `out` gets config.yaml, meta.json and report.html of the study, and `<motion>/<controller>/` with config.yaml,
    meta.json and log.csv of every run. After Ctrl-C only finished runs are written.

    Args:
        out: a new or empty folder; nothing is written where left out.

    Raises:
        HystmpcError: of `prepare`; ConfigError also if `out` is not vacant.
        KeyboardInterrupt: if the user ends it before the first run is finished.
    """
    study = prepare(config) if isinstance(config, SimulationConfig) else prepare_two_axes(config)
    folder = None if out is None else _folder(Path(out), study, study.config)
    results: list[Result] = []
    tuning, running, reporting = parts(progress, _expected_s(study))
    try:
        study = tuned_study(study, tuning)
        if folder is not None:
            # Requested and resulting settings are stored apart: the settings written repeat the run without the search.
            write_atomically(folder.path / "config.yaml", dump_yaml(study.config.model_dump(mode="json")))
        for result in _runs(study, running):
            results.append(result)
            if folder is not None:
                _write(folder, study, result)
        if not results:
            raise KeyboardInterrupt
    except KeyboardInterrupt:
        if folder is not None and not results:
            take_back(folder.path)  # so that the command can be repeated with it
        raise
    done = StudyResult(study.config, tuple(results), {} if folder is None else folder.meta, study.warnings())
    if folder is not None:
        reporting(0, 1, "writing the report")
        folder.write_report(study_report(done))
        reporting(1, 1, "writing the report")
    return done


def _expected_s(study: AnyStudy) -> tuple[float, float, float]:
    """Expected durations of gain search, runs and report [s]; only their ratios matter."""
    config, steps = study.config, sum(study.steps(name) for name in study.motions)
    count = len(config.controllers)
    tuned = sum(isinstance(settings, PidLike) for settings in config.controllers.values())
    search = tuned * config.tune_pid.evaluations * steps * _PID_STEP_S if config.tune_pid else 0.0
    return search, count * steps * _STEP_S, _REPORT_S + count * len(study.motions) * _RUN_REPORT_S


def _runs(study: AnyStudy, progress: Progress) -> Iterator[Result]:
    pairs = [(motion, name) for motion in study.motions for name in study.config.controllers]
    lengths = {name: study.steps(name) for name in study.motions}
    total, done = sum(lengths[motion] for motion, _ in pairs), 0

    def step(_: object) -> None:
        nonlocal done
        done += 1
        progress(done, total)

    for motion, name in pairs:
        try:
            run = study.run(study.config.controllers[name], motion, step)
        except KeyboardInterrupt:
            return
        yield result_of(study.config, motion, name, run)


def _folder(path: Path, study: AnyStudy, config: AnyStudyConfig) -> RunFolder:
    return RunFolder.create(path, config, seed=config.seed, models=study.files)


def _write(folder: RunFolder, study: AnyStudy, result: Result) -> None:
    path = folder.path / result.motion / result.controller
    alone = study.config.narrowed(result.controller, result.motion)
    _folder(path, study, alone).write_log(log_columns(result.run))


def demo_config() -> SimulationConfig:
    """Return the demonstration study, `sim/demo.yaml`."""
    return load_simulation(Path(str(files("hystmpc.sim").joinpath("demo.yaml"))))


def demo(out: Path | str | None = None, progress: Progress | None = None) -> StudyResult:
    """Run the demonstration study: a point-to-point motion and a scan with every controller; see `compare`."""
    return compare(demo_config(), out, progress)


_BINS = 61
_ERRORS = ("controller", "RMSE [deg]", "max abs [deg]", "hold error [deg]")
_EFFORT = ("hold command range [{unit}]", "command travel [{unit}]", "limit violations")
_COLUMNS = (*_ERRORS, *_EFFORT, "step mean [ms]", "step p99 [ms]")
_WITH_GAINS = (PidControllerSettings, InversePidControllerSettings)


def error_figure(results: Sequence[Result], colour: Mapping[str, str]) -> Figure:
    """Draw the error over time, one row for each controller, on one scale."""
    with new_figure(7.0, 0.8 + 0.8 * len(results)) as figure:
        rows = figure.subplots(len(results), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for axes, result in zip(rows, results, strict=True):
            t, error = result.run.log.time_s, result.run.error_deg
            error = error if error.ndim == 1 else distances(error)
            axes.fill_between(t, error, color=colour[result.controller], linewidth=0.0)
            axes.axhline(0.0, color=REFERENCE, linewidth=0.6)
            axes.set_title(f"{result.controller}: RMSE {result.metrics.rmse_deg:.2f} deg")
        figure.supylabel("error [deg]", fontsize=9.0)
        rows[-1].set_xlabel("time [s]")
    return figure


def _loops(results: Sequence[Result], colour: Mapping[str, str], unit: str) -> Figure:
    panels = []
    for result in results:
        look = {"color": colour[result.controller], "linewidth": 0.8}
        panels.append(LoopPanel(result.controller, [(result.run.log.command, result.run.true_deg, look)]))
    return loop_figure(panels, unit, "deg")


def histogram_figure(results: Sequence[Result], look: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw the histogram of the error; the outermost bins include all values beyond them."""
    errors = [result.run.counted_deg for result in results]
    reach = float(np.quantile(np.abs(np.concatenate(errors)), 0.995))
    edges = np.linspace(-reach, reach, _BINS)
    with new_figure(7.0, 2.8) as figure:
        axes: Axes = figure.subplots()
        for result, error in zip(results, errors, strict=True):
            share = np.histogram(np.clip(error, -reach, reach), edges)[0] / error.size
            axes.stairs(100 * share, edges, label=result.controller, linewidth=1.2, **look[result.controller])
        axes.set(xlabel="error [deg]", ylabel="samples [%]", xlim=(-reach, reach))
        axes.legend()
    return figure


def timing_figure(results: Sequence[Result], colour: Mapping[str, str], dt_s: float) -> Figure:
    """Draw the execution time of each stage: bar to the median, line to the 99th percentile; dotted: sample time."""
    rows = _stage_times(results)
    with new_figure(7.0, 0.9 + 0.2 * len(rows)) as figure:
        axes: Axes = figure.subplots()
        for k, (controller, _, seconds) in enumerate(rows):
            median, slow = 1e3 * np.median(seconds), 1e3 * np.quantile(seconds, 0.99)
            axes.barh(k, median, height=0.7, color=colour[controller])
            axes.plot((median, slow), (k, k), color=REFERENCE, linewidth=0.9)
            axes.plot(slow, k, color=REFERENCE, marker="|", markersize=6)
        axes.axvline(1e3 * dt_s, **LIMIT_LOOK)
        axes.set(xscale="log", xlabel="execution time [ms]", ylim=(len(rows) - 0.4, -0.6))
        axes.set_yticks(range(len(rows)), [f"{controller}: {stage}" for controller, stage, _ in rows])
        axes.grid(visible=False, axis="y")
    return figure


def _stage_times(results: Sequence[Result]) -> list[tuple[str, str, Any]]:
    """Controller, stage and times [s] of the samples in which the stage ran; the sum of all stages is last."""
    rows: list[tuple[str, str, Any]] = []
    for controller in dict.fromkeys(result.controller for result in results):
        logs = [result.run.log for result in results if result.controller == controller]
        for stage in dict.fromkeys(stage for log in logs for stage in log.stage_s):
            times = np.concatenate([log.stage_s[stage] for log in logs if stage in log.stage_s])
            if np.any(times > 0):
                rows.append((controller, stage, times[times > 0]))
        rows.append((controller, "whole step", np.concatenate([log.step_s for log in logs])))
    return rows


def study_report(result: StudyResult, more: Sequence[Piece] = ()) -> Report:
    """Make the report of a study; `more` is shown first."""
    colour, look = colours(result.controllers), looks(result.controllers)
    pieces: list[Piece] = [*more, *_summary(result), *_set_up(result)]
    for motion in result.motions:
        runs = result.of_motion(motion)
        pieces += [Heading(f"Motion: {motion}"), _metrics_table(runs, result.unit)]
        if isinstance(result.config, TwoAxisSimulationConfig):
            tips = "Tip in the plane of both angles, without sensor noise and without the approach."
            signals = "Angles without sensor noise, and the commands; grey dots: command limits."
            error = "Error of the tip: distance of its true angles from the reference."
            pieces += [
                Plot(tip_figure(runs, look), tips, True),
                Plot(signals_figure(runs, look, result.unit), signals, True),
                Plot(error_figure(runs, colour), error),
            ]
            continue
        pieces += [
            Plot(
                controllers_figure(runs, look, result.unit),
                "Tip angle without sensor noise, and the command; grey dots: command limits.",
                True,
            ),
            Plot(error_figure(runs, colour), "Error: tip angle without sensor noise less reference."),
            Plot(_loops(runs, colour, result.unit), "Tip angle over command."),
            Plot(histogram_figure(runs, look), "Distribution of the error; the outermost bins hold all beyond them."),
        ]
    pieces += [*_stability(result), *_timing(result, colour)]
    plant = result.config.plant
    subtitle = f"plant {_short(plant.name)}, model {_short(result.config.model)}"
    return Report("Closed loop in simulation", tuple(pieces), subtitle)


def report_from_folder(path: Path | str, more: Sequence[Piece] = ()) -> Path:
    """Rewrite `report.html` of a simulation's run folder from its files alone; `more` is shown first.

    Raises:
        LogError: if it holds no run of a simulation.
        ConfigError: if its settings are not those of a simulation.
    """
    return study_report(load_results(path), more).save(Path(path) / "report.html")


def _summary(result: StudyResult) -> Iterator[Piece]:
    by_pair = {(r.motion, r.controller): r.metrics.rmse_deg for r in result.results}
    rows = [
        (controller, *(by_pair.get((motion, controller), math.nan) for motion in result.motions))
        for controller in result.controllers
    ]
    yield Heading("Tracking error")
    for sentence in (*result.warnings, conclusion(result), approach_sentence(result)):
        if sentence:
            yield Paragraph(sentence)
    marked = {
        (result.controllers.index(controller), j)
        for j, motion in enumerate(result.motions, 1)
        for controller, name in best_figures(result.of_motion(motion))
        if name == "rmse_deg"
    }
    caption = "RMSE of the tip angle without sensor noise [deg]; bold: the least, to 0.001 deg."
    yield Table(("controller", *result.motions), rows, caption, marked)
    violations = sum(r.metrics.limit_violations for r in result.results)
    yield Paragraph(f"Commands beyond their limits in {len(result.results)} runs: {violations}.")


def _set_up(result: StudyResult) -> Iterator[Piece]:
    config, unit = result.config, result.unit
    if isinstance(config, TwoAxisSimulationConfig):
        names = {"plant": _short(config.plant.name), "model": _short(config.model)}
        yield Heading("Set-up")
        yield KeyValues(names | _clock_and_seed(result) | set_up_rows(config, unit) | _occasion(result))
        yield from _gains(config.controllers, unit, config.tuned)
        return
    limits = config.limits
    beyond = config.plant.model_dump(exclude={"simulator", "device"})
    plant = {name: value for name, value in beyond.items() if value}
    yield Heading("Set-up")
    rows: dict[str, object] = {
        "plant": _short(config.plant.name),
        "effects": ", ".join(f"{name} {value}" for name, value in plant.items()) or "none",
        "model": _short(config.model),
        "inverse": _short(config.inverse) if config.inverse else "the model's own, or a backlash fitted to a network",
        "actuator lag told to controllers": f"{config.actuator_lag_s:g} s" if config.actuator_lag_s else "none",
        **_clock_and_seed(result),
    }
    if config.sensor.kind != "continuous":
        rows["angle sensor"] = ", ".join(f"{name} {value}" for name, value in config.sensor.model_dump().items())
    if limits is not None:
        rows["command limits"] = f"{limits.lower:g} to {limits.upper:g} {unit}, {limits.rate_per_s:.4g} {unit}/s"
    yield KeyValues(rows | _occasion(result))
    yield from _gains(config.controllers, unit, config.tuned)


def _clock_and_seed(result: StudyResult) -> dict[str, object]:
    return {"sample time": f"{result.results[0].run.dt:g} s", "seed": result.config.seed}


def _occasion(result: StudyResult) -> dict[str, object]:
    """Version and start of the runs; empty where nothing was written."""
    meta = result.meta
    return {"hystmpc": meta["versions"].get("hystmpc"), "started": meta["start"]} if meta else {}


def _gains(controllers: Mapping[str, Any], unit: str, tuned: Sequence[str] = ()) -> Iterator[Piece]:
    gains = {name: s.gains for name, s in controllers.items() if isinstance(s, _WITH_GAINS)}
    if gains:
        note = f" Found by search on this plant and these motions: {', '.join(tuned)}." if tuned else ""
        columns = ("controller", f"kp [{unit}/deg]", f"ki [{unit}/(deg s)]", f"kd [{unit} s/deg]", "dead zone [deg]")
        rows_of = [(n, g.kp_per_deg, g.ki_per_deg_s, g.kd_s_per_deg, g.dead_zone_deg) for n, g in gains.items()]
        yield Table(columns, rows_of, f"PID gains.{note}")


def _metrics_table(runs: tuple[Result, ...], unit: str) -> Table:
    rows, best, axes = [], best_figures(runs), len(runs[0].run.axis_rmse_deg)
    places = {"rmse_deg": 1, "max_abs_deg": 2 + axes, "hold_error_deg": 3 + axes}
    marked = {(i, j) for i, run in enumerate(runs) for name, j in places.items() if (run.controller, name) in best}
    for run in runs:
        m = run.metrics
        held = [value if math.isfinite(value) else "no hold" for value in (m.hold_error_deg, m.hold_command_range)]
        times = 1e3 * m.step_mean_s, 1e3 * m.step_p99_s
        errors = m.rmse_deg, *run.run.axis_rmse_deg, m.max_abs_deg
        rows.append((run.controller, *errors, *held, m.command_travel, m.limit_violations, *times))
    caption = (
        "Errors of the tip angle without sensor noise; hold figures over the last half of every hold; "
        "bold: the least, to 0.001 deg."
    )
    columns = [*_COLUMNS[:2], *(f"RMSE {name} [deg]" for name in "xy"[:axes]), *_COLUMNS[2:]]
    return Table([column.format(unit=unit) for column in columns], rows, caption, marked)


def _stability(result: StudyResult) -> Iterator[Piece]:
    """Margins and limit cycles of every loop with a PID around the identified model."""
    config = result.config
    if isinstance(config, TwoAxisSimulationConfig):
        return
    loops = {n: config.controllers[n] for n in result.controllers if isinstance(config.controllers[n], _WITH_GAINS)}
    if not loops:
        return
    yield Heading("PID loops, as predicted")
    if config.sensor.kind != "continuous":
        yield Paragraph(f"Not analysed: the sensor is {config.sensor.kind}, expected continuous.")
        return
    try:
        model = load_model(model_path(config.model), start="conditioned")
    except ModelError as error:
        yield Paragraph(f"Not analysed: {error}")
        return
    yield from loops_of(
        model, config.model, loops, cast("CommandLimits", limits_of(config, next(iter(loops)))), config.actuator_lag_s
    ).summary()


def _timing(result: StudyResult, colour: dict[str, str]) -> Iterator[Piece]:
    dt = result.results[0].run.dt
    yield Heading("Execution time and fallbacks")
    caption = "Time per stage over all motions: bar to the median, line to the 99th percentile; dotted: sample time."
    yield Plot(timing_figure(result.results, colour, dt), caption)
    sources = tuple(dict.fromkeys(source for r in result.results for source in r.metrics.ladder))
    rows = [(r.motion, r.controller, *(r.metrics.ladder.get(s, 0) for s in sources)) for r in result.results]
    yield Table(("motion", "controller", *sources), rows, "Samples by the fallback level that gave the command.")


def _short(file: str) -> str:
    """Name of a built-in model, or a file name without its folder."""
    return file if file.startswith("builtin:") else Path(file).name
