"""report.html of an investigation: the verdict, then the story round by round."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hystmpc.gap.report.words import in_words, listed, percent
from hystmpc.trials.csv_files import read_csv
from hystmpc.trials.recording import SEPARATION_COLUMN
from hystmpc.trials.report import (
    COMMAND,
    MEASURED,
    MODEL,
    REFERENCE,
    Heading,
    KeyValues,
    Paragraph,
    Piece,
    Plot,
    Report,
    Table,
    new_figure,
)
from hystmpc.trials.run_folder import RunFolder

from .investigation import FIRST, Investigated, Round, round_folder
from .round_plan import Plan
from .round_verdict import DIAGNOSIS, Ending

TO_DO: dict[Ending, str] = {
    "": "",
    "named": "use the corrected simulator; commission again with it where the tracking error matters",
    "no_gap": "use the simulator, retuned; what is left is noise and the simulator's own form",
    "nothing_gained": "read the last diagnosis: what is not told apart stays so with such motions on this device; "
    "change load, orientation or pretension, or look at the device",
    "budget": "run it again with more minutes, in another folder",
}

_ANGLES = (
    ("angle_deg", MEASURED, 2.4, "measured"),
    ("nominal_deg", REFERENCE, 0.9, "simulator as given"),
    ("with_effects_deg", MODEL, 1.0, "corrected"),
)


def write_report(made: Investigated, name: str, command_unit: str) -> Path:
    """Write the page, whole or not at all.

    Raises:
        LogError: if the files of a round are not there any more.
    """
    subtitle = f"simulator {made.model.name}, {len(made.rounds)} rounds, {made.device_s:.0f} s of device time"
    return Report(f"Investigation of {name}", tuple(_pieces(made, command_unit)), subtitle).save(made.report)


def _pieces(made: Investigated, unit: str) -> Iterator[Piece]:
    last = made.verdict
    yield Heading(last.headline)
    yield Paragraph(last.reason)
    yield Paragraph(f"Ended: {made.why}.")
    yield Paragraph(f"What to do: {TO_DO[made.ended]}.")
    yield KeyValues(
        {
            "device time": f"{made.device_s:.0f} s of {made.budget_s:.0f} s, motions that were cut short included",
            "corrected simulator": "none" if made.fixed is None else _beside(made.fixed, made.folder),
            "whole diagnosis": _beside(_diagnosis(made, made.rounds[-1]) / "report.html", made.folder),
        }
    )
    yield _overview(made)
    for found in made.rounds:
        yield from _round(made, found, unit)


def _diagnosis(made: Investigated, found: Round) -> Path:
    return round_folder(made.folder, found.number) / "diagnose" / DIAGNOSIS


def _beside(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix()


def _overview(made: Investigated) -> Table:
    rows = []
    for found in made.rounds:
        judged = found.judged
        rows.append(
            (
                found.number,
                f"{found.recorded.device_s:.0f}",
                len(found.recorded.names),
                judged.headline,
                percent(judged.probability) if math.isfinite(judged.probability) else "-",
                judged.retuned_deg,
                judged.left_deg,
            )
        )
    columns = ("round", "device time [s]", "motions", "verdict", "probability", "retuned [deg]", "with effects [deg]")
    return Table(columns, rows, "Verdict after each round, on all trials so far; RMSE on trials kept for the end.")


def _round(made: Investigated, found: Round, unit: str) -> Iterator[Piece]:
    yield Heading(f"Round {found.number}: {found.judged.headline}")
    yield Paragraph(why_these(found.plan))
    yield Paragraph(f"Verdict on {found.judged.trials} trials: {found.judged.reason}.")
    yield Plot(
        _figure(made, found, unit),
        "Above: command. Middle: measured angle, the simulator as given, and the corrected one after this round. "
        "Below: what was expected to stay apart between the explanations when each is retuned.",
        zoom=True,
    )


def why_these(plan: Plan) -> str:
    """Why the motions of a round were chosen, in words."""
    names = listed([in_words(name) for name in plan.separates], "and")
    odds = f"{percent(plan.probability)} expected for the right name, {percent(1 / len(plan.separates))} by chance"
    if len(plan.motions) > 1:
        return (
            f"Before any angle was seen, {len(plan.motions)} motions were chosen from the commands and the simulator "
            f"alone, to tell apart {names}: {odds}. The last one repeats the first."
        )
    if plan.undirected:
        return (
            "The last motion did not change the verdict, or none could be designed. This one is of a kind that was not "
            f"recorded yet. It was chosen as the first ones were, to tell apart {names}: {odds}."
        )
    aim = "to put the verdict to the test against" if plan.confirms else "to tell apart"
    said = f"The motion was designed {aim} {names}: {odds}. {plan.looked_at} motions were compared."
    if plan.menu and math.isfinite(plan.menu_gain):
        said += (
            f" It is expected to tell {plan.menu_gain:.1f} times as much per second as the best motion of the menu, "
            f"{in_words(plan.menu)}."
        )
    return said


def _figure(made: Investigated, found: Round, unit: str) -> Figure:
    """Command, angles and expected separation of each motion of a round, a column each."""
    log = RunFolder.open(_diagnosis(made, found)).log()
    motions = made.folder / FIRST if found.number == 1 else _diagnosis(made, made.rounds[found.number - 2]).parent
    names = found.recorded.names
    with new_figure(9.0, 4.6) as figure:
        grid = figure.subplots(3, len(names), sharex="col", sharey="row", height_ratios=(1, 1.6, 0.8), squeeze=False)
        for (command, angle, apart), name in zip(grid.T, names, strict=True):
            own = np.asarray(log["trial"]) == f"{name}.csv"
            t = np.asarray(log["time_s"], dtype=np.float64)[own]
            sent = log.get("command", log.get("command_bar"))
            command.plot(t - t[0], np.asarray(sent)[own], color=COMMAND)
            for column, colour, width, label in _ANGLES:
                angle.plot(t - t[0], np.asarray(log[column])[own], color=colour, lw=width, label=label)
            planned = read_csv(motions / f"{name}.csv")
            apart.plot(planned.t, planned.channels[SEPARATION_COLUMN], color=REFERENCE)
            command.set_title(name.replace("_", " "))
            apart.set_xlabel("time [s]")
        for axes, text in zip(grid[:, 0], (f"command [{unit}]", "tip angle [deg]", "apart [deg]"), strict=True):
            axes.set_ylabel(text)
        figure.legend(*grid[1, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return figure
