"""Page of the report: the verdict on one page, and folded behind it all figures and tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from hystmpc.trials.report import Folded, Heading, Paragraph, Piece, Plot, Points, Report, Table

from ..next.motion_design import MOTION_FILE
from .figures import (
    LABEL,
    MOST_ROWS,
    closed_figure,
    closed_loop_figure,
    effects_figure,
    next_figure,
    shown,
    worst_first,
)
from .first_page import certainty, next_actions, verdict_facts
from .report_data import ReportData
from .residual_figures import (
    before_after_figure,
    bins_figure,
    heat_figure,
    loops,
    memory_figure,
    over_time,
    share_figure,
    spectrum_figure,
)
from .tables import (
    candidates_table,
    check_pieces,
    confusable_table,
    detectable_table,
    effects_table,
    made_by,
    parameters_table,
    retuned_table,
    tracking_table,
    trials_table,
)
from .words import (
    ambiguous_sets,
    ceiling_sentence,
    closed_sentence,
    detectable_sentence,
    floor_words,
    headline,
    in_words,
    next_sentence,
    order_sentences,
    percent,
    stability_sentence,
    tracking_sentence,
)

MOST_HEAT, MOST_LOOPS, MOST_TIMES = 6, 6, 3


def write_report(data: ReportData, folder: Path | str) -> Path:
    """Write `report.html` into a folder: one page, whole or not at all, that opens offline."""
    return diagnosis_report(data).save(Path(folder) / "report.html")


def diagnosis_report(data: ReportData) -> Report:
    """The page of a diagnosis, whatever its verdict: what to know and to do, then everything else, folded."""
    folded = (Folded(heading, tuple(made(data))) for heading, made in _SECTIONS)
    pieces = (*_first_page(data), *(section for section in folded if section.pieces))
    subtitle = f"simulator {data.simulator}, {len(data.trials)} logs"
    return Report("Sim-to-real gap", pieces, subtitle)


def _first_page(data: ReportData) -> Iterator[Piece]:
    diagnosis = data.diagnosis
    yield Heading(headline(diagnosis))
    blocks = {
        "Why": verdict_facts(diagnosis),
        "What to do next": next_actions(data),
        "How sure it is": certainty(diagnosis),
    }
    for heading, sentences in blocks.items():
        if sentences:
            yield Heading(heading, 3)
            yield Points(sentences)
    worst, after = worst_first(data.final)[0], data.stages[-1]
    yield Heading("Measured angle and simulated angle, before and after the correction", 3)
    yield Plot(
        before_after_figure(worst, after),
        f"{worst.name}, the one of the {data.measured_on} with the largest error. Its RMSE is "
        f"{worst.rmse('nominal'):.3g} {data.unit} {LABEL['nominal']} and {worst.rmse(after):.3g} {data.unit} "
        f"{LABEL[after]}.",
        zoom=True,
    )


def _sizes(data: ReportData) -> Iterator[Piece]:
    diagnosis = data.diagnosis
    yield Paragraph(diagnosis.reason)
    for sentence in (closed_sentence(diagnosis), stability_sentence(diagnosis), *order_sentences(diagnosis)):
        if sentence:
            yield Paragraph(sentence)
    left_out = len(data.final) - MOST_ROWS
    yield Plot(
        closed_figure(data),
        f"RMSE on the {data.measured_on}, with 90 % intervals over blocks of 2 s. "
        + floor_words(diagnosis.gap, diagnosis.unit)
        + (f" {left_out} further {data.measured_on} are in the table below." if left_out > 0 else ""),
    )


def _closed_loop(data: ReportData) -> Iterator[Piece]:
    tracking = data.diagnosis.tracking
    if tracking is None:
        return
    yield Paragraph(tracking_sentence(data.diagnosis))
    if tracking.motions:
        yield tracking_table(tracking)
    if data.curves:
        yield Plot(
            closed_loop_figure(data.curves),
            "Simulated on the corrected simulator with the noise of its file. Before: the controller's model is "
            "the simulator as given. After: it is the corrected one. Grey: the approach, which does not count.",
            zoom=True,
        )


def _which(data: ReportData) -> Iterator[Piece]:
    diagnosis = data.diagnosis
    if diagnosis.ranking or diagnosis.effects:
        yield Plot(
            effects_figure(data),
            "Left: calibrated probability. Middle: held-out gain of each effect alone, with two standard errors. "
            "Right: share of the structural gap that each chosen effect closes on the final trials, with its 90 % "
            "interval; letters mark sets that these trials cannot tell apart.",
        )
    else:
        yield Paragraph("No effect was weighed.")
    for letter, words in zip("ABCDEFGHIJ", ambiguous_sets(diagnosis), strict=False):
        yield Paragraph(
            f"Set {letter}: {words}. With these trials each explains the gap as well as the others within its "
            "uncertainty; the data do not say which."
        )
    if diagnosis.effects:
        yield effects_table(data)


def _where(data: ReportData) -> Iterator[Piece]:
    unit, final, after = data.command_unit, data.final, data.stages[1:]
    heat = shown(data.trials, MOST_HEAT)
    rest = len(data.trials) - len(heat)
    more = f" Drawn are the final trials and the worst others; {rest} more are in the table below." if rest else ""
    yield Plot(heat_figure(heat, unit, after), f"Above: command. Below: size of the residual along the motion.{more}")
    if data.diagnosis.where:
        yield Plot(
            share_figure(data.diagnosis.where),
            "Share of the retuned residual's energy in each part of the motion. Where the bar passes the share of time "
            "the gap is dense. The parts exclude each other; after reversal: within one loop width of the last turn.",
        )
    of = data.measured_on
    what = "Tip angle" if data.unit == "deg" else "Output"
    yield Plot(loops(shown(final, MOST_LOOPS), unit, after), f"{what} over command, real and simulated: {of}.")
    worst = worst_first(final)[:MOST_TIMES]
    yield Plot(over_time(worst, after), f"{what} and residual over time: the {of} with the largest gap.", zoom=True)
    bins = bins_figure(final, after)
    if bins is not None:
        yield Plot(bins, "RMSE by command, angle and speed of the command; grey: share of time, of the whole height.")
    yield from _memory_and_spectrum(data)
    if ceiling := ceiling_sentence(data.diagnosis):
        yield Paragraph(ceiling)


def _memory_and_spectrum(data: ReportData) -> Iterator[Piece]:
    localisation = data.localisation
    lines = () if localisation is None else localisation.spectrum.lines
    caption = f"Residual over frequency, {data.measured_on}; at the noise nothing is left to explain."
    if localisation is not None:
        coherent = percent(localisation.spectrum.coherent)
        caption += f" Linear in the command: {coherent} of the retuned residual's energy."
    if lines:
        at = ", ".join(f"{line.hz:.2f} Hz ({percent(line.share)} of the energy)" for line in lines)
        caption += f" Lines that the command does not have: {at}."
    yield Plot(spectrum_figure(data.final, data.stages[1:], data.noise_deg, lines), caption)
    if localisation is not None and localisation.memory:
        text = "What each memory of the command predicts of the residual. It proposes a cause and decides nothing."
        yield Plot(memory_figure(localisation.memory), text)


def _next(data: ReportData) -> Iterator[Piece]:
    proposal = data.proposal
    if proposal is None:
        return
    yield Paragraph(next_sentence(proposal))
    yield Plot(
        next_figure(proposal, data.command_unit, data.unit),
        f"{MOTION_FILE}: command within limits and rate limit, from rest to rest at the lowest command. Middle: what "
        "each candidate expects. Below: what stays apart when each is retuned to the other.",
    )
    rows = [
        (in_words(option.motion.name), option.motion.duration_s, option.probability, option.motion.purpose)
        for option in sorted(proposal.options, key=lambda option: -option.probability)
    ]
    yield Table(("motion", "duration [s]", "expected probability", "what it shows"), rows, "The whole menu.")


def _numbers(data: ReportData) -> Iterator[Piece]:
    yield trials_table(data)
    if data.diagnosis.retuned:
        yield retuned_table(data)
    if data.parameters:
        yield parameters_table(data)
    if data.candidates:
        yield candidates_table(data)


def _detectable(data: ReportData) -> Iterator[Piece]:
    if (sizes := data.diagnosis.detectable) is not None:
        yield Paragraph(detectable_sentence(sizes))
        if sizes.effects:
            yield detectable_table(sizes)


def _cannot_show(data: ReportData) -> Iterator[Piece]:
    if data.confusable:
        yield confusable_table(data)
    for sentence in data.cannot_show:
        yield Paragraph(sentence)
    if not data.confusable and not data.cannot_show:
        yield Paragraph("Nothing was found that these motions leave hidden.")


def _made(data: ReportData) -> Iterator[Piece]:
    yield made_by(data, _versions())


_SECTIONS: tuple[tuple[str, Callable[[ReportData], Iterator[Piece]]], ...] = (
    ("How large the gap is: error of every final trial, and the floor", _sizes),
    ("What the controller gains: tracking error before and after", _closed_loop),
    ("Which effect: probability, gain and closed share of each", _which),
    ("Where the gap lies: by time, part of the motion, command, frequency and memory", _where),
    ("What to record next: the motion, and what each explanation expects of it", _next),
    ("Numbers: every trial, retuning, parameters, candidates", _numbers),
    ("Checks of the logs, and notes", check_pieces),
    ("What these logs would show: the least size of each effect", _detectable),
    ("What these logs cannot tell apart", _cannot_show),
    ("How it was made: simulator, seed, time, versions", _made),
)


def _versions() -> dict[str, str]:
    versions = {}
    for package in ("hystmpc", "numpy", "scipy"):
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return versions
