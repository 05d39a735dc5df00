"""How far the corrected simulator goes on trials of another session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hystmpc.trials.trial import Trial

from .findings import Findings
from .gap_closed import FinalErrors
from .preparation import prepare


def closed_again(findings: Findings, trials: Sequence[Trial]) -> float:
    """Share of the gap that the causes close on trials recorded later, counted from the floor that was found.

    This is what the 90 % interval of the closed share is to hold: not what a perfect equation would close, but what
    this corrected simulator does on more of such trials.

    Args:
        findings: of a diagnosis.
        trials: a whole session of the device, in recording order.

    Raises:
        GapError: on unusable trials.
    """
    fresh = prepare(trials, findings.simulator)
    fresh = replace(fresh, final=fresh.everything)
    sensor = "sensor" in findings.far.shares
    opened = FinalErrors(fresh, findings.validation, findings.retuned, findings.chosen, findings.floor, sensor)
    return opened.closed(opened.after.mse)
