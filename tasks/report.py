"""Report of a run folder, written from its files."""

from __future__ import annotations

from collections.abc import Iterable, Set
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hystmpc.trials.config import read_yaml
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.files import figures_to
from hystmpc.trials.from_outside import only_reads
from hystmpc.trials.run_folder import RunFolder

from .outputs import check_figures

if TYPE_CHECKING:
    from hystmpc.trials.report import Piece


@dataclass(frozen=True)
class WrittenReport:
    """A written report.

    Attributes:
        lines: fall of the tracking error, and the result of the review of an experiment.
    """

    path: Path
    lines: tuple[str, ...] = ()


def report(
    run: Path | str,
    *,
    before: Iterable[Path | str] = (),
    diagnosis: Path | str | None = None,
    figures: Path | str | None = None,
) -> WrittenReport:
    """Rewrite report.html of a run folder.

    For an experiment it recommends the next step: none, `fit` or `diagnose`. With an earlier run it says how far the
    tracking error fell, and with a diagnosis how far it was expected to fall on this reference.

    Args:
        run: run folder, or that of a commissioning.
        before: earlier run on the same reference.
        diagnosis: folder of `diagnose`: the fall of the tracking error that it lets expect.
        figures: new folder for every figure of the report: SVG, PDF, and its data as CSV.

    Raises:
        LogError: if the folder holds no complete run.
        ConfigError: if a folder cannot be written, or a commissioning or a run of two axes is to be compared.
    """
    from hystmpc.rig.plane_config import file_of_two_axes

    check_figures(figures)
    folder, earlier = Path(run), [Path(one) for one in before]
    keys = _settings_of(folder)
    with figures_to(figures), only_reads():
        if "commissioning" in keys:
            return _commissioning(folder, bool(earlier or diagnosis is not None))
        if (earlier or diagnosis is not None) and file_of_two_axes(folder / "config.yaml"):
            raise ConfigError("report: --before and --diagnosis take runs of one axis, got a run of two axes")
        lines, more = _fall(folder, earlier, None if diagnosis is None else Path(diagnosis))
        if {"transport", "sensor", "reference"} <= keys:
            from hystmpc.rig.experiment.plane_review import review_bench_run

            reviewed = review_bench_run(folder, more).lines
            return WrittenReport(folder / "report.html", (*lines, *(f"review: {line}" for line in reviewed)))
        if {"transport", "sensor", "excitations"} <= keys:
            from hystmpc.rig.recording.report import write_report

            return WrittenReport(write_report(RunFolder.open(folder)), lines)
        from hystmpc.sim.compare import report_from_folder

        return WrittenReport(report_from_folder(folder, more), lines)


def _commissioning(run: Path, compared: bool) -> WrittenReport:
    if compared:
        raise ConfigError("report: a commissioning has no use for --before and --diagnosis, expected a run of `run`")
    from hystmpc.bench.commission import rewrite_report

    return WrittenReport(rewrite_report(run).report)


def _fall(run: Path, before: list[Path], diagnosis: Path | None) -> tuple[tuple[str, ...], tuple[Piece, ...]]:
    if not before and diagnosis is None:
        return (), ()
    from hystmpc.gap.measured_tracking import fall_lines, fall_pieces, tracking_falls

    falls = tracking_falls(run, before, diagnosis)
    return tuple(fall_lines(falls)), fall_pieces(falls)


def _settings_of(run: Path) -> Set[str]:
    file = run / "config.yaml"
    settings = read_yaml(file) if file.is_file() else None
    return settings.keys() if isinstance(settings, dict) else frozenset()
