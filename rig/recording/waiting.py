"""Samples on their way from the control thread to a thread that has time."""

from __future__ import annotations

from collections import deque
from typing import final

from ..sample import Sample


@final
class Waiting:
    """A bounded queue with one thread that puts and one that takes.

    `deque.append` and `popleft` are single steps of the interpreter, so no lock is taken that the control thread could
    have to wait for. A full queue refuses the newest sample: what is recorded has no hole before the one at its end.

    Args:
        most: samples that may wait.
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
