"""The report of the benchmark."""

from __future__ import annotations

from collections.abc import Iterator

from hystmpc.trials.report import Heading, KeyValues, Paragraph, Piece, Plot, Report

from .control_bars import verdicts
from .control_figures import motion_figure, rmse_figure
from .control_motions import POINT_TO_POINT
from .control_outcome import ControlOutcome
from .control_plants import MISMATCH
from .control_rivals import CONTROLLERS, NETWORK_RATE_HZ, NETWORKS
from .control_settings import ControlSettings
from .control_tables import bars_table, loop_table, preparation_table, runs_table, verdicts_table
from .tables import StudyTable

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


def control_report(outcome: ControlOutcome) -> tuple[Report, list[StudyTable]]:
    """The page and all tables that are written as CSV."""
    judged = verdicts(outcome)
    bars, missed = bars_table(judged), verdicts_table(judged, met=False)
    loops = [loop_table(outcome, plant, rate) for plant, rate in outcome.loops]
    preparation = preparation_table(outcome)
    page = Report(
        "Closed-loop benchmark",
        (
            *_set_up(outcome),
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


def _set_up(outcome: ControlOutcome) -> Iterator[Piece]:
    settings = outcome.settings
    yield Heading("Set-up")
    yield Paragraph(_ABOUT)
    yield KeyValues(
        {
            "plants": ", ".join(settings.plants),
            "rates": ", ".join(f"{rate:g} Hz" for rate in settings.rates_hz),
            "controllers": ", ".join(settings.controllers),
            "motions": ", ".join(settings.motions),
            "left out": _left_out(settings) or "nothing",
            "training": f"networks: {settings.network_updates} updates" + (" (QUICK)" if settings.quick else ""),
            "seed": settings.seed,
            "jobs": f"{len(outcome.results) - len(outcome.failed)} done, {len(outcome.failed)} failed",
            "processor time of all jobs": f"{sum(r.seconds for r in outcome.results) / 60:.1f} min",
            "hystmpc": outcome.meta.get("versions", {}).get("hystmpc"),
            "started": outcome.meta.get("start"),
        }
    )
    if settings.quick:
        yield Paragraph("QUICK: the numbers below show that everything runs, and say nothing about the controllers.")
    for result in outcome.failed:
        yield Paragraph(f"FAILED: {result.job.key}: {result.message}")


def _left_out(settings: ControlSettings) -> str:
    """Networks at rates at which they were not identified."""
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
