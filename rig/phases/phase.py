"""What the loop does sample by sample: one phase after another, each of them deciding on commands."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Now:
    """What a phase may look at.

    Attributes:
        angle_deg: measured angle, NaN where none is usable [deg].
        held: the command sent last, or the one that the device was found to hold.
        late: whether the previous sample missed its deadline, so that there is no time for a plan.
        skipped: whole samples since the previous one in which nothing was sent and the device held `held`.
        told: the command that the device says it holds, NaN where it does not tell.
        velocity: of the command between the last two samples; 0 where the device was found at rest [unit/s].
    """

    angle_deg: float
    held: float
    late: bool = False
    skipped: int = 0
    told: float = math.nan
    velocity: float = 0.0


@dataclass(frozen=True, slots=True)
class Decision:
    """What a phase wants.

    Attributes:
        u: wanted command; the gate has the last word.
        source, status: as in `Sample`.
        reference_deg, predicted_deg: for the end of the sample, NaN where there is none.
        stages_s: name and time of stages.
        finished: whether this was the phase's last sample.
        fault: why the run has to stop, empty while it has not.
    """

    u: float
    source: str
    status: str = "ok"
    reference_deg: float = math.nan
    predicted_deg: float = math.nan
    stages_s: tuple[tuple[str, float], ...] = ()
    finished: bool = False
    fault: str = ""


@dataclass(frozen=True, slots=True)
class Past:
    """What was sent and measured in the run so far, for a controller that takes over; (T,) each, copies."""

    commands: list[float]
    angles_deg: list[float]


class Phase(Protocol):
    """One part of a run. It may raise: the loop then stops safely and says what was raised."""

    @property
    def name(self) -> str:
        """One word, as logs show it."""
        ...

    def begin(self, now: Now, past: Past) -> None:
        """Start from rest at the command held."""
        ...

    def step(self, now: Now) -> Decision:
        """One sample."""
        ...
