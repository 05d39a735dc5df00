"""What one sample at the bench leaves behind, and where it goes: the border between control thread and recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Sample:
    """One sample of the loop at a bench; the angle is what the controller saw when it chose the command.

    Attributes:
        t_s: monotonic time since the start of the run [s].
        wall_ns: wall clock [ns since 1970]; it may jump, `t_s` may not.
        reference_deg: wanted angle at the end of the sample [deg].
        measured_deg: measured angle, NaN without a usable one [deg].
        command: command really sent, in the unit that the run's configuration names; of the source `wait`, the one that
            the device says it holds, since nothing was sent.
        source: what chose it: mpc, shifted plan, inverse, hold, stop, wait, return, or the name of a preparation step.
        status: one line on what happened.
        predicted_deg: angle predicted for the end of the sample, NaN without one [deg].
        stages_s: name and duration of every stage, such as estimate, plan, total [s].
        period_s: time since the previous sample's start [s].
        lateness_s: how late the sample started behind its deadline [s].
        missed: whether the command was sent after the end of the sample.
        faults: names of the faults seen in this sample.
        sequence: number of the sample, counted from 0.
    """

    t_s: float
    wall_ns: int
    reference_deg: float
    measured_deg: float
    command: float
    source: str
    status: str
    predicted_deg: float
    stages_s: tuple[tuple[str, float], ...]
    period_s: float
    lateness_s: float
    missed: bool
    faults: tuple[str, ...]
    sequence: int


class Sink(Protocol):
    """Takes samples from the control thread."""

    def put(self, sample: Sample) -> None:
        """Take a sample; never blocks, never raises, counts what it has to drop."""
        ...

    def close(self) -> None:
        """Write what is left and end."""
        ...
