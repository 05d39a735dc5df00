"""Order of the trials: that of recording where it is known, else one that depends on nothing but their content."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from hystmpc.models.identify.runs import fingerprint
from hystmpc.trials.errors import GapError
from hystmpc.trials.recording import by_clock, by_manifest
from hystmpc.trials.trial import Trial

from ..diagnosis import Order

SET_ACROSS_TRIALS = "set_across_trials"
NEEDS_ORDER: Mapping[str, str] = {
    "drift": "A drift goes on from trial to trial, and the order of recording is unknown; it may pass for a trial "
    "shift.",
    SET_ACROSS_TRIALS: "A set that the first trials leave in all later ones needs the order of recording, which is "
    "unknown; a first flexure that comes in every trial anew is looked for.",
}
"""What cannot be tested where the order is unknown, and why, a sentence each."""


def in_recording_order(trials: Sequence[Trial], ordered: bool) -> tuple[list[Trial], Order]:
    """The trials in the order of recording, or in an order by content.

    Time stamps count first, then the caller's word, then a manifest. A single trial has its order. Where nothing tells
    the order, trials are sorted by the range of their commands, their length and their content, so that every later
    choice (folds, final trials, seeds) is the same whatever the order of the files.

    Args:
        trials: as given.
        ordered: whether the caller says that they are in the order of recording.

    Raises:
        GapError: if the caller says so and the time stamps or the manifest say otherwise.
        ConfigError: if a manifest cannot be used.
    """
    if len(trials) < 2:
        return list(trials), "known"
    found = by_clock(trials) or by_manifest([trial.source for trial in trials])
    if ordered and found is not None and found != sorted(found):
        k = next(k for k, place in enumerate(found) if k != place)
        first, given = (Path(trials[j].source).name for j in (found[k], k))
        raise GapError(
            f"--ordered: got {given} as trial {k + 1}, expected {first}, which was recorded before it by time stamps "
            "or manifest; give the files in that order, or leave --ordered out"
        )
    if found is not None:
        return [trials[k] for k in found], "known"
    return (list(trials), "known") if ordered else (sorted(trials, key=_content), "unknown")


def _content(trial: Trial) -> tuple[float, float, str, str]:
    """Motions that are alike stand side by side, and so go to different folds."""
    return float(np.ptp(trial.command)), trial.duration_s, fingerprint([trial]), trial.source
