"""The share of the gap that a corrected simulator closes on a later session of the device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hystmpc.gap.decide.attribution import Findings
from hystmpc.gap.decide.gap_closed import FinalErrors, without_sawtooth
from hystmpc.gap.logs.preparation import prepare
from hystmpc.trials.trial import Trial


def closed_in_later_session(findings: Findings, trials: Sequence[Trial]) -> float:
    """Closed share of the corrected simulator on trials of a later session, over the floor of the first one.

    The 90 % interval of the closed share refers to this quantity: the corrected simulator on more such trials, not a
    perfect model. As in `FinalErrors.closed`, what jumps leave by their nature counts as closed.

    Args:
        findings: of a diagnosis.
        trials: a whole session of the device, ordered as the first one was.

    Raises:
        GapError: on unusable trials.
    """
    later = prepare(trials, findings.simulator, ordered=findings.prepared.order == "known")
    later = replace(later, final=later.everything)
    attribution, conclusion = findings.attribution, findings.conclusion
    causes = conclusion.closed.causes.keys()
    jumps = attribution.jumps if "stick_slip" in causes - conclusion.chosen.effects else None
    fitted = attribution.validation, attribution.retuned, conclusion.chosen, conclusion.floor
    errors = FinalErrors(later, *fitted, "sensor" in causes, findings.seed, jumps)
    return errors.shares.closed(without_sawtooth(errors.after, jumps.mse if jumps else 0.0).mse)
