"""A sink that shows: samples wait, and a thread of its own takes them a few times a second."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import final

from ..recording.waiting import Waiting
from ..sample import Sample, Sink
from .state import LiveState, Snapshot

_QUEUE_S = 30.0
_CLOSE_S = 5.0


@final
class Watched(Sink):
    """Calls `show` with a snapshot at a steady rate, as long as there is one.

    Args:
        rate_hz: rate of the loop [Hz].
        show: draws or publishes; what it raises ends the view, never the run.
        period_s: time between calls [s].

    Raises:
        ConfigError: if the rate is not positive.
    """

    def __init__(self, rate_hz: float, show: Callable[[Snapshot], None], period_s: float) -> None:
        self._state = LiveState(rate_hz)
        self._waiting = Waiting(max(round(_QUEUE_S * rate_hz), 10))
        self._show = show
        self._period_s = period_s
        self.problem = ""
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._work, name="hystmpc-live", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Samples that were not shown."""
        return self._waiting.dropped

    def put(self, sample: Sample) -> None:
        """Take a sample; never blocks, never raises, counts what it has to drop."""
        self._waiting.put(sample)

    def tell(self, text: str) -> None:
        """Show a line, such as that recording has stopped."""
        self._state.notes.append(text)

    def close(self) -> None:
        """Show the last state and end."""
        self._waiting.closed = True
        self._end.set()
        self._thread.join(_CLOSE_S)

    def _work(self) -> None:
        ending = False
        while not ending:
            ending = self._end.wait(self._period_s)
            try:
                self._state.update(self._waiting.take())
                if (snapshot := self._state.snapshot()) is not None:
                    self._show(snapshot)
            except Exception as error:  # noqa: BLE001 - a terminal that goes away or an odd sample must not end a run
                self.problem = f"{type(error).__name__}: {error}"
                self._waiting.closed = True
                return
