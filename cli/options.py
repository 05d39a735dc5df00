"""Arguments and options that several verbs take, and the trials behind them."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hystmpc.models.contract.checks import parse_model
from hystmpc.models.contract.metadata import PREFIX
from hystmpc.trials.check import Severity, check
from hystmpc.trials.clock_findings import gaps_text
from hystmpc.trials.command_noise import noise_text
from hystmpc.trials.config import read_yaml
from hystmpc.trials.errors import ConfigError, HystmpcError, ModelError
from hystmpc.trials.files import require_writable
from hystmpc.trials.from_outside import allow_python
from hystmpc.trials.layouts import PRESETS
from hystmpc.trials.read import at_rate, expand_logs, read_trials
from hystmpc.trials.recording import require_recorded
from hystmpc.trials.run_folder import require_vacant
from hystmpc.trials.trial import Trial, parts_at_gaps

from .console import errors

if TYPE_CHECKING:
    from hystmpc.models.contract.load import OnnxModel
    from hystmpc.models.simulator import Simulator

_LAYOUTS = ", ".join(preset.name for preset in PRESETS)

Logs = Annotated[
    list[Path], typer.Argument(metavar="LOG", help="Recorded trials (csv, xlsx, mat, ROS bag, ...) or folders of them.")
]
Layout = Annotated[
    str, typer.Option("--preset", help=f"Layout of the logs: auto, {_LAYOUTS}, or a mapping file *.yaml.")
]
SampledHz = Annotated[
    float | None,
    typer.Option("--sampled-hz", help="Rate [Hz] of logs sampled evenly; stands in for a broken or missing clock."),
]
Sim = Annotated[
    Path | None, typer.Option("--sim", help="Simulator: .yaml of `fit`, an exported .onnx model, or builtin:NAME.")
]
AllowPython = Annotated[
    bool,
    typer.Option("--allow-python", help="Import classes that the file names as python: MODULE:CLASS; you trust it."),
]
SkipFirstFlexure = Annotated[
    bool, typer.Option("--skip-first-flexure", help="Count each trial only from the command's first reversal on.")
]


def heard(allow: bool) -> None:
    """Say yes to the classes that files name, where `--allow-python` is given."""
    if allow:
        allow_python()


def processes(jobs: int | None) -> int:
    """How many worker processes `--jobs` asks for; one a core where it is left out.

    Raises:
        ConfigError: if it is below 1.
    """
    if jobs is not None and jobs < 1:
        raise ConfigError(f"--jobs: got {jobs}, expected 1 or more; left out it is one a core, here {os.cpu_count()}")
    return jobs or os.cpu_count() or 1


def files_read(logs: Sequence[Path], layout: str) -> list[Path]:
    """Files that stand behind `LOG...` and `--preset`.

    Raises:
        LogError: if a folder holds no log.
    """
    return [*expand_logs(logs), Path(layout)]


def trials_at(logs: Sequence[Path], layout: str, rate_hz: float, sampled_hz: float | None = None) -> list[Trial]:
    """Read logs and resample them; say what is made of gaps and noise, and what seems to be in another unit.

    Raises:
        LogError: if a log cannot be read or resampled, or its time seems to be in milliseconds.
        ConfigError: if a rate is not a positive number.
    """
    recorded = read_trials(logs, layout, sampled_hz=sampled_hz)
    for trial in recorded:
        require_recorded(trial)
        if said := gaps_text(trial, parts_at_gaps(trial)):
            errors.print(f"note: {trial.source}: {said}", soft_wrap=True, highlight=False)
    trials = at_rate(recorded, rate_hz)
    for trial in trials:
        if said := noise_text(trial):
            errors.print(f"note: {trial.source}: {said}", soft_wrap=True, highlight=False)
    warn_of_units(trials)
    return trials


def simulator_at(path: Path) -> Simulator | OnnxModel:
    """The simulator of `--sim`: a chain of operators as such, a network as the model that it is.

    Raises:
        ModelError: if it has another ending, or cannot be opened.
    """
    from hystmpc.models.load import model_path

    path = model_path(str(path))
    suffix = path.suffix.lower()
    if suffix in (".yaml", ".yml"):
        from hystmpc.models.simulator import load_simulator

        return load_simulator(path)
    if suffix == ".onnx":
        from hystmpc.models.contract.load import load_onnx

        return load_onnx(path)
    raise ModelError(f"--sim {path}: ending {suffix or 'missing'}, expected .yaml, .onnx or builtin:NAME")


def warn_of_units(trials: Sequence[Trial]) -> None:
    """A line where a signal looks like another unit, or has another clock: an error of the model would tell neither."""
    for trial in trials:
        for finding in check(trial).findings:
            if finding.topic.startswith(("units", "clocks")) and finding.severity is Severity.WARNING:
                text = f"warning: {trial.source}: {finding.topic}: {finding.message}"
                errors.print(text, style="yellow", soft_wrap=True, highlight=False)


Force = Annotated[bool, typer.Option("--force", help="Replace an older file of the same kind; never one of another.")]


@dataclass(frozen=True)
class Output:
    """A kind of file that a verb writes.

    Attributes:
        what: its name, with an article, for messages.
        endings: of its file names, in lower case.
        format_of: says the format of such a file; empty, or an error of reading, for any other file.
        formats: with which that has to begin.
    """

    what: str
    endings: tuple[str, ...]
    format_of: Callable[[Path], str]
    formats: tuple[str, ...]

    def is_one(self, path: Path) -> bool:
        """Whether a file is of this kind, of whatever version."""
        try:
            return self.format_of(path).startswith(self.formats)
        except (OSError, ValueError, LookupError, RecursionError, HystmpcError, zipfile.BadZipFile):
            return False


def _of_model(path: Path) -> str:
    entries = parse_model(path.read_bytes(), str(path)).metadata_props
    return next((str(entry.value) for entry in entries if entry.key == f"{PREFIX}format"), "").strip('"')


def _of_yaml(path: Path) -> str:
    return _format(read_yaml(path))


def _of_json(path: Path) -> str:
    return _format(json.loads(path.read_text(encoding="utf-8")))


def _of_page(path: Path) -> str:
    with path.open(encoding="utf-8") as file:
        return "hystmpc" if '<meta name="generator" content="hystmpc">' in file.read(1000) else ""


def _of_c(path: Path) -> str:
    with path.open(encoding="utf-8") as file:
        return "hystmpc" if "Written by hystmpc" in file.read(1000) else ""


def _of_fmu(path: Path) -> str:
    with zipfile.ZipFile(path) as archive:
        description = archive.read("modelDescription.xml").decode("utf-8")
    return "hystmpc" if 'generationTool="hystmpc' in description else ""


def _format(data: Any) -> str:
    return str(data.get("format", "")) if isinstance(data, dict) else ""


MODEL = Output("an ONNX model of hystmpc", (".onnx",), _of_model, ("hystmpc-model/",))
SIMULATOR = Output("a simulator file", (".yaml", ".yml"), _of_yaml, ("hystmpc-simulator/",))
EVALUATION = Output("an evaluation", (".json",), _of_json, ("hystmpc-evaluation/", "hystmpc-inverse-evaluation/"))
BENCHMARK = Output("a benchmark's result", (".json",), _of_json, ("hystmpc-bench/",))
C_SOURCE = Output("an exported controller", (".c",), _of_c, ("hystmpc",))
C_HEADER = Output("an exported controller", (".h",), _of_c, ("hystmpc",))
FMU = Output("an FMU of hystmpc", (".fmu",), _of_fmu, ("hystmpc",))
REPORT = Output("a report of hystmpc", (".html",), _of_page, ("hystmpc",))

Page = Annotated[Path | None, typer.Option("--report", help="Write one page with tables and figures here, .html.")]


Figures = Annotated[
    Path | None,
    typer.Option("--figures", help="New folder for every figure of the report: SVG, PDF, and its data as CSV."),
]


def check_figures(figures: Path | None) -> None:
    """Refuse a folder of `--figures` before any work is done.

    Raises:
        ConfigError: if it is not new or empty, or cannot be written.
    """
    if figures is not None:
        require_vacant(figures)


def check_page(page: Path | None, figures: Path | None, inputs: Iterable[Path], force: bool) -> None:
    """`check_output` for `--report`, where it is given; and `--figures` of it.

    Raises:
        ConfigError: if the page or its figures may not be written.
    """
    if page is not None:
        check_output("--report", page, (REPORT,), inputs, force)
    elif figures is not None:
        raise ConfigError(f"--figures {figures}: is of the page of --report, which is not given")
    check_figures(figures)


def check_output(
    option: str, path: Path, kinds: Sequence[Output], inputs: Iterable[Path] = (), force: bool = False, of: str = ""
) -> None:
    """Refuse a file that a verb may not write: nothing is overwritten but, with `--force`, a file of the same kind.

    Args:
        option: that names the file, for messages.
        path: the file.
        kinds: that the verb can write there; its ending chooses.
        inputs: files that the same call reads, which it may not replace.
        force: whether an older file may be replaced.
        of: what is written, for the message on a wrong ending.

    Raises:
        ConfigError: if the ending is none of the kinds, the path is a folder or an input or cannot be written, or
            something lies there that may not be replaced.
    """
    where = f"{option} {path}"
    kind = next((kind for kind in kinds if path.suffix.lower() in kind.endings), None)
    if kind is None:
        endings = " or ".join(ending for kind in kinds for ending in kind.endings)
        raise ConfigError(f"{where}: expected a file ending in {endings}{f' for {of}' if of else ''}")
    try:
        require_writable(path)
    except ConfigError as error:
        raise ConfigError(f"{option} {error}") from None
    if path.is_dir():
        raise ConfigError(f"{where}: is a folder, expected a file")
    for other in inputs:
        if _same(path, other):
            raise ConfigError(f"{where}: is read by the same command ({other}), expected another file")
    if os.path.lexists(path):
        if not force:
            raise ConfigError(f"{where}: exists, expected a new file; --force replaces it if it is {kind.what}")
        if not kind.is_one(path):
            raise ConfigError(f"{where}: exists and is not {kind.what}, which is all that --force replaces")


def _same(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)
    except (OSError, ValueError):  # one of them is not there
        return False
