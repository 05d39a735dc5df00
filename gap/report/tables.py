"""Tables of a diagnosis: candidates, trials, parameters, confusable pairs, checks."""

from __future__ import annotations

import math
from collections.abc import Iterator

from hystmpc.trials.report import KeyValues, Paragraph, Piece, Table

from ..diagnosis import DetectableSizes, TrackingGap
from .figures import LABEL
from .report_data import STAGES, CandidateRow, ReportData, TrialRuns
from .words import DETECTABLE_COLUMNS, baseline_units, detectable_rows, in_words, percent

NOT_DETERMINED = "not determined"
_SIDES = {"command": "command side", "output": "output side", "sensor": "sensor", "trial": "trial to trial"}


def effects_table(data: ReportData) -> Table:
    """Chosen effects with the closed share of each."""
    rows = [
        (
            in_words(effect.name),
            effect.probability,
            effect.inclusion,
            effect.closed_share,
            _interval(effect.closed_ci90),
            effect.rmse_before_deg,
            effect.rmse_after_deg,
        )
        for effect in data.diagnosis.effects
    ]
    sizes = f"without [{data.unit}]", f"with [{data.unit}]"
    columns = ("effect", "probability", "inclusion", "closed share", "90 % interval", *sizes)
    caption = (
        "Inclusion: share of resamples of the data in which the effect was chosen. Without, with: RMSE on the final "
        "trials, the other chosen effects present."
    )
    return Table(columns, rows, caption)


def candidates_table(data: ReportData) -> Table:
    """Every effect of the library, added alone."""
    sizes = (f"{size} [{data.unit}]" for size in ("RMSE", "gain", "standard error"))
    columns = ("effect", "acts on", *sizes, "probability", "")
    return Table(
        columns,
        [_candidate(row) for row in data.candidates],
        "Each effect alone with the baseline refitted, on the trials to select by; gain: retuned RMSE less this one.",
    )


def tracking_table(tracking: TrackingGap) -> Table:
    """Expected closed-loop errors of every motion and over all of them."""
    rows = [(in_words(m.name), m.before_deg, m.after_deg, m.before_deg - m.after_deg) for m in tracking.motions]
    rows.append(("all motions", tracking.before_deg, tracking.after_deg, tracking.fall_deg))
    caption = (
        "RMS of the true angle less the reference. Over seeds of the noise: "
        f"before {_interval(tracking.before_range_deg)}, after {_interval(tracking.after_range_deg)} deg."
    )
    return Table(("motion", "before [deg]", "after [deg]", "fall [deg]"), rows, caption)


def trials_table(data: ReportData) -> Table:
    """RMSE of every trial; final ones first."""
    rows = sorted(data.trials, key=lambda trial: trial.role != "final")
    sizes = (f"{size} [{data.unit}]" for size in (*(LABEL[stage] for stage in STAGES), "floor"))
    columns = ("trial", "motion", "used to", "s", *sizes)
    return Table(columns, [_trial(row) for row in rows], "RMSE of simulated less measured angle.")


def confusable_table(data: ReportData) -> Table:
    """Effects that these motions can confuse; inseparable ones first."""
    rows = [
        (
            ", ".join(in_words(name) for name in row.effects),
            "one class" if row.one_class else "yes" if row.separable else "no",
            "nothing: equal by algebra" if row.one_class else row.separated_by,
            row.present,
            percent(row.alike_in_sine),
            percent(row.alike_in_hold),
        )
        for row in sorted(data.confusable, key=lambda row: row.separable)
    ]
    columns = ("effects", "told apart by these logs", "by", "found in these logs", "alike in a sine", "ramp and hold")
    caption = (
        "Judged from the commands alone, before any effect was looked for. Alike: share of one effect's gap that the "
        "other reproduces on a single 0.2 Hz sine, and on a ramp with a hold of 8 s."
    )
    return Table(columns, rows, caption)


def detectable_table(sizes: DetectableSizes) -> Table:
    """The least size of each effect that these logs would show."""
    return Table(DETECTABLE_COLUMNS, detectable_rows(sizes), "These logs would show each effect from this size on.")


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


def retuned_table(data: ReportData) -> Table:
    """Baseline quantities before and after the refit."""
    units = baseline_units(data.diagnosis)
    rows = [
        (in_words(name), units[name], given, retuned, "" if given == 0 else f"{100 * (retuned / given - 1):+.1f} %")
        for name, (given, retuned) in data.diagnosis.retuned.items()
    ]
    caption = "Retuning of the simulator, without effects: not an effect."
    return Table(("quantity", "unit", "as given", "retuned", "change"), rows, caption)


def check_pieces(data: ReportData) -> Iterator[Piece]:
    """Excitation by the commands, and the notes of the checks."""
    excitation, unit = data.excitation, data.command_unit
    if excitation is not None:
        speeds = ", ".join(f"{speed:.3g}" for speed in excitation.ramp_speeds)
        rows = {
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
        yield KeyValues(rows)
    for note in data.diagnosis.notes:
        yield Paragraph(note)
    if excitation is None and not data.diagnosis.notes:
        yield Paragraph("The checks found nothing to remark.")


def made_by(data: ReportData, versions: dict[str, str]) -> KeyValues:
    """How the diagnosis was made: simulator, seed, time, versions."""
    roles = [trial.role for trial in data.trials]
    split = ", ".join(f"{roles.count(role)} {role}" for role in dict.fromkeys(roles))
    rows: dict[str, object] = {"simulator": data.simulator, "trials": f"{len(roles)} ({split})"}
    rows["seed"] = data.seed
    if data.seconds:
        parts = ", ".join(f"{in_words(name)} {seconds:.1f}" for name, seconds in data.seconds.items())
        rows["time [s]"] = f"{sum(data.seconds.values()):.1f} ({parts})"
    return KeyValues(rows | dict(versions))


def _candidate(row: CandidateRow) -> tuple[object, ...]:
    numbers = (row.rmse_deg, row.gain_deg, row.standard_error_deg, row.probability)
    return in_words(row.name), _SIDES[row.side], *numbers, "chosen" if row.chosen else ""


def _trial(row: TrialRuns) -> tuple[object, ...]:
    sizes = [row.rmse(stage) for stage in STAGES]
    return row.name, in_words(row.motion), row.role, round(row.trial.duration_s, 1), *sizes, row.floor_deg


def _interval(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.3g} to {ends[1]:.3g}" if all(map(math.isfinite, ends)) else "unknown"
