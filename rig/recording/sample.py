"""Samples of the control loop, and sinks and queues that receive them from the control thread."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from threading import Event, Thread
from typing import Protocol, final

from hystmpc.trials.layouts import CANONICAL

from ..axes import PerAxis, columns, each

TAKEN = "angle_taken_s"
"""Column of the time at which the angle of a row was taken."""

_QUEUE_S = 30.0  # how long a disk, a terminal or another process may be stuck before samples are dropped


@dataclass(frozen=True, slots=True)
class Sample:
    """One sample of the control loop; the angle is the one from which the controller chose the command."""

    t_s: float  # monotonic time since the start of the run [s]
    wall_ns: int  # wall clock [ns since 1970]; it may jump, `t_s` may not
    reference_deg: PerAxis  # wanted angle at the end of the sample [deg]
    measured_deg: PerAxis  # measured angle, NaN without a usable one [deg]
    command: PerAxis  # really sent, in the run's unit; of the source `wait` the reported one, since nothing was sent
    source: str  # origin: mpc, shifted plan, inverse, hold, stop, wait, return, await start, or a preparation step
    status: str  # one line of explanation
    predicted_deg: PerAxis  # angle predicted for the end of the sample, NaN without one [deg]
    stages_s: tuple[tuple[str, float], ...]  # name and duration of every stage, such as estimate, plan, total [s]
    period_s: float  # time since the previous sample's start [s]
    lateness_s: float  # delay of the sample's start after its deadline [s]
    missed: bool  # whether the command was sent after the end of the sample
    faults: tuple[str, ...]  # names of the faults in this sample
    sequence: int  # number of the sample, counted from 0
    taken_s: float = math.nan  # when the angle was taken, on the clock of `t_s`: earlier for a frame; NaN without one
    inputs: Mapping[str, float] = field(default_factory=dict)  # newest usable values; NaN before the first

    def motion(self, command: str) -> dict[str, float]:
        """Time, command and angles by the name of their column; `command` is that of the command, as `command_mm`.

        Two axes have a column each: `command_x`, `command_y`, `angle_x_deg`, `angle_y_deg`.
        """
        axes = len(each(self.command))
        return {
            CANONICAL.time: self.t_s,
            **columns(command, self.command, axes),
            **columns(CANONICAL.angle, self.measured_deg, axes),
            TAKEN: self.taken_s,
            **columns("reference_deg", self.reference_deg, axes),
            **columns("predicted_deg", self.predicted_deg, axes),
            **self.inputs,
        }


class Sink(Protocol):
    """Receiver of samples from the control thread."""

    def put(self, sample: Sample) -> None:
        """Accept a sample; never blocks, never raises, counts dropped samples."""
        ...

    def close(self) -> None:
        """Write the remaining samples and end."""
        ...


@final
class SampleQueue:
    """Bounded queue for one producer thread and one consumer thread.

    `deque.append` and `popleft` are single steps of the interpreter, so the control thread never waits for a lock. A
    full queue refuses the newest sample, so that a recording has no hole before the one at its end.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._samples: deque[Sample] = deque()
        self.dropped = 0
        self.closed = False

    def put(self, sample: Sample) -> None:
        """Add a sample, or count it as dropped if the queue is full or closed; never blocks, never raises."""
        if self.closed or len(self._samples) >= self._most:
            self.dropped += 1
        else:
            self._samples.append(sample)

    def take(self) -> list[Sample]:
        """Remove and return the samples in the queue, oldest first."""
        count = len(self._samples)
        return [self._samples.popleft() for _ in range(count)]

    def __len__(self) -> int:
        return len(self._samples)


class ThreadedSink(Sink, ABC):
    """Sink with a queue and a separate thread, so that a blocked thread never delays the control loop.

    Args:
        thread: name of the thread, which a subclass starts once it is ready.
        rate_hz: rate of the loop; 30 s of samples may wait [Hz].
        period_s: time between two turns of the thread [s].
    """

    def __init__(self, thread: str, rate_hz: float, period_s: float) -> None:
        self._waiting = SampleQueue(max(round(_QUEUE_S * rate_hz), 10))
        self._period_s = period_s
        self.problem = ""
        self._end = Event()
        self._thread = Thread(target=self._work, name=thread, daemon=True)

    @property
    def dropped(self) -> int:
        """Number of samples that did not reach the thread, since the queue was full or closed."""
        return self._waiting.dropped

    def put(self, sample: Sample) -> None:
        self._waiting.put(sample)

    def _finish(self, patience_s: float) -> bool:
        """Let the thread process the waiting samples and end; return False after an earlier call."""
        if self._end.is_set():
            return False
        self._waiting.closed = True
        self._end.set()
        self._thread.join(patience_s)
        return True

    @abstractmethod
    def _turn(self, samples: list[Sample], ending: bool) -> bool:
        """Process the waiting samples in the thread; return False to end it."""

    def _work(self) -> None:
        ending, going = False, True
        while going and not ending:
            ending = self._end.wait(self._period_s)
            going = self._turn(self._waiting.take(), ending)


@final
class SampleList(Sink):
    """Sink that keeps all samples in memory."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []

    def put(self, sample: Sample) -> None:
        self.samples.append(sample)

    def close(self) -> None: ...


@final
class Tee(Sink):
    """Sink that passes every sample to several sinks."""

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
        """Close every sink in reverse order, even if one of them fails."""
        faults = []
        for sink in reversed(self._sinks):
            try:
                sink.close()
            except Exception as error:  # noqa: BLE001 - the others are to be closed all the same
                faults.append(error)
        if faults:
            raise faults[0]
