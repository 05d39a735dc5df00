"""What the steps of a diagnosis found, for those that put it into words, numbers and files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hystmpc.models.contract.load import OnnxModel
from hystmpc.models.identify.cross_validation import CrossValidation, Hypothesis
from hystmpc.models.identify.selection import Selection
from hystmpc.models.simulator import Simulator

from .attribution import DiagnosisSettings
from .floor import Floor
from .gap_closed import GapClosed
from .jumps import Jumps
from .localise import Localisation
from .preparation import Prepared
from .verdict import Ruling


@dataclass(frozen=True, eq=False)
class Findings:
    """Every step's result.

    Attributes:
        simulator: as given.
        prepared: trials and the baseline.
        court: development runs.
        selection: every explanation that was judged.
        ruling: what it amounts to.
        retuned, chosen: the simulator refitted, and with its causes; the same where there are none.
        floor: from repeats or noise.
        floor_mse: what was no news in the selection [deg^2].
        far: sizes on the final trials.
        places: where the retuned gap lies; None where nothing is left of it.
        jumps: of the tip in steady motion, where they are the sign of stick-slip.
        left_out: effects that the library went without.
        seed: of everything drawn at random.
        settings: thresholds that were used.
        seconds: time of each step.
    """

    simulator: Simulator | OnnxModel
    prepared: Prepared
    validation: CrossValidation
    selection: Selection
    ruling: Ruling
    retuned: Hypothesis
    chosen: Hypothesis
    floor: Floor
    floor_mse: float
    far: GapClosed
    places: Localisation | None
    jumps: Jumps | None
    left_out: tuple[str, ...]
    seed: int
    settings: DiagnosisSettings
    seconds: Mapping[str, float]
