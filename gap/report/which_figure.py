"""Which effect: probability, held-out gain and closed share of the candidates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from hystmpc.trials.report import ACCENTS, MEASURED, MODEL, REFERENCE, new_figure

from ..diagnosis import Diagnosis
from .evidence import CandidateRow, Evidence
from .look import INTERVAL, QUIET, plain

MOST_EFFECTS = 10
_CHOSEN, _AMBIGUOUS, _OTHER = MODEL, ACCENTS[2], "#c4c4c4"


def which_figure(evidence: Evidence) -> Figure:
    """Candidates by probability; those chosen, and those that these trials cannot tell apart, stand out."""
    diagnosis, rows = evidence.diagnosis, {row.name: row for row in evidence.candidates}
    names = _names(diagnosis)
    with new_figure(7.0, 1.0 + 0.29 * len(names)) as figure:
        chance, gain, closed = figure.subplots(1, 3, sharey=True, width_ratios=(3, 3, 3))
        _probabilities(chance, diagnosis, names)
        _gains(gain, [rows.get(name) for name in names])
        _shares(closed, diagnosis, names)
        chance.set_yticks(range(len(names)), [_label(diagnosis, name) for name in names])
        chance.set_ylim(len(names) - 0.4, -0.6)
        for axes in (chance, gain, closed):
            axes.grid(visible=False, axis="y")
            axes.tick_params(axis="y", length=0)
        looks = (_CHOSEN, "", "chosen"), (_AMBIGUOUS, "////", "not told apart"), (_OTHER, "", "others")
        handles = [Patch(facecolor=colour, hatch=hatch, edgecolor="white", label=text) for colour, hatch, text in looks]
        figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


def _names(diagnosis: Diagnosis) -> list[str]:
    """Effects to draw: the most probable, and in any case those that the verdict speaks of."""
    ranked = [name for name, _ in diagnosis.ranking]
    spoken = [effect.name for effect in diagnosis.effects] + [name for names in diagnosis.ambiguity for name in names]
    keep = set(ranked[:MOST_EFFECTS]) | set(spoken)
    return [name for name in ranked if name in keep] + [n for n in dict.fromkeys(spoken) if n not in ranked]


def _label(diagnosis: Diagnosis, name: str) -> str:
    """The effect's name and the letter of the set that it cannot be told apart from."""
    sets = [chr(ord("A") + k) for k, names in enumerate(diagnosis.ambiguity) if name in names]
    return f"{plain(name)} ({', '.join(sets)})" if sets else plain(name)


def _probabilities(axes: Axes, diagnosis: Diagnosis, names: Sequence[str]) -> None:
    chance = dict(diagnosis.ranking) | {effect.name: effect.probability for effect in diagnosis.effects}
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


def _gains(axes: Axes, rows: Sequence[CandidateRow | None]) -> None:
    for k, row in enumerate(rows):
        if row is None:
            continue
        axes.errorbar(row.gain_deg, k, xerr=2 * row.standard_error_deg, **INTERVAL)
        axes.plot(row.gain_deg, k, "o", color=MEASURED, markersize=4.5)
    axes.axvline(0.0, **QUIET)
    axes.margins(x=0.08)
    axes.set(xlabel="fall of RMSE [deg]", title="Held-out gain, alone")


def _shares(axes: Axes, diagnosis: Diagnosis, names: Sequence[str]) -> None:
    chosen = {effect.name: effect for effect in diagnosis.effects}
    for k, name in enumerate(names):
        effect = chosen.get(name)
        if effect is None:
            continue
        colour, hatch = _look(diagnosis, name)
        axes.barh(k, effect.closed_share, height=0.62, color=colour, hatch=hatch, edgecolor="white", linewidth=0.0)
        low, high = effect.closed_ci90
        reach = [[max(effect.closed_share - low, 0.0)], [max(high - effect.closed_share, 0.0)]]
        axes.errorbar(effect.closed_share, k, xerr=reach, **INTERVAL)
    ends = [end for effect in chosen.values() for end in effect.closed_ci90 if np.isfinite(end)]
    axes.set_xlim(min(0.0, *ends, 0.0) * 1.05, max(1.0, *ends, 0.0) * 1.02)
    axes.axvline(0.0, **QUIET)
    axes.set(xlabel="of the structural gap", title="Closed share")
    if not chosen:
        axes.text(0.5, 0.5, "no effect chosen", transform=axes.transAxes, ha="center", color=REFERENCE)


def _look(diagnosis: Diagnosis, name: str) -> tuple[str, str]:
    """Colour and hatch of an effect."""
    if any(name in names for names in diagnosis.ambiguity):
        return _AMBIGUOUS, "////"
    return (_CHOSEN, "") if any(effect.name == name for effect in diagnosis.effects) else (_OTHER, "")
