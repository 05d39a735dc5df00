"""State of a run over the last seconds for the live views, and the thread that updates a view."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import Counter, deque
from collections.abc import Iterable
from typing import final

import numpy as np

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec, rms

from ..axes import each, spread
from ..histogram import Histogram
from ..recording.sample import Sample, ThreadedSink

WINDOW_S = 20.0
"""How much of the run is plotted [s]."""

_POINTS_PER_S = 50.0  # of the plots; the figures are made of all samples
_PERIOD_S = 0.125  # between two snapshots shown
_CLOSE_S = 5.0


@final
class LiveState:
    """State of a run for the live views, updated by one thread.

    Attributes:
        t, reference, angle, command: the last 20 s, decimated, (P,), of two axes (P, 2) but for `t`; not-a-number
            without an angle.
        rms_deg, rate_hz: tracking error and real rate of the loop over these 20 s; of two axes the error is the
            distance in their plane.
        late, total: histograms of lateness and of the execution time of a sample, since the start.
        faults, fault_s: samples with each fault since the start, and the time of the last one [s].
        notes: messages from elsewhere, such as an end of the recording.

    Raises:
        ConfigError: if the rate is not positive.
    """

    last: Sample
    t: Vec
    reference: Vec
    angle: Vec
    command: Vec
    rms_deg: float
    rate_hz: float

    def __init__(self, rate_hz: float) -> None:
        if not (math.isfinite(rate_hz) and rate_hz > 0):
            raise ConfigError(f"live view: got a rate of {rate_hz} Hz, expected a positive number")
        self._recent: deque[tuple[float, ...]] = deque(maxlen=max(round(WINDOW_S * rate_hz), 2))
        self._stride = max(round(rate_hz / _POINTS_PER_S), 1)
        self.late, self.total = Histogram(2 / rate_hz), Histogram(2 / rate_hz)
        self.missed = self._count = 0
        self.faults: Counter[str] = Counter()
        self.fault_s: dict[str, float] = {}
        self.notes: deque[str] = deque(maxlen=3)

    def update(self, samples: Iterable[Sample]) -> bool:
        """Add samples in the order of the run; False before the first one."""
        for sample in samples:
            axes = len(each(sample.command))
            signals = (spread(value, axes) for value in (sample.reference_deg, sample.measured_deg, sample.command))
            self._recent.append((sample.t_s, *(one for signal in signals for one in signal)))
            self.late.add(sample.lateness_s)
            self.total.add(dict(sample.stages_s).get("total", math.fsum(spent for _, spent in sample.stages_s)))
            self.missed += bool(sample.missed)
            for fault in sample.faults:
                self.faults[fault] += 1
                self.fault_s[fault] = sample.t_s
            self.last = sample
            self._count += 1
        if not self._count:
            return False
        rows = np.array(self._recent)
        span = float(rows[-1, 0] - rows[0, 0])
        # Counted from the start, so that a point that was shown stays where it was.
        shown = rows[(self._stride - 1 - (self._count - len(rows))) % self._stride :: self._stride]
        axes = len(each(self.last.command))
        parts = [shown[:, 1 + k * axes : 1 + (k + 1) * axes] for k in range(3)]
        self.t = shown[:, 0]
        self.reference, self.angle, self.command = parts if axes > 1 else (part[:, 0] for part in parts)
        error = rows[:, 1 : 1 + axes] - rows[:, 1 + axes : 1 + 2 * axes]
        self.rms_deg = rms(error[:, 0] if axes == 1 else np.hypot(*error.T))
        self.rate_hz = (len(rows) - 1) / span if span > 0 else math.nan
        return True


class LiveView(ThreadedSink):
    """Thread that shows the state 8 times a second; an error ends the view, never the run.

    Raises:
        ConfigError: if the rate of the loop [Hz] is not positive.
    """

    def __init__(self, rate_hz: float) -> None:
        self._state = LiveState(rate_hz)
        super().__init__("hystmpc-live", rate_hz, _PERIOD_S)
        self._thread.start()

    def tell(self, text: str) -> None:
        """Show a message, such as the end of the recording."""
        self._state.notes.append(text)

    def close(self) -> None:
        self._finish(_CLOSE_S)

    @abstractmethod
    def _show(self, state: LiveState) -> None:
        """Draw or publish the state."""

    def _turn(self, samples: list[Sample], ending: bool) -> bool:
        del ending
        try:
            if self._state.update(samples):
                self._show(self._state)
        except Exception as error:  # noqa: BLE001 - a terminal that goes away or an odd sample must not end a run
            self.problem = f"{type(error).__name__}: {error}"
            self._waiting.closed = True
        return not self.problem
