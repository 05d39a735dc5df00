"""Findings: results of all steps up to the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hystmpc.models.model import LoadedModel
from hystmpc.models.simulator import Simulator
from hystmpc.trials.trial import Trial

from ..logs.preparation import PreparedTrials, prepare
from ..residual.localise import Localisation
from .attribution import Attribution, Conclusion
from .gap_closed import FinalErrors

if TYPE_CHECKING:
    pass


@dataclass(frozen=True, eq=False)
class Findings:
    """Result of every step.

    Attributes:
        simulator: as given.
        prepared: trials and the baseline.
        attribution: causes selected on the development trials.
        conclusion: ruling, corrected simulator and sizes on the final trials.
        localisation: of the retuned residual; None where there is none.
        left_out: effects that the library went without.
        seed: of everything drawn at random.
        seconds: duration of each step [s].
    """

    simulator: Simulator | LoadedModel
    prepared: PreparedTrials
    attribution: Attribution
    conclusion: Conclusion
    localisation: Localisation | None
    left_out: tuple[str, ...]
    seed: int
    seconds: Mapping[str, float]


def closed_again(findings: Findings, trials: Sequence[Trial]) -> float:
    """Share of the gap that the corrected simulator closes on trials of a later session, over the floor found before.

    The 90 % interval of the closed share refers to this quantity: the corrected simulator on more such trials, not a
    perfect model.

    Args:
        findings: of a diagnosis.
        trials: a whole session of the device, in recording order.

    Raises:
        GapError: on unusable trials.
    """
    fresh = prepare(trials, findings.simulator)
    fresh = replace(fresh, final=fresh.everything)
    attribution, conclusion = findings.attribution, findings.conclusion
    sensor = "sensor" in conclusion.closed.causes
    errors = FinalErrors(
        fresh, attribution.validation, attribution.retuned, conclusion.chosen, conclusion.floor, sensor
    )
    return errors.closed(errors.after.mse)
