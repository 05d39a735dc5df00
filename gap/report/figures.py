"""Figures of a diagnosis: closed gap, effects, next motion, closed loops, and the residual over time and frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy.signal import welch

from hystmpc.models.identify.uncertainty import Interval
from hystmpc.trials.figure_data import draw_part
from hystmpc.trials.figures import (
    ZERO_LOOK,
    LoopPanel,
    SimulatedTrial,
    TrackedLine,
    TrackedMotion,
    loop_figure,
    output_label,
    shortened,
    time_figure,
    tracking_figure,
)
from hystmpc.trials.report import ACCENTS, COMMAND, DASHES, MEASURED, MODEL, PALETTE, REFERENCE, new_figure
from hystmpc.trials.types import Vec

from ..diagnosis import Diagnosis, ResidualShare
from ..next.motion_design import MotionProposal
from ..residual import SpectralLine
from .report_data import CandidateRow, ReportData, Stage, TrackingCurve, TrialRuns
from .words import in_words

LABEL: dict[Stage, str] = {"nominal": "as given", "retuned": "retuned", "with_effects": "with effects"}
COLOUR: dict[Stage, str] = {"nominal": "#a6a6a6", "retuned": ACCENTS[2], "with_effects": MODEL}
_DASH: dict[Stage, Any] = {"nominal": DASHES[0], "retuned": DASHES[2], "with_effects": DASHES[1]}
LOOK: dict[Stage, Any] = {
    stage: {"color": COLOUR[stage], "linestyle": dash, "label": LABEL[stage]} for stage, dash in _DASH.items()
}
MARKER: dict[Stage, str] = {"nominal": "s", "retuned": "o", "with_effects": "D"}
REAL: Any = {"color": MEASURED, "linewidth": 2.6, "alpha": 0.5, "label": "measured"}
COMMANDED: Any = {"color": COMMAND, "linewidth": 0.9}
INTERVAL: Any = {"color": REFERENCE, "linewidth": 1.1, "capsize": 2.5, "capthick": 1.1, "fmt": "none"}
BEFORE: Any = {"color": ACCENTS[2], "linewidth": 1.0, "linestyle": DASHES[1], "label": "before"}
AFTER: Any = {"color": MODEL, "linewidth": 1.0, "label": "after"}
HEAT = "magma_r"  # even steps of lightness: also read in grey and by colour-blind readers
_POINTS = 3000


def worst_first(trials: Sequence[TrialRuns]) -> list[TrialRuns]:
    """Trials sorted by their retuned RMSE, greatest first."""
    return sorted(trials, key=lambda trial: -trial.rmse("retuned"))


def shown(trials: Sequence[TrialRuns], most: int) -> list[TrialRuns]:
    """Select at most `most` trials, final ones and large errors preferred, in recording order."""
    ranked = sorted(worst_first(trials), key=lambda trial: trial.role != "final")[:most]
    return [trial for trial in trials if any(trial is other for other in ranked)]


def thin(*signals: Vec) -> tuple[Vec, ...]:
    """Reduce signals of one length to the number of samples that a figure can show."""
    step = max(1, -(-signals[0].size // _POINTS))
    return tuple(signal[::step] for signal in signals)


_BLOCK_S, _LEAST_BLOCKS = 2.0, 4
_DRAWS = 400

MOST_EFFECTS = 10
_CHOSEN, _AMBIGUOUS, _OTHER = MODEL, ACCENTS[2], "#c4c4c4"

MOST_ROWS = 10
_OFFSET = {"nominal": -0.22, "retuned": 0.0, "with_effects": 0.22}

_DASHES = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (6, 1, 1, 1)), (0, (3, 1, 1, 1, 1, 1)))
_COLOURS = (PALETTE[0], PALETTE[1], PALETTE[3], PALETTE[5], PALETTE[4])


def draw_interval(axes: Axes, row: float, value: float, interval: Interval, **style: Any) -> None:
    """Draw the interval of a value along its row."""
    reach = [[max(value - interval[0], 0.0)], [max(interval[1] - value, 0.0)]]
    axes.errorbar(value, row, xerr=reach, **{**INTERVAL, **style})


def closed_figure(data: ReportData) -> Figure:
    """Draw the RMSE of every final trial and of all together, with 90 % intervals and the floor [deg]."""
    trials = shown(data.final, MOST_ROWS)
    gap, rows = data.diagnosis.gap, len(trials) + 1
    with new_figure(7.0, 1.1 + 0.42 * rows) as figure:
        axes: Axes = figure.subplots()
        for stage in data.stages:
            values = [getattr(gap, f"{stage}_rmse_deg"), *(trial.rmse(stage) for trial in trials)]
            groups: list[Sequence[TrialRuns]] = [data.final, *([trial] for trial in trials)]
            _points(axes, stage, values, [rmse_interval(group, stage) for group in groups])
        floors = [gap.floor_rmse_deg, *(trial.floor_deg for trial in trials)]
        axes.plot(floors, np.arange(rows), "|", color=REFERENCE, markersize=17, markeredgewidth=1.6, label="floor")
        names = [f"all {data.measured_on}", *(shortened(trial.name) for trial in trials)]
        axes.set_yticks(range(rows), names)
        axes.get_yticklabels()[0].set_fontweight("bold")
        axes.axhline(0.5, color=REFERENCE, linewidth=0.6)
        axes.set(ylim=(rows - 0.5, -0.5), xlabel=f"RMSE of simulated less measured angle [{data.unit}]")
        axes.set_xlim(left=0.0)
        axes.grid(visible=False, axis="y")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def _points(axes: Axes, stage: Stage, values: list[float], intervals: list[Interval | None]) -> None:
    rows = np.arange(len(values)) + _OFFSET[stage]
    for row, value, interval in zip(rows, values, intervals, strict=True):
        if interval is not None and np.isfinite(value):
            draw_interval(axes, row, value, interval, zorder=2, color=COLOUR[stage])
    style: Any = {"color": COLOUR[stage], "marker": MARKER[stage], "linestyle": "none", "markersize": 5.5}
    axes.plot(values, rows, label=LABEL[stage], zorder=3, **style)


def rmse_interval(trials: Sequence[TrialRuns], stage: Stage) -> Interval | None:
    """90 % block-bootstrap interval of the RMSE over some trials [deg]; None for fewer than four blocks of 2 s."""
    sums, counts = _blocks(trials, stage)
    if sums.size < _LEAST_BLOCKS:
        return None
    draws = np.random.default_rng(0).integers(0, sums.size, (_DRAWS, sums.size))
    values = np.sqrt(sums[draws].sum(axis=1) / counts[draws].sum(axis=1))
    low, high = np.quantile(values, (0.05, 0.95))
    return float(low), float(high)


def _blocks(trials: Sequence[TrialRuns], stage: Stage) -> tuple[Vec, Vec]:
    """Sum of squares [deg^2] and number of samples of every block."""
    sums, counts = list[float](), list[float]()
    for trial in trials:
        squares = trial.residual(stage) ** 2
        length = max(1, round(_BLOCK_S / trial.trial.dt))
        for block in np.array_split(squares, max(1, squares.size // length)):
            sums.append(float(block.sum()))
            counts.append(float(block.size))
    return np.array(sums), np.array(counts)


def effects_figure(data: ReportData) -> Figure:
    """Draw the candidates by probability, with emphasis on chosen and indistinguishable ones."""
    diagnosis, rows = data.diagnosis, {row.name: row for row in data.candidates}
    names = _names(diagnosis)
    with new_figure(7.0, 1.0 + 0.29 * len(names)) as figure:
        chance, gain, closed = figure.subplots(1, 3, sharey=True, width_ratios=(3, 3, 3))
        _probabilities(chance, diagnosis, names)
        _gains(gain, [rows.get(name) for name in names], data.unit)
        _shares(closed, diagnosis, names)
        chance.set_yticks(range(len(names)), [_label(diagnosis, name) for name in names])
        chance.set_ylim(len(names) - 0.4, -0.6)
        for axes in (chance, gain, closed):
            axes.grid(visible=False, axis="y")
            axes.tick_params(axis="y", length=0)
        looks = (_CHOSEN, "", "chosen"), (_AMBIGUOUS, "////", "not told apart"), (_OTHER, "", "others")
        handles = [Patch(facecolor=colour, hatch=hatch, edgecolor="white", label=text) for colour, hatch, text in looks]
        point = Line2D([], [], color=MEASURED, marker="o", markersize=4, linestyle="none", label="alone")
        interval = Line2D([], [], color=REFERENCE, linewidth=INTERVAL["linewidth"], label="interval")
        figure.legend(handles=[*handles, point, interval], loc="outside upper center", ncols=5)
    return figure


def _names(diagnosis: Diagnosis) -> list[str]:
    ranked = [name for name, _ in diagnosis.ranking]
    spoken = [effect.name for effect in diagnosis.effects] + [name for names in diagnosis.ambiguity for name in names]
    keep = set(ranked[:MOST_EFFECTS]) | set(spoken)
    return [name for name in ranked if name in keep] + [n for n in dict.fromkeys(spoken) if n not in ranked]


def _label(diagnosis: Diagnosis, name: str) -> str:
    sets = [chr(ord("A") + k) for k, names in enumerate(diagnosis.ambiguity) if name in names]
    return f"{in_words(name)} ({', '.join(sets)})" if sets else in_words(name)


def _probabilities(axes: Axes, diagnosis: Diagnosis, names: Sequence[str]) -> None:
    chance = diagnosis.probabilities
    for k, name in enumerate(names):
        value = chance.get(name, np.nan)
        colour, hatch = _look(diagnosis, name)
        axes.barh(k, value, height=0.62, color=colour, hatch=hatch, edgecolor="white", linewidth=0.0)
        if np.isfinite(value):
            inside = value > 0.8
            axes.annotate(
                f"{100 * value:.0f} %",
                (value, k),
                xytext=(-3 if inside else 3, 0),
                textcoords="offset points",
                ha="right" if inside else "left",
                va="center",
                fontsize=7.5,
                color="white" if inside and not hatch else "#222222",
                bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.8} if inside and hatch else None,
            )
    axes.set(xlim=(0, 1), xlabel="probability", title="Probability")
    axes.set_xticks((0, 0.5, 1))


def _gains(axes: Axes, rows: Sequence[CandidateRow | None], unit: str) -> None:
    for k, row in enumerate(rows):
        if row is None:
            continue
        axes.errorbar(row.gain_deg, k, xerr=2 * row.standard_error_deg, **INTERVAL)
        axes.plot(row.gain_deg, k, "o", color=MEASURED, markersize=4.5)
    axes.axvline(0.0, **ZERO_LOOK)
    axes.margins(x=0.08)
    axes.set(xlabel=f"fall of RMSE [{unit}]", title="Held-out gain, alone")


def _shares(axes: Axes, diagnosis: Diagnosis, names: Sequence[str]) -> None:
    chosen = {effect.name: effect for effect in diagnosis.effects}
    for k, name in enumerate(names):
        effect = chosen.get(name)
        if effect is None:
            continue
        colour, hatch = _look(diagnosis, name)
        axes.barh(k, effect.closed_share, height=0.62, color=colour, hatch=hatch, edgecolor="white", linewidth=0.0)
        draw_interval(axes, k, effect.closed_share, effect.closed_ci90)
    ends = [end for effect in chosen.values() for end in effect.closed_ci90 if np.isfinite(end)]
    axes.set_xlim(min(0.0, *ends, 0.0) * 1.05, max(1.0, *ends, 0.0) * 1.02)
    axes.axvline(0.0, **ZERO_LOOK)
    axes.set(xlabel="of the structural gap", title="Closed share")
    if not chosen:
        axes.text(0.5, 0.5, "no effect chosen", transform=axes.transAxes, ha="center", color=REFERENCE)


def _look(diagnosis: Diagnosis, name: str) -> tuple[str, str]:
    if any(name in names for names in diagnosis.ambiguity):
        return _AMBIGUOUS, "////"
    return (_CHOSEN, "") if any(effect.name == name for effect in diagnosis.effects) else (_OTHER, "")


def next_figure(proposal: MotionProposal, command_unit: str, unit: str = "deg") -> Figure:
    """Draw the proposed command, the expected angle of each candidate, and their separation after retuning."""
    chosen = proposal.chosen
    t, command, separation, *angles = thin(chosen.motion.t, chosen.motion.command, chosen.separation, *chosen.angles)
    with new_figure(7.0, 4.6) as figure:
        rows = figure.subplots(3, 1, sharex=True, height_ratios=(3, 4, 2.4))
        rows[0].plot(t, command, **COMMANDED)
        rows[0].set(ylabel=f"command [{command_unit}]", title=in_words(chosen.motion.name))
        for k, (name, angle) in enumerate(zip(proposal.names, angles, strict=True)):
            style = {"color": _COLOURS[k % 5], "linestyle": _DASHES[k % 5], "linewidth": 1.2}
            rows[1].plot(t, angle, label=f"if {in_words(name)}", **style)
        rows[1].set_ylabel(output_label(unit))
        rows[1].legend(loc="upper right", ncols=min(len(angles), 3))
        low, high = rows[1].get_ylim()
        rows[1].set_ylim(low, high + 0.22 * (high - low))
        rows[2].fill_between(t, separation, color=MODEL, alpha=0.75, linewidth=0.0)
        rows[2].set_ylabel(f"apart after\nretuning [{unit}]")
        rows[2].set_ylim(bottom=0.0)
        rows[2].set_xlabel("time [s]")
        rows[2].axhline(0.0, color=REFERENCE, linewidth=0.6)
    return figure


def closed_loop_figure(curves: Sequence[TrackingCurve]) -> Figure:
    """Draw angle and error of the closed loops before and after the correction, a column for each motion."""
    motions = []
    for curve in curves:
        both = ((curve.before_deg, BEFORE), (curve.after_deg, AFTER))
        lines = [TrackedLine(curve.t, angle, angle - curve.reference_deg, look) for angle, look in both]
        approach_s = float(curve.t[curve.first - 1]) if curve.first else 0.0
        motions.append(TrackedMotion(curve.t, curve.reference_deg, lines, in_words(curve.name), approach_s))
    return tracking_figure(motions, "error [deg]")


_BINS, _SEGMENT_S = 12, 16.0
_ROUNDING = 1e-9

_COLUMNS = 400  # more are not visible across a page

_WINDOW_S = 40.0
_LOOK: dict[Stage, Any] = {stage: {**look, "linewidth": 0.9} for stage, look in LOOK.items()}

_BAR = COLOUR["retuned"]
_STAIRS: Any = {"linewidth": 1.5, "baseline": None}


def heat_figure(trials: Sequence[TrialRuns], unit: str, stages: Sequence[Stage]) -> Figure:
    """Draw the command over time above |simulated - measured| as colour strips, on one scale for all trials."""
    longest = max(trial.trial.duration_s for trial in trials)
    sizes = np.concatenate([np.abs(trial.residual("retuned")) for trial in trials])
    top = float(np.quantile(sizes, 0.995)) or 1.0
    with new_figure(7.0, 0.7 + (0.72 + 0.17 * len(stages)) * len(trials)) as figure:
        ratios = (2.0, 0.6 * len(stages)) * len(trials)
        rows = figure.subplots(2 * len(trials), 1, sharex=True, height_ratios=ratios, squeeze=False)[:, 0]
        for command, strip, trial in zip(rows[::2], rows[1::2], trials, strict=True):
            _command(command, trial, unit)
            _strip(strip, trial, stages, top)
        rows[-1].set(xlim=(0.0, longest), xlabel="time [s]")
        bar = figure.colorbar(rows[-1].images[0], ax=rows.tolist(), aspect=14 * len(trials), pad=0.01, extend="max")
        bar.set_label(f"|residual| [{trials[0].trial.units.angle}]", fontsize=8.0)
    return figure


def _command(axes: Axes, trial: TrialRuns, unit: str) -> None:
    t, command = thin(trial.trial.t - trial.trial.t[0], trial.trial.command)
    axes.plot(t, command, **COMMANDED)
    axes.set_ylabel(unit)
    axes.set_title(f"{shortened(trial.name, 50)} ({trial.role})", fontsize=8.5)


def _strip(axes: Axes, trial: TrialRuns, stages: Sequence[Stage], top: float) -> None:
    """Draw a colour strip of the residual, one row for each simulator; samples that do not count stay white."""
    rows = np.array([_columns(trial, stage) for stage in stages])
    extent = (0.0, trial.trial.duration_s, len(stages) - 0.5, -0.5)
    axes.imshow(rows, aspect="auto", cmap=HEAT, vmin=0.0, vmax=top, extent=extent, interpolation="nearest")
    axes.set_yticks(range(len(stages)), [LABEL[stage] for stage in stages], fontsize=7.5)
    axes.grid(visible=False)
    axes.tick_params(axis="y", length=0)
    for k in range(1, len(stages)):
        axes.axhline(k - 0.5, color="white", linewidth=1.2)


def _columns(trial: TrialRuns, stage: Stage) -> np.ndarray:
    """Greatest |residual| in equal parts of the trial [deg]."""
    size = np.full(len(trial.trial), np.nan)
    size[trial.start :] = np.abs(trial.residual(stage))
    parts = np.array_split(size, min(_COLUMNS, size.size))
    return np.array([np.nanmax(part) if np.isfinite(part).any() else np.nan for part in parts])


def loops(trials: Sequence[TrialRuns], unit: str, stages: Sequence[Stage]) -> Figure:
    """Draw the loops of the output over the command: measured and of each simulator."""
    panels = []
    for trial in trials:
        command = trial.trial.command
        runs = [(command, getattr(trial, stage), _LOOK[stage]) for stage in stages]
        panels.append(LoopPanel(trial.name, [(command, trial.trial.angle, REAL), *runs]))
    return loop_figure(panels, unit, trials[0].trial.units.angle)


def over_time(trials: Sequence[TrialRuns], stages: Sequence[Stage]) -> Figure:
    """Draw the output over time, measured and of each simulator, and the residuals of the simulators."""
    shown = []
    for evidence in trials:
        trial = evidence.trial
        runs = [(getattr(evidence, stage), _LOOK[stage]) for stage in stages]
        title, t = shortened(evidence.name, 60), trial.t - trial.t[0]
        shown.append(SimulatedTrial(title, t, (trial.angle, REAL), runs, trial.units.angle))
    return time_figure(shown)


def before_after_figure(trial: TrialRuns, after: Stage) -> Figure:
    """Draw angle and error before and after the correction over time, first the window with the largest error."""
    t = trial.trial.t - trial.trial.t[0]
    size, energy, at = (
        round(_WINDOW_S / trial.trial.dt),
        np.cumsum(np.r_[0.0, trial.residual("nominal") ** 2]),
        trial.start,
    )
    if energy.size > size:  # the window with the largest error as given, among the samples that count
        at += int(np.argmax(energy[size:] - energy[:-size]))
    start = float(t[at])
    part = (t >= start) & (t <= start + _WINDOW_S)
    with new_figure(7.0, 3.4) as figure:
        angle, error = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        draw_part(angle, t, trial.trial.angle, part, **{**REAL, "label": "measured"})
        for stage in ("nominal", after):
            run = getattr(trial, stage)
            draw_part(angle, t, run, part, **_LOOK[stage])
            draw_part(error, t, run - trial.trial.angle, part, **_LOOK[stage])
        error.axhline(0.0, **ZERO_LOOK)
        angle.set_ylabel(output_label(trial.trial.units.angle))
        error.set(ylabel=f"simulated less\nmeasured [{trial.trial.units.angle}]", xlabel="time [s]")
        figure.legend(*angle.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def share_figure(places: Mapping[str, ResidualShare]) -> Figure:
    """Draw the share of the retuned residual's energy and of the time in each part of the motion."""
    ordered = sorted(places.items(), key=lambda item: -item[1].share)
    with new_figure(7.0, 0.95 + 0.3 * len(ordered)) as figure:
        axes: Axes = figure.subplots()
        for k, (_, place) in enumerate(ordered):
            axes.barh(k, place.share, height=0.6, color=_BAR, label="share of the residual's energy" if not k else None)
            draw_interval(axes, k, place.share, place.ci90, label="90 % interval" if not k else None)
            if place.density > 0:
                time = place.share / place.density
                label = "share of time" if not k else None
                axes.plot(time, k, "|", color="#222222", markersize=15, markeredgewidth=1.8, label=label)
            text = f"{place.density:.1f} x average"
            axes.annotate(text, (1.01, k), xycoords=("axes fraction", "data"), va="center", fontsize=8)
        axes.set_yticks(range(len(ordered)), [in_words(name) for name, _ in ordered])
        axes.set(ylim=(len(ordered) - 0.5, -0.6), xlabel="share")
        axes.set_xlim(0.0, min(1.0, 1.08 * max(max(place.ci90[1], place.share) for place in places.values())))
        axes.grid(visible=False, axis="y")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def bins_figure(trials: Sequence[TrialRuns], stages: Sequence[Stage]) -> Figure | None:
    """Draw the RMSE of each simulator over command, angle and speed; None without motion."""
    groups = binned(trials, stages)
    if not groups:
        return None
    with new_figure(7.0, 2.8) as figure:
        rows = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
        for axes, group in zip(rows, groups, strict=True):
            for stage, values in group.rmse_deg.items():
                axes.stairs(values, group.edges, **LOOK[stage], **_STAIRS)
            shares = axes.twinx()
            shares.stairs(group.time, group.edges, fill=True, color="#e2e2e2", zorder=0)
            shares.set(ylim=(0.0, 1.0), yticks=())
            shares.spines["right"].set_visible(False)
            axes.set_zorder(shares.get_zorder() + 1)
            axes.patch.set_visible(False)
            axes.set_xlabel(f"{group.quantity} [{group.unit}]")
        rows[0].set_ylabel(f"RMSE [{trials[0].trial.units.angle}]")
        rows[0].set_ylim(bottom=0.0)
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


@dataclass(frozen=True, eq=False)
class Binned:
    """RMSE over equal intervals of one quantity."""

    quantity: str
    unit: str
    edges: Vec
    rmse_deg: dict[Stage, Vec]
    time: Vec


def binned(trials: Sequence[TrialRuns], stages: Sequence[Stage]) -> list[Binned]:
    """RMSE by command, angle and speed of the command over all samples that count; constant quantities are left out."""
    unit, angle = trials[0].trial.units.command, trials[0].trial.units.angle
    values = {
        ("command", unit): [t.trial.command[t.start :] for t in trials],
        ("angle", angle): [t.trial.angle[t.start :] for t in trials],
        ("command speed", f"{unit}/s"): [np.gradient(t.trial.command, t.trial.t)[t.start :] for t in trials],
    }
    squares: dict[Stage, Vec] = {s: np.concatenate([t.residual(s) ** 2 for t in trials]) for s in stages}
    joined = {names: np.concatenate(parts) for names, parts in values.items()}
    return [
        _binned(*names, signal, squares)
        for names, signal in joined.items()
        if np.ptp(signal) > _ROUNDING * (1 + np.abs(signal).max())
    ]


def _binned(quantity: str, unit: str, values: Vec, squares: dict[Stage, Vec]) -> Binned:
    low, high = np.quantile(values, (0.002, 0.998)) if quantity == "command speed" else (values.min(), values.max())
    if high <= low:
        low, high = values.min(), values.max()
    edges = np.linspace(low, high, _BINS + 1)
    place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _BINS - 1)
    counts = np.bincount(place, minlength=_BINS)
    rmse: dict[Stage, Vec] = {}
    for stage, parts in squares.items():
        sums = np.bincount(place, parts, minlength=_BINS)
        rmse[stage] = np.sqrt(np.divide(sums, counts, out=np.full(_BINS, np.nan), where=counts > 0))
    return Binned(quantity, unit, edges, rmse, counts / values.size)


def spectrum_figure(
    trials: Sequence[TrialRuns], stages: Sequence[Stage], noise_deg: float, lines: Sequence[SpectralLine] = ()
) -> Figure:
    """Draw the residual over frequency with white noise of that deviation and the lines outside the command."""
    with new_figure(7.0, 2.8) as figure:
        axes: Axes = figure.subplots()
        top = 0.0
        for stage in stages:
            frequency, density = amplitude_density(trials, stage)
            axes.plot(frequency[1:], density[1:], **LOOK[stage])
            top = float(frequency[-1])
        if np.isfinite(noise_deg) and noise_deg > 0 and top > 0:
            level = noise_deg * np.sqrt(1 / top)  # one-sided, up to the Nyquist frequency
            axes.axhline(level, color=REFERENCE, linestyle=(0, (4, 3)), linewidth=0.9, label="noise")
        for k, line in enumerate(lines):
            label = "not the command's" if not k else None
            axes.axvline(line.hz, color=MEASURED, linestyle=(0, (1, 2)), linewidth=1.2, label=label)
        label = f"residual [{trials[0].trial.units.angle}/√Hz]"
        axes.set(xscale="log", yscale="log", xlabel="frequency [Hz]", ylabel=label)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def amplitude_density(trials: Sequence[TrialRuns], stage: Stage) -> tuple[Vec, Vec]:
    """Frequencies [Hz] and amplitude density of the residuals [deg/sqrt(Hz)], mean power over trials (Welch, 16 s)."""
    dt = float(np.median([trial.trial.dt for trial in trials]))
    shortest = min(trial.residual(stage).size for trial in trials)
    size = max(8, min(shortest, round(_SEGMENT_S / dt)))
    residuals = [trial.residual(stage) for trial in trials]
    powers = [welch(e, 1 / dt, nperseg=size, detrend="constant")[1] for e in residuals]
    mean: Vec = np.average(powers, axis=0, weights=[e.size for e in residuals])
    return np.asarray(np.fft.rfftfreq(size, dt), dtype=np.float64), np.sqrt(mean)


def memory_figure(gains: Mapping[str, float]) -> Figure:
    """Draw the share of the residual energy that each memory of the command predicts on held-out trials."""
    ordered = sorted(gains.items(), key=lambda item: -item[1])
    with new_figure(7.0, 0.7 + 0.25 * len(ordered)) as figure:
        axes: Axes = figure.subplots()
        axes.barh(range(len(ordered)), [gain for _, gain in ordered], height=0.6, color=_BAR)
        axes.set_yticks(range(len(ordered)), [in_words(name) for name, _ in ordered])
        axes.axvline(0.0, **ZERO_LOOK)
        axes.set(ylim=(len(ordered) - 0.5, -0.5), xlabel="share of the residual's energy explained on trials left out")
        axes.grid(visible=False, axis="y")
    return figure
