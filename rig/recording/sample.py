"""One sample at the bench and the sinks that take it: the border between control thread and recording."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol, final


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
        source: what chose it: mpc, shifted plan, inverse, hold, stop, wait, return, await start, or a preparation step.
        status: one line on what happened.
        predicted_deg: angle predicted for the end of the sample, NaN without one [deg].
        stages_s: name and duration of every stage, such as estimate, plan, total [s].
        period_s: time since the previous sample's start [s].
        lateness_s: how late the sample started behind its deadline [s].
        missed: whether the command was sent after the end of the sample.
        faults: names of the faults seen in this sample.
        sequence: number of the sample, counted from 0.
        taken_s: when the measured angle was taken, on the clock of `t_s`: earlier for a frame; NaN without one [s].
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
    taken_s: float = math.nan


class Sink(Protocol):
    """Takes samples from the control thread."""

    def put(self, sample: Sample) -> None:
        """Take a sample; never blocks, never raises, counts what it has to drop."""
        ...

    def close(self) -> None:
        """Write what is left and end."""
        ...


@final
class SampleQueue:
    """A bounded queue with one thread that puts and one that takes.

    `deque.append` and `popleft` are single steps of the interpreter, so no lock is taken that the control thread could
    have to wait for. A full queue refuses the newest sample: what is recorded has no hole before the one at its end.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._samples: deque[Sample] = deque()
        self.dropped = 0
        self.closed = False

    def put(self, sample: Sample) -> None:
        """Take a sample, or count it as dropped where the queue is full or closed; never blocks, never raises."""
        if self.closed or len(self._samples) >= self._most:
            self.dropped += 1
        else:
            self._samples.append(sample)

    def take(self) -> list[Sample]:
        """All that waits now, oldest first."""
        count = len(self._samples)
        return [self._samples.popleft() for _ in range(count)]

    def __len__(self) -> int:
        return len(self._samples)


@final
class SampleList(Sink):
    """All samples, in memory."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []

    def put(self, sample: Sample) -> None:
        self.samples.append(sample)

    def close(self) -> None:
        """Nothing to do."""


@final
class Tee(Sink):
    """Gives every sample to every sink."""

    def __init__(self, *sinks: Sink) -> None:
        self._sinks = sinks
        self.broken = 0  # puts that raised in spite of the promise

    def put(self, sample: Sample) -> None:
        for sink in self._sinks:
            try:
                sink.put(sample)
            except Exception:  # noqa: BLE001 - this is called by the control thread
                self.broken += 1

    def close(self) -> None:
        """Close every sink, the last one first, also where another one fails."""
        faults = []
        for sink in reversed(self._sinks):
            try:
                sink.close()
            except Exception as error:  # noqa: BLE001 - the others are to be closed all the same
                faults.append(error)
        if faults:
            raise faults[0]
