"""Every controller of a study along every motion, with a run folder for each; and the study that ships as `demo`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from importlib.resources import files
from pathlib import Path

from hystmpc.trials.config import dump_yaml
from hystmpc.trials.files import write_atomically
from hystmpc.trials.run_folder import RunFolder
from hystmpc.trials.types import Progress, parts

from .config import SimulationConfig, load_simulation
from .report import study_report
from .results import Result, StudyResult, log_columns, result_of
from .study import Study, prepare
from .tune_pid import PidLike, tuned_study

_STEP_S, _PID_STEP_S = 2e-3, 3e-4  # of a closed loop, with the mean controller and with one that is tuned
_REPORT_S, _RUN_REPORT_S = 3.0, 0.4  # of the page, and of a run on it


def compare(config: SimulationConfig, out: Path | str | None = None, progress: Progress | None = None) -> StudyResult:
    """Run a study: prepare, tune where asked, run every controller along every motion, report.

    Below `out` stand config.yaml, meta.json and report.html of the study, and `<motion>/<controller>/` with
    config.yaml, meta.json and log.csv of every run. Ctrl-C during a run leaves out what was not finished, and no folder
    where nothing was.

    Args:
        out: a new or empty folder; nothing is written where left out.

    Raises:
        HystmpcError: what `prepare` raises; ConfigError also if `out` is not vacant.
        KeyboardInterrupt: if the user ends it before the first run is finished.
    """
    study = prepare(config)
    folder = None if out is None else _folder(Path(out), study)
    results: list[Result] = []
    tuning, running, reporting = parts(progress, _expected_s(study))
    try:
        study = tuned_study(study, tuning)
        if folder is not None:
            # Asked for and found are told apart: the settings left behind repeat the run without the search.
            write_atomically(folder.path / "config.yaml", dump_yaml(study.config.model_dump(mode="json")))
        for result in _runs(study, running):
            results.append(result)
            if folder is not None:
                _write(folder, study, result)
        if not results:
            raise KeyboardInterrupt
    except KeyboardInterrupt:
        if folder is not None and not results:
            _take_back(folder.path)
        raise
    found = StudyResult(study.config, tuple(results), {} if folder is None else folder.meta, study.warnings())
    if folder is not None:
        reporting(0, 1, "writing the report")
        folder.write_report(study_report(found))
        reporting(1, 1, "writing the report")
    return found


def _expected_s(study: Study) -> tuple[float, float, float]:
    """Seconds of the search of gains, of the runs and of the report; they matter by their ratios only."""
    config, steps = study.config, sum(study.steps(name) for name in study.motions)
    count = len(config.controllers)
    tuned = sum(isinstance(settings, PidLike) for settings in config.controllers.values())
    search = tuned * config.tune_pid.evaluations * steps * _PID_STEP_S if config.tune_pid else 0.0
    return search, count * steps * _STEP_S, _REPORT_S + count * len(study.motions) * _RUN_REPORT_S


def _runs(study: Study, progress: Progress) -> Iterator[Result]:
    """Run after run, until the last or until Ctrl-C."""
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


def _folder(path: Path, study: Study) -> RunFolder:
    return RunFolder.create(path, study.config, seed=study.config.seed, models=study.files)


def _take_back(path: Path) -> None:
    """Remove a folder in which nothing has been run, or the same command would be refused for it the next time."""
    for name in ("config.yaml", "meta.json"):
        (path / name).unlink(missing_ok=True)
    with suppress(OSError):
        path.rmdir()


def _write(folder: RunFolder, study: Study, result: Result) -> None:
    """The folder of one run; its settings are the study's, narrowed to it."""
    path = folder.path / result.motion / result.controller
    alone = study.config.narrowed(result.controller, result.motion)
    run = RunFolder.create(path, alone, seed=study.config.seed, models=study.files)
    run.write_log(log_columns(result.run))


def demo_config() -> SimulationConfig:
    """The study that `demo` runs; `sim/demo.yaml`."""
    return load_simulation(Path(str(files("hystmpc.sim").joinpath("demo.yaml"))))


def demo(out: Path | str | None = None, progress: Progress | None = None) -> StudyResult:
    """Track a point-to-point motion and a scan with every controller; see `compare`.

    Raises:
        ConfigError: if `out` is not vacant.
        KeyboardInterrupt: if the user ends it before the first run is finished.
    """
    return compare(demo_config(), out, progress)
