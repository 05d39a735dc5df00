"""Report of the benchmark: tables, figures, page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hystmpc.trials.report import COMMAND, MEASURED, MODEL, PALETTE, REFERENCE, Heading, Piece, Plot, Report, new_figure

from ..page import NOTHING, Cell, StudyTable, cell, set_up
from .bars import BARS, BarVerdict, ControlOutcome, verdicts
from .loop import load_signals
from .plants import MISMATCH
from .settings import (
    CONTROLLERS,
    NETWORK_RATE_HZ,
    NETWORKS,
    ORACLE,
    POINT_TO_POINT,
    SCANS_HZ,
    ControlResult,
    ControlSettings,
)

_RUN_COLUMNS = (
    "RMSE [deg]",
    "max [deg]",
    "hold error [deg]",
    "hold range [half-widths]",
    "before the next move shows",
    "holds cycling",
    "travel [mm]",
    "beyond limits",
    "ladder",
    "late steps (not judged)",
    "over oracle",
    "over best of PID, inverse, both",
)
_FIGURES = (
    "rmse_deg",
    "max_deg",
    "hold_error_deg",
    "hold_range",
    "rest_range",
    "cycling_holds",
    "travel",
    "violations",
    "fallbacks",
    "late_share",
)
_MARKS = "osD^vP"
_WANTED: Any = {"color": REFERENCE, "linewidth": 2.4, "alpha": 0.45}
_SCAN = "scan_0p25hz"
_ABOUT = f"""Simulated tendon catheters. On a plant without "-off" models were identified on the very device; on one
with it every parameter of the device, lag and delay included, is {MISMATCH} times what the models know. The gains of
PID and of inverse with PID are searched on the very plant and motions with another realisation of the noise: the
strongest opponents of their kind, not forecasts. All controllers are told of the nominal delay, those with a backlash
as model of the nominal lag too; networks have learned it. The oracle is the linearised MPC with the same settings,
whose model is the plant with lag, delay, creep and memory; oracle_trusting also knows that its model is exact and lets
no noise in. Bars on ratios are for every model that is not exactly its plant, or whose plant has lag, delay or noise.
"Range of a held command" counts the crossing of the dead band by which a controller with preview prepares the next
move; beside it stands the range before that move shows."""


def bars_table(verdicts: Sequence[BarVerdict]) -> StudyTable:
    """Table of each bar: number of controllers and plants in its scope that meet it."""
    rows: list[list[Cell]] = []
    for bar in BARS:
        about = [verdict for verdict in verdicts if verdict.bar == bar.name]
        if not about:
            rows.append([bar.name, bar.limit, 0, 0, NOTHING, NOTHING, "not judged: nothing was run that it is about"])
            continue
        met = sum(verdict.met for verdict in about)
        worst = max(about, key=lambda verdict: verdict.worst)
        where = f"{worst.controller} on {worst.plant} at {worst.rate_hz:g} Hz, {worst.motion}"
        rows.append([bar.name, bar.limit, met, len(about), worst.worst, where, _word(met == len(about))])
    columns = ("bar", "at most", "loops that meet it", "loops judged", "worst", "where", "verdict")
    caption = "Simulated: the bars; a loop is a controller on a plant at a rate, and meets a bar on all its motions."
    return StudyTable("bars", columns, rows, caption)


def verdicts_table(verdicts: Sequence[BarVerdict], met: bool | None = None) -> StudyTable:
    """Table of every bar on every loop, or only those met or missed."""
    rows: list[list[Cell]] = [
        [v.bar, v.limit, v.plant, v.rate_hz, v.controller, f"{v.within} of {v.judged}", v.worst, v.motion, _word(v.met)]
        for v in verdicts
        if met is None or v.met == met
    ]
    columns = ("bar", "at most", "plant", "rate [Hz]", "controller", "motions within", "worst", "motion", "verdict")
    name = "verdicts" if met is None else "verdicts_met" if met else "verdicts_missed"
    return StudyTable(name, columns, rows, "Simulated: every bar on every loop that it is about.")


def loop_table(outcome: ControlOutcome, plant: str, rate_hz: float) -> StudyTable:
    """Table of one plant at one rate, a row for each controller: means, or maxima, over its motions."""
    rows: list[list[Cell]] = []
    for controller in outcome.settings.controllers:
        runs = [run for run in outcome.runs if _is(run, plant, rate_hz, controller)]
        if not runs:
            continue
        scans = [run for run in runs if run.job.motion in SCANS_HZ]
        others = [run for run in runs if run.job.motion not in SCANS_HZ]
        over = [_mean(map(ratio, runs)) for ratio in (outcome.over_oracle, outcome.over_baseline)]
        rows.append(
            [
                controller,
                _mean(run.figures["rmse_deg"] for run in others),
                _mean(run.figures["rmse_deg"] for run in scans),
                _worst(run.figures["max_deg"] for run in runs),
                _mean(run.figures["hold_error_deg"] for run in runs),
                _worst(run.figures["hold_range"] for run in runs),
                _worst(run.figures["rest_range"] for run in runs),
                _mean(run.figures["cycling_holds"] for run in runs),
                _mean(run.figures["travel"] for run in runs),
                int(sum(run.figures["violations"] for run in runs)),
                int(sum(run.figures["fallbacks"] for run in runs)),
                *over,
            ]
        )
    columns = ("controller", "RMSE point to point [deg]", "RMSE scans [deg]", *_RUN_COLUMNS[1:9], *_RUN_COLUMNS[10:])
    caption = f"Simulated: {plant} at {rate_hz:g} Hz, means over motions; max and hold ranges are the greatest."
    return StudyTable(f"{plant}_{rate_hz:g}hz", columns, rows, caption)


def runs_table(outcome: ControlOutcome) -> StudyTable:
    """Table of every run, for CSV only."""
    rows: list[list[Cell]] = [
        [
            *(run.job.plant, run.job.rate_hz, run.job.subject, run.job.motion),
            *(cell(run.figures[name]) for name in _FIGURES),
            cell(outcome.over_oracle(run)),
            cell(outcome.over_baseline(run)),
            "; ".join(f"{source} {count}" for source, count in run.ladder.items()),
        ]
        for run in outcome.runs
    ]
    columns = ("plant", "rate [Hz]", "controller", "motion", *_RUN_COLUMNS, "samples by source")
    return StudyTable("runs", columns, rows, "", shown=False)


def preparation_table(outcome: ControlOutcome) -> StudyTable:
    """Table of models and gains with the result of their identification or search."""
    rows: list[list[Cell]] = [
        [
            r.job.stage,
            r.job.plant,
            cell(r.job.rate_hz or math.nan),
            r.job.subject,
            round(r.seconds, 1),
            r.status,
            r.message,
        ]
        for r in outcome.results
        if r.job.stage != "run"
    ]
    columns = ("stage", "plant", "rate [Hz]", "what", "time [s]", "status", "how")
    return StudyTable("preparation", columns, rows, "Models, identified on the nominal plant, and gains of the PIDs.")


def _is(run: ControlResult, plant: str, rate_hz: float, controller: str) -> bool:
    return (run.job.plant, run.job.rate_hz, run.job.subject) == (plant, rate_hz, controller)


def _word(met: bool) -> str:
    return "met" if met else "MISSED"


def _mean(values: Iterable[float]) -> Cell:
    known = [value for value in values if not math.isnan(value)]
    return float(np.mean(known)) if known else NOTHING


def _worst(values: Iterable[float]) -> Cell:
    return max((value for value in values if not math.isnan(value)), default=NOTHING)


def rmse_figure(outcome: ControlOutcome, rate_hz: float) -> Figure:
    """Plot of the RMSE of every run: a panel for each plant, a row for each controller, a mark for each motion."""
    plants = [plant for plant, rate in outcome.loops if rate == rate_hz]
    names = [name for name in outcome.settings.controllers if CONTROLLERS[name].usable_at(rate_hz)]
    lines = -(-len(plants) // 2)
    with new_figure(7.0, 0.7 + lines * (0.7 + 0.17 * len(names))) as figure:
        grid = figure.subplots(lines, 2, sharex=True, sharey=True, squeeze=False).ravel()
        for axes, plant in zip(grid, plants, strict=False):
            for k, motion in enumerate(outcome.settings.motions):
                runs = [outcome.by_name.get((plant, rate_hz, name, motion)) for name in names]
                x = [run.figures["rmse_deg"] if run else np.nan for run in runs]
                style: Any = {"linestyle": "none", "marker": _MARKS[k % len(_MARKS)], "markersize": 4.0}
                axes.plot(x, range(len(names)), color=PALETTE[k % len(PALETTE)], label=motion, alpha=0.85, **style)
            axes.set(xscale="log", title=plant, ylim=(len(names) - 0.5, -0.5))
            axes.set_yticks(range(len(names)), names)
        for axes in grid[len(plants) :]:
            axes.remove()
        figure.supxlabel("RMSE of the true angle [deg]", fontsize=9.0)
        figure.legend(*grid[0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def motion_figure(outcome: ControlOutcome, plant: str, rate_hz: float, motion: str) -> Figure | None:
    """Plot of angle, error and command along one motion: oracle, best baseline, best predictive controllers."""
    runs = _chosen(outcome, plant, rate_hz, motion)
    if not runs:
        return None
    colour = _colours(runs)
    with new_figure(7.0, 5.4) as figure:
        angle, error, command = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
        for k, run in enumerate(runs):
            signals = load_signals(outcome.folder, run.job)
            t, reference = signals["time_s"], signals["reference_deg"]
            if k == 0:
                angle.plot(t, reference, label="reference", **_WANTED)
            style: Any = {"color": colour[run.job.subject], "linewidth": 0.9}
            angle.plot(t, signals["true_deg"], label=run.job.subject, **style)
            error.plot(t, signals["true_deg"] - reference, **style)
            command.step(t, signals["command"], where="pre", **style)
        error.axhline(0.0, color=REFERENCE, linewidth=0.6)
        angle.set_ylabel("tip angle [deg]")
        error.set_ylabel("error [deg]")
        command.set(xlabel="time [s]", ylabel="command [mm]")
        figure.legend(*angle.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def _chosen(outcome: ControlOutcome, plant: str, rate_hz: float, motion: str) -> Sequence[ControlResult]:
    """Best baseline, best controller of each predictive kind, and the oracle."""
    here = [run for run in outcome.runs if (run.job.plant, run.job.rate_hz, run.job.motion) == (plant, rate_hz, motion)]
    groups: dict[str, ControlResult] = {}
    for run in sorted(here, key=lambda run: run.figures["rmse_deg"]):
        rival = CONTROLLERS[run.job.subject]
        if rival.oracle and rival.name != ORACLE:
            continue
        group = "oracle" if rival.oracle else rival.kind if rival.predictive else "baseline"
        groups.setdefault(group, run)
    order = ("baseline", "linearised_mpc", "sampling_mpc", "oracle")
    return [groups[name] for name in order if name in groups]


def _colours(runs: Sequence[ControlResult]) -> Mapping[str, str]:
    known = (PALETTE[5], MEASURED, MODEL, COMMAND)
    return {run.job.subject: known[k % len(known)] for k, run in enumerate(runs)}


def control_report(outcome: ControlOutcome) -> tuple[Report, list[StudyTable]]:
    """Page of the study, and all tables that are written as CSV."""
    judged = verdicts(outcome)
    bars, missed = bars_table(judged), verdicts_table(judged, met=False)
    loops = [loop_table(outcome, plant, rate) for plant, rate in outcome.loops]
    preparation, settings = preparation_table(outcome), outcome.settings
    facts = {
        "plants": ", ".join(settings.plants),
        "rates": ", ".join(f"{rate:g} Hz" for rate in settings.rates_hz),
        "controllers": ", ".join(settings.controllers),
        "motions": ", ".join(settings.motions),
        "left out": _left_out(settings) or "nothing",
        "training": f"networks: {settings.network_updates} updates" + (" (QUICK)" if settings.quick else ""),
    }
    page = Report(
        "Closed-loop benchmark",
        (
            *set_up(_ABOUT, facts, outcome),
            Heading("Bars"),
            bars.piece,
            Heading("Bars missed", 3),
            missed.piece,
            *_figures(outcome),
            Heading("Controllers, plant by plant"),
            *(table.piece for table in loops),
            Heading("Models and gains"),
            preparation.piece,
        ),
        "simulated plants, every controller along every motion",
    )
    return page, [bars, missed, verdicts_table(judged), *loops, runs_table(outcome), preparation]


def _left_out(settings: ControlSettings) -> str:
    """Networks left out at rates other than that of their identification."""
    names = [name for name in settings.controllers if CONTROLLERS[name].model in NETWORKS]
    rates = [f"{rate:g} Hz" for rate in settings.rates_hz if rate != NETWORK_RATE_HZ]
    if not (names and rates):
        return ""
    return (
        f"{', '.join(names)} at {', '.join(rates)}: a network holds at the sample time at which it was identified "
        f"({NETWORK_RATE_HZ:g} Hz); trials of the same length have as many times more samples, and training takes hours"
    )


def _figures(outcome: ControlOutcome) -> Iterator[Piece]:
    yield Heading("Errors")
    for rate in outcome.settings.rates_hz:
        if any(rate == other for _, other in outcome.loops):
            yield Plot(rmse_figure(outcome, rate), f"Simulated, {rate:g} Hz: RMSE of every run.")
    yield Heading("Motions")
    for plant, rate in outcome.loops:
        for motion in (POINT_TO_POINT, _SCAN):
            figure = motion_figure(outcome, plant, rate, motion)
            if figure is not None:
                yield Plot(
                    figure, f"Simulated: {motion} on {plant} at {rate:g} Hz, the best of each sort and the oracle."
                )
