"""`hystmpc diagnose`: where a simulator departs from recorded trials, why, how far it can be mended, what to record."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.figure_folder import figures_to
from hystmpc.trials.files import require_writable
from hystmpc.trials.read import read_trials
from hystmpc.trials.recording import require_recorded
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress

from .bars import Bar, bar
from .console import errors, out, table
from .options import Figures, Layout, Sim, SkipFirstFlexure, check_figures, simulator_at, warn_of_units
from .time_left import Pace

if TYPE_CHECKING:
    from hystmpc.gap.diagnosis import Diagnosis

FAILED = 1
_REPORT = 10  # steps of the report, beside the hundred of the diagnosis
# Three rounds of the selection, as on logs of a catheter with a simulator that was identified from others.
_PACE: Pace = ((0, 0), (0.05, 0.12), (0.34, 0.31), (0.51, 0.44), (0.62, 0.57), (0.77, 0.6), (0.91, 0.69), (1, 1))

Logs = Annotated[
    list[Path] | None,
    typer.Argument(metavar="LOG...", help="Trials of one device, or folders of *.csv."),
]


def diagnose(
    logs: Logs = None,
    sim: Sim = None,
    folder: Annotated[
        Path | None, typer.Option("--out", help="Folder to write: new, empty, or an older diagnosis.")
    ] = None,
    preset: Layout = "auto",
    as_json: Annotated[bool, typer.Option("--json", help="Print diagnosis.json and nothing else.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything drawn at random.")] = 1,
    without: Annotated[
        list[str] | None, typer.Option("--without", help="Leave this effect out of the library; repeatable.")
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option("--only", help="Look for this effect and those named so alone; repeatable.")
    ] = None,
    ordered: Annotated[
        bool, typer.Option("--ordered", help="LOG... are in recording order; else time stamps or a manifest tell it.")
    ] = False,
    skip_first_flexure: SkipFirstFlexure = False,
    figures: Figures = None,
    self_test: Annotated[
        bool, typer.Option("--self-test", help="Recover known truths instead of reading logs.")
    ] = False,
) -> None:
    """Diagnose the gap between a simulator and its device.

    Exit code 0 whatever the verdict.
    """
    if self_test:
        _self_test(seed)
        return
    files, sim, folder = _complete(logs, sim, folder)
    check_figures(figures)
    with figures_to(figures):
        diagnosis = _diagnosed(
            files,
            sim,
            folder,
            preset,
            seed=seed,
            without=tuple(without or ()),
            only=tuple(only) if only else None,
            ordered=ordered,
            skip_first_flexure=skip_first_flexure,
        )
    if as_json:
        from hystmpc.gap.report.folder import diagnosis_json

        sys.stdout.write(diagnosis_json(diagnosis))
        return
    print_diagnosis(diagnosis)
    out.print(f"report: {folder / 'report.html'}", soft_wrap=True, highlight=False)


def _diagnosed(files: Sequence[Path], sim: Path, folder: Path, preset: str, **chosen: Any) -> Diagnosis:
    """Diagnose and write the folder; what is unusable is refused before the long part."""
    from hystmpc.gap.report.folder import require_free

    require_writable(folder)
    require_free(folder)
    simulator = simulator_at(sim)
    trials = _recorded(files, preset)
    from hystmpc.gap.diagnose import diagnose_trials  # compiles: kept out of the way of refusals
    from hystmpc.models.load import model_path

    with bar("diagnose", pace=_PACE) as show:

        def told(done: float, total: float, note: str = "", /) -> None:
            show(done, note, total=total + _REPORT)

        done = diagnose_trials(
            trials,
            simulator,
            out=folder,
            called={"sim": str(sim), "preset": preset},
            model=Path(model_path(str(sim))),
            progress=told,
            say=_say,
            **chosen,
        )
        told(100 + _REPORT, 100, "writing the report")
    return done.diagnosis


def print_diagnosis(diagnosis: Diagnosis) -> None:
    """The verdict in words, then the sizes of the gap, the effects and what to record next."""
    from hystmpc.gap.report import words
    from hystmpc.gap.report.words import in_words, percent

    said = (words.closed_sentence, words.mis_set_sentence, words.stability_sentence, words.tracking_sentence)
    sentences = (*(sentence(diagnosis) for sentence in said), *words.order_sentences(diagnosis))
    for line in (words.headline(diagnosis), diagnosis.reason, *sentences):
        if line:
            out.print(line, highlight=False)
    if diagnosis.ranking:
        found = {effect.name: effect for effect in diagnosis.effects}
        rows = []
        for name, probability in diagnosis.ranking[:6]:
            effect = found.get(name)
            shares = ("", "", "")
            if effect is not None:
                low, high = effect.closed_ci90
                values = words.parameter_words(effect)
                shares = (percent(effect.closed_share), f"{percent(low)} to {percent(high)}", values)
            rows.append([in_words(name), percent(probability), *shares])
        out.print(table("effects", ("effect", "probability", "closes", "90 % interval", "parameters"), rows))
    if (motion := diagnosis.next_motion) is not None:
        names = ", ".join(in_words(name) for name in motion.separates)
        out.print(
            f"next: record {motion.file} ({motion.duration_s:.0f} s) to tell apart {names}: "
            f"{percent(motion.expected_probability)} expected",
            highlight=False,
        )


def _complete(logs: list[Path] | None, sim: Path | None, folder: Path | None) -> tuple[list[Path], Path, Path]:
    """All three, or one line that says what lacks."""
    if not logs or sim is None or folder is None:
        given = {"LOG...": logs, "--sim": sim, "--out": folder}
        gone = [name for name, value in given.items() if not value]
        raise ConfigError(f"diagnose: lacks {', '.join(gone)}, expected LOG... --sim SIM --out DIR, or --self-test")
    return logs, sim, folder


def _recorded(files: Sequence[Path], layout: str) -> list[Trial]:
    """Trials as recorded, all of them fit for a diagnosis."""
    trials = read_trials(files, layout)
    for trial in trials:
        require_recorded(trial)
    warn_of_units(trials)
    return trials


def _progress(show: Bar) -> Progress:
    return lambda done, total, note="": show(done, note, total=total)


def _say(line: str) -> None:
    errors.print(line, style="yellow", soft_wrap=True, markup=False, highlight=False)


def _self_test(seed: int) -> None:
    """Print what became of each known truth; exit code 1 where one was missed."""
    from hystmpc.gap.self_test import self_test

    with bar("self-test") as show:
        rows = [_fields(row) for row in self_test(seed, _progress(show))]
    columns = list(rows[0]) if rows else []
    out.print(table("self-test", columns, [[_text(value) for value in row.values()] for row in rows]))
    if any(row.get("passed") is False for row in rows):
        errors.print("self-test: not every truth was recovered", style="red")
        raise typer.Exit(FAILED)


def _fields(row: Any) -> Mapping[str, Any]:
    return row if isinstance(row, Mapping) else asdict(row)


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
