"""What lies behind a diagnosis and is shown in its report: signals, tables, places, the next motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from hystmpc.models.identify.uncertainty import ParameterRow
from hystmpc.models.simulator import Simulator
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..confusable import Confusable
from ..diagnosis import Diagnosis
from ..excitation import Excitation
from ..localise import Localisation
from ..next_motion import Proposal

Role = Literal["fit", "select", "final"]
Side = Literal["command", "output", "sensor", "trial"]
Stage = Literal["nominal", "retuned", "with_effects"]
STAGES: tuple[Stage, ...] = ("nominal", "retuned", "with_effects")


@dataclass(frozen=True, eq=False)
class TrialEvidence:
    """One trial with its free runs.

    Attributes:
        trial: as diagnosed, on the simulator's sample time.
        role: what it served for: fit, select or final (opened once).
        motion: its motion type, such as `sine` or `holds`.
        nominal, retuned, with_effects: simulated angles [deg], (T,), of the simulator as given, refitted, and refitted
            with the chosen effects; where none was chosen the last equals the second.
        floor_deg: RMSE below which no simulator can go on this trial [deg].
        start: first sample that counts.
    """

    trial: Trial
    role: Role
    motion: str
    nominal: Vec
    retuned: Vec
    with_effects: Vec
    floor_deg: float
    start: int = 0

    @property
    def name(self) -> str:
        """Name of the log without its folder."""
        return Path(self.trial.source).name

    def residual(self, stage: Stage) -> Vec:
        """Simulated minus measured angle over the samples that count [deg]."""
        return np.asarray(getattr(self, stage) - self.trial.angle)[self.start :]

    def rmse(self, stage: Stage) -> float:
        """Root mean square of that residual [deg]."""
        return float(np.sqrt(np.mean(self.residual(stage) ** 2)))


@dataclass(frozen=True)
class CandidateRow:
    """One candidate effect, added alone to the retuned simulator.

    Attributes:
        name: of the effect.
        side: where it acts.
        rmse_deg: on the trials to select by [deg].
        gain_deg: retuned RMSE less this [deg]; negative where the effect did harm.
        standard_error_deg: of the gain [deg].
        probability: calibrated.
        chosen: whether it is in the corrected simulator.
    """

    name: str
    side: Side
    rmse_deg: float
    gain_deg: float
    standard_error_deg: float
    probability: float
    chosen: bool = False


@dataclass(frozen=True, eq=False)
class Evidence:
    """Everything that the report shows.

    Attributes:
        diagnosis: the result.
        simulator: name of the simulator's file.
        trials: in recording order, at least one.
        excitation: what the commands do; None where it was not looked at.
        candidates: every effect, most likely first.
        confusable: what motions can hardly tell apart, judged for these before any claim.
        parameters: identified values of the corrected simulator.
        localisation: of the retuned residual; None where there was none to localise.
        noise_deg: white noise of the measured angle [deg]; not-a-number where unknown.
        ceiling_share: share of the structural gap that a flexible model can explain; None where not estimated.
        proposal: what to record next; None where nothing is open.
        cannot_show: what these trials cannot show, a sentence each.
        fixed: the corrected simulator, where it can be written as one.
        files: further files of the diagnosis by name.
        seed: of everything drawn at random.
        seconds: time of each step of the procedure.
    """

    diagnosis: Diagnosis
    simulator: str
    trials: tuple[TrialEvidence, ...]
    excitation: Excitation | None = None
    candidates: tuple[CandidateRow, ...] = ()
    confusable: tuple[Confusable, ...] = ()
    parameters: tuple[ParameterRow, ...] = ()
    localisation: Localisation | None = None
    noise_deg: float = math.nan
    ceiling_share: float | None = None
    proposal: Proposal | None = None
    cannot_show: tuple[str, ...] = ()
    fixed: Simulator | None = None
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    seed: int = 1
    seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def final(self) -> tuple[TrialEvidence, ...]:
        """Trials that nothing was chosen on; all of them where there was no such split."""
        return tuple(trial for trial in self.trials if trial.role == "final") or self.trials

    @property
    def stages(self) -> tuple[Stage, ...]:
        """Simulators that differ: without a chosen effect the last is the retuned one."""
        return STAGES if self.diagnosis.effects else STAGES[:2]

    @property
    def measured_on(self) -> str:
        """What `final` are: final trials, or all of them."""
        return "final trials" if any(trial.role == "final" for trial in self.trials) else "trials"

    @property
    def command_unit(self) -> str:
        """mm or bar."""
        return self.trials[0].trial.units.command
