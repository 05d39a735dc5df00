"""Page of the report: first the verdict, then all figures and tables in folded sections."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from hystmpc.trials.report import Folded, Heading, KeyValues, Paragraph, Piece, Plot, Points, Report, Table

from ..diagnosis import MOTION_FILE
from ..logs.excitation import confusability
from .figures import (
    LABEL,
    MOST_ROWS,
    before_after_figure,
    bins_figure,
    closed_figure,
    closed_loop_figure,
    effects_figure,
    heat_figure,
    loops,
    memory_figure,
    next_figure,
    over_time,
    share_figure,
    shown,
    spectrum_figure,
    worst_first,
)
from .report_data import STAGES, ReportData
from .words import (
    DETECTABLE_COLUMNS,
    ambiguous_sets,
    baseline_units,
    ceiling_sentence,
    certainty,
    closed_sentence,
    detectable_rows,
    detectable_sentence,
    floor_words,
    headline,
    in_words,
    next_actions,
    next_sentence,
    order_sentences,
    percent,
    stability_sentence,
    tracking_sentence,
    verdict_facts,
)

MOST_HEAT, MOST_LOOPS, MOST_TIMES = 6, 6, 3
NOT_DETERMINED = "not determined"
_SIDES = {"command": "command side", "output": "output side", "sensor": "sensor", "trial": "trial to trial"}


def write_report(data: ReportData, folder: Path | str) -> Path:
    """Write `report.html` into a folder: one page, completely or not at all, that opens offline."""
    return diagnosis_report(data).save(Path(folder) / "report.html")


def diagnosis_report(data: ReportData) -> Report:
    """Page of a diagnosis with any verdict: results and actions, then all details in folded sections."""
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
        rows = [(in_words(m.name), m.before_deg, m.after_deg, m.before_deg - m.after_deg) for m in tracking.motions]
        rows.append(("all motions", tracking.before_deg, tracking.after_deg, tracking.fall_deg))
        yield Table(
            ("motion", "before [deg]", "after [deg]", "fall [deg]"),
            rows,
            "RMS of the true angle less the reference. Over seeds of the noise: "
            f"before {_interval(tracking.before_range_deg)}, after {_interval(tracking.after_range_deg)} deg.",
        )
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
        sizes = f"without [{data.unit}]", f"with [{data.unit}]"
        yield Table(
            ("effect", "probability", "inclusion", "closed share", "90 % interval", *sizes),
            [
                (
                    in_words(effect.name),
                    effect.probability,
                    effect.inclusion,
                    effect.closed_share,
                    _interval(effect.closed_ci90),
                    effect.rmse_before_deg,
                    effect.rmse_after_deg,
                )
                for effect in diagnosis.effects
            ],
            "Inclusion: share of resamples of the data in which the effect was chosen. Without, with: RMSE on the "
            "final trials, the other chosen effects present.",
        )


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
    yield Table(("motion", "duration [s]", "probability, equations exact", "what it shows"), rows, "The whole menu.")


def _numbers(data: ReportData) -> Iterator[Piece]:
    yield trials_table(data)
    if data.diagnosis.retuned:
        units = baseline_units(data.diagnosis)
        rows = [
            (in_words(name), units[name], given, retuned, "" if given == 0 else f"{100 * (retuned / given - 1):+.1f} %")
            for name, (given, retuned) in data.diagnosis.retuned.items()
        ]
        columns = ("quantity", "unit", "as given", "retuned", "change")
        yield Table(columns, rows, "Retuning of the simulator, without effects: not an effect.")
    if data.parameters:
        yield parameters_table(data)
    if data.candidates:
        sizes = (f"{size} [{data.unit}]" for size in ("RMSE", "gain", "standard error"))
        yield Table(
            ("effect", "acts on", *sizes, "probability", ""),
            [
                (
                    in_words(row.name),
                    _SIDES[row.side],
                    row.rmse_deg,
                    row.gain_deg,
                    row.standard_error_deg,
                    row.probability,
                    "chosen" if row.chosen else "",
                )
                for row in data.candidates
            ],
            "Each effect alone with the baseline refitted, on the trials to select by; gain: retuned RMSE less this "
            "one.",
        )


def trials_table(data: ReportData) -> Table:
    """RMSE of every trial; final ones first."""
    rows = [
        (
            trial.name,
            in_words(trial.motion),
            trial.role,
            round(trial.trial.duration_s, 1),
            *(trial.rmse(stage) for stage in STAGES),
            trial.floor_deg,
        )
        for trial in sorted(data.trials, key=lambda trial: trial.role != "final")
    ]
    sizes = (f"{size} [{data.unit}]" for size in (*(LABEL[stage] for stage in STAGES), "floor"))
    return Table(("trial", "motion", "used to", "s", *sizes), rows, "RMSE of simulated less measured angle.")


def parameters_table(data: ReportData) -> Table:
    """Identified values and whether the logs determine them."""
    rows = []
    for row in data.parameters:
        neutral = "" if row.neutral is None else row.neutral
        value = NOT_DETERMINED if row.flat else row.value
        remark = "at a bound" if row.at_bound else ""
        rows.append((in_words(row.owner), row.name, row.unit, value, _interval(row.ci90), neutral, remark))
    columns = ("of", "parameter", "unit", "value", "90 % interval", "no effect at", "remark")
    caption = (
        "Parameters of the corrected simulator; unit 1: a plain number. Not determined: the interval is wider than "
        "half of the range in which the number was looked for, or than a factor of three either way."
    )
    return Table(columns, rows, caption)


def _checks(data: ReportData) -> Iterator[Piece]:
    excitation, unit = data.excitation, data.command_unit
    speeds = ", ".join(f"{speed:.3g}" for speed in excitation.ramp_speeds)
    yield KeyValues(
        {
            "motions": ", ".join(dict.fromkeys(in_words(motion) for motion in excitation.motions)),
            "pairs of repeats": len(excitation.repeats),
            "opening motion repeated": "yes" if excitation.opening_repeated else "no",
            "longest hold": f"{excitation.longest_hold_s:.1f} s",
            "fastest command": f"{excitation.fastest:.3g} {unit}/s",
            "constant speeds": f"{speeds} {unit}/s" if speeds else "none",
            "fast steps": excitation.steps,
            "small moves above 1.5 Hz": excitation.fast_small,
            "time near the lowest command": f"{excitation.low_s:.1f} s in {excitation.low_visits} visits",
            "levels of turning near the top": excitation.top_levels,
        }
    )
    yield from map(Paragraph, data.diagnosis.notes)


def _detectable(data: ReportData) -> Iterator[Piece]:
    if (sizes := data.diagnosis.detectable) is not None:
        yield Paragraph(detectable_sentence(sizes))
        if sizes.effects:
            caption = "These logs would show each effect from this size on."
            yield Table(DETECTABLE_COLUMNS, detectable_rows(sizes), caption)


def _cannot_show(data: ReportData) -> Iterator[Piece]:
    confusable = confusability(data.excitation)
    columns = ("effects", "told apart by these logs", "by", "found in these logs", "alike in a sine", "ramp and hold")
    yield Table(
        columns,
        [
            (
                ", ".join(in_words(name) for name in row.effects),
                "one class" if row.one_class else "yes" if row.separable else "no",
                "nothing: equal by algebra" if row.one_class else row.separated_by,
                row.present,
                percent(row.alike_in_sine),
                percent(row.alike_in_hold),
            )
            for row in sorted(confusable, key=lambda row: row.separable)
        ],
        "Judged from the commands alone, before any effect was looked for. Alike: share of one effect's gap that the "
        "other reproduces on a single 0.2 Hz sine, and on a ramp with a hold of 8 s.",
    )
    for row in confusable:
        if not row.separable and not row.one_class:
            names = " and ".join(in_words(name) for name in row.effects)
            sentence = f"{names[:1].upper()}{names[1:]} cannot be told apart ({row.present})"
            yield Paragraph(f"{sentence}; {row.separated_by} would do it.")


def _made(data: ReportData) -> Iterator[Piece]:
    roles = [trial.role for trial in data.trials]
    split = ", ".join(f"{roles.count(role)} {role}" for role in dict.fromkeys(roles))
    rows: dict[str, object] = {"simulator": data.simulator, "trials": f"{len(roles)} ({split})", "seed": data.seed}
    if data.seconds:
        parts = ", ".join(f"{in_words(name)} {seconds:.1f}" for name, seconds in data.seconds.items())
        rows["time [s]"] = f"{sum(data.seconds.values()):.1f} ({parts})"
    for package in ("hystmpc", "numpy", "scipy"):
        with suppress(PackageNotFoundError):
            rows[package] = version(package)
    yield KeyValues(rows)


def _interval(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.3g} to {ends[1]:.3g}" if all(map(math.isfinite, ends)) else "unknown"


_SECTIONS: tuple[tuple[str, Callable[[ReportData], Iterator[Piece]]], ...] = (
    ("How large the gap is: error of every final trial, and the floor", _sizes),
    ("What the controller gains: tracking error before and after", _closed_loop),
    ("Which effect: probability, gain and closed share of each", _which),
    ("Where the gap lies: by time, part of the motion, command, frequency and memory", _where),
    ("What to record next: the motion, and what each explanation expects of it", _next),
    ("Numbers: every trial, retuning, parameters, candidates", _numbers),
    ("Checks of the logs, and notes", _checks),
    ("What these logs would show: the least size of each effect", _detectable),
    ("What these logs cannot tell apart", _cannot_show),
    ("How it was made: simulator, seed, time, versions", _made),
)
