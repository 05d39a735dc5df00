"""Findings: results of all steps up to the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from hystmpc.models.model import LoadedModel
from hystmpc.models.simulator import Simulator
from hystmpc.trials.trial import Trial

from ..diagnosis import DetectableSizes, Stability
from ..logs.preparation import PreparedTrials, prepare
from ..residual.localise import Localisation
from .attribution import Attribution, Conclusion
from .gap_closed import FinalErrors, less_sawtooth


@dataclass(frozen=True, eq=False)
class Findings:
    """Result of every step.

    Attributes:
        simulator: as given.
        prepared: trials and the baseline.
        detectable: the least size at which the trials would show each effect, from their commands alone.
        attribution: causes selected on the development trials.
        conclusion: ruling, corrected simulator and sizes on the final trials.
        localisation: of the retuned residual; None where there is none.
        stability: of the ruling over resampled splits; None where the trials allow no choice.
        left_out: effects that the library went without.
        seed: of everything drawn at random.
        seconds: duration of each step [s].
    """

    simulator: Simulator | LoadedModel
    prepared: PreparedTrials
    detectable: DetectableSizes
    attribution: Attribution
    conclusion: Conclusion
    localisation: Localisation | None
    stability: Stability | None
    left_out: tuple[str, ...]
    seed: int
    seconds: Mapping[str, float]


def closed_again(findings: Findings, trials: Sequence[Trial]) -> float:
    """Share of the gap that the corrected simulator closes on trials of a later session, over the floor found before.

    The 90 % interval of the closed share refers to this quantity: the corrected simulator on more such trials, not a
    perfect model. As in `measure`, what jumps leave by their nature counts as closed.

    Args:
        findings: of a diagnosis.
        trials: a whole session of the device, ordered as the first one was.

    Raises:
        GapError: on unusable trials.
    """
    fresh = prepare(trials, findings.simulator, ordered=findings.prepared.order == "known")
    fresh = replace(fresh, final=fresh.everything)
    attribution, conclusion = findings.attribution, findings.conclusion
    sensor = "sensor" in conclusion.closed.causes
    jumps = attribution.jumps if "stick_slip" in conclusion.closed.causes.keys() - conclusion.chosen.effects else None
    jumps_mse = jumps.mse if jumps else 0.0
    shown = attribution.validation, attribution.retuned, conclusion.chosen, conclusion.floor
    errors = FinalErrors(fresh, *shown, sensor, findings.seed, jumps_mse)
    after = less_sawtooth(errors.after, jumps_mse)
    return errors.shares.closed(after.mse)
