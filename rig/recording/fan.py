"""One sink that is several."""

from __future__ import annotations

from typing import final

from ..sample import Sample, Sink


@final
class Fan(Sink):
    """Gives every sample to every sink.

    Args:
        sinks: each keeps the promise of `Sink`; one that breaks it does not keep the sample from the others.
    """

    def __init__(self, *sinks: Sink) -> None:
        self._sinks = sinks
        self.broken = 0  # puts that raised in spite of the promise

    def put(self, sample: Sample) -> None:
        """Give the sample to every sink."""
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
