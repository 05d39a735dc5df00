"""Style of the figures of a diagnosis: colours, markers, labels, and the choice of trials to draw."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hystmpc.trials.report import ACCENTS, COMMAND, DASHES, MEASURED, MODEL, REFERENCE
from hystmpc.trials.types import Vec

from .report_data import Stage, TrialEvidence

LABEL: dict[Stage, str] = {"nominal": "as given", "retuned": "retuned", "with_effects": "with effects"}
COLOUR: dict[Stage, str] = {"nominal": "#a6a6a6", "retuned": ACCENTS[2], "with_effects": MODEL}
_DASH: dict[Stage, Any] = {"nominal": DASHES[0], "retuned": DASHES[2], "with_effects": DASHES[1]}
LOOK: dict[Stage, Any] = {
    stage: {"color": COLOUR[stage], "linestyle": dash, "label": LABEL[stage]} for stage, dash in _DASH.items()
}
MARKER: dict[Stage, str] = {"nominal": "s", "retuned": "o", "with_effects": "D"}
REAL: Any = {"color": MEASURED, "linewidth": 2.6, "alpha": 0.5, "label": "real"}
COMMANDED: Any = {"color": COMMAND, "linewidth": 0.9}
INTERVAL: Any = {"color": REFERENCE, "linewidth": 1.1, "capsize": 2.5, "capthick": 1.1, "fmt": "none"}
BEFORE: Any = {"color": ACCENTS[2], "linewidth": 1.0, "linestyle": DASHES[1], "label": "before"}
AFTER: Any = {"color": MODEL, "linewidth": 1.0, "label": "after"}
HEAT = "magma_r"  # even steps of lightness: also read in grey and by colour-blind readers
_POINTS = 3000


def worst_first(trials: Sequence[TrialEvidence]) -> list[TrialEvidence]:
    """Trials by their retuned RMSE, greatest first."""
    return sorted(trials, key=lambda trial: -trial.rmse("retuned"))


def shown(trials: Sequence[TrialEvidence], most: int) -> list[TrialEvidence]:
    """At most so many trials, final ones before others and worse before better, in recording order."""
    ranked = sorted(worst_first(trials), key=lambda trial: trial.role != "final")[:most]
    return [trial for trial in trials if any(trial is other for other in ranked)]


def thin(*signals: Vec) -> tuple[Vec, ...]:
    """Signals of one length with no more samples than a figure can show."""
    step = max(1, -(-signals[0].size // _POINTS))
    return tuple(signal[::step] for signal in signals)
