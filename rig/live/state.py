"""State of a run over the last seconds for the live views, and the thread that updates a view."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from ..histogram import Histogram
from ..recording.sample import Sample, ThreadedSink

WINDOW_S = 20.0
"""How much of the run is plotted [s]."""

_POINTS_PER_S = 50.0  # of the plots; the figures are made of all samples
_PERIOD_S = 0.125  # between two snapshots shown
_CLOSE_S = 5.0


@dataclass(frozen=True, eq=False)
class LiveSnapshot:
    """State of a run for the live views.

    Attributes:
        t, reference, angle, command: the last 20 s, decimated, (P,); not-a-number without an angle.
        rms_deg, rate_hz: tracking error and real rate of the loop over these 20 s.
        late, total: histograms of lateness and of the execution time of a sample, since the start.
        faults, fault_s: samples with each fault since the start, and the time of the last one [s].
    """

    last: Sample  # the newest sample
    t: Vec
    reference: Vec
    angle: Vec
    command: Vec
    rms_deg: float
    rate_hz: float
    late: Histogram
    total: Histogram
    missed: int  # deadlines missed since the start
    faults: dict[str, int]
    fault_s: dict[str, float]
    notes: tuple[str, ...]  # messages from elsewhere, such as an end of the recording


@final
class LiveState:
    """Gathers samples for the views; used by one thread.

    Raises:
        ConfigError: if the rate is not positive.
    """

    def __init__(self, rate_hz: float) -> None:
        if not (math.isfinite(rate_hz) and rate_hz > 0):
            raise ConfigError(f"live view: got a rate of {rate_hz} Hz, expected a positive number")
        self._recent: deque[tuple[float, float, float, float]] = deque(maxlen=max(round(WINDOW_S * rate_hz), 2))
        self._stride = max(round(rate_hz / _POINTS_PER_S), 1)
        self._late, self._total = Histogram(2 / rate_hz), Histogram(2 / rate_hz)
        self._missed = self._count = 0
        self._faults: Counter[str] = Counter()
        self._fault_s: dict[str, float] = {}
        self._last: Sample | None = None
        self.notes: deque[str] = deque(maxlen=3)

    def update(self, samples: Iterable[Sample]) -> None:
        """Add samples in the order of the run."""
        for sample in samples:
            self._recent.append((sample.t_s, sample.reference_deg, sample.measured_deg, sample.command))
            self._late.add(sample.lateness_s)
            self._total.add(dict(sample.stages_s).get("total", math.fsum(spent for _, spent in sample.stages_s)))
            self._missed += bool(sample.missed)
            for fault in sample.faults:
                self._faults[fault] += 1
                self._fault_s[fault] = sample.t_s
            self._last = sample
            self._count += 1

    def snapshot(self) -> LiveSnapshot | None:
        """Snapshot of the last 20 s, None before the first sample."""
        if self._last is None:
            return None
        rows = np.array(self._recent)
        error = rows[:, 1] - rows[:, 2]
        known = error[np.isfinite(error)]
        span = float(rows[-1, 0] - rows[0, 0])
        # Counted from the start, so that a point that was shown stays where it was.
        shown = rows[(self._stride - 1 - (self._count - len(rows))) % self._stride :: self._stride]
        return LiveSnapshot(
            last=self._last,
            t=shown[:, 0],
            reference=shown[:, 1],
            angle=shown[:, 2],
            command=shown[:, 3],
            rms_deg=float(np.sqrt(np.mean(known**2))) if known.size else math.nan,
            rate_hz=(len(rows) - 1) / span if span > 0 else math.nan,
            late=self._late,
            total=self._total,
            missed=self._missed,
            faults=dict(self._faults),
            fault_s=dict(self._fault_s),
            notes=tuple(self.notes),
        )


class LiveView(ThreadedSink):
    """Shows a snapshot 8 times a second by a thread of its own; an error ends the view, never the run.

    Raises:
        ConfigError: if the rate of the loop [Hz] is not positive.
    """

    def __init__(self, rate_hz: float) -> None:
        self._state = LiveState(rate_hz)
        super().__init__("hystmpc-live", rate_hz, _PERIOD_S)
        self._thread.start()

    def tell(self, text: str) -> None:
        """Show a message, such as an end of the recording."""
        self._state.notes.append(text)

    def close(self) -> None:
        """Show the last state and end."""
        self._finish(_CLOSE_S)

    @abstractmethod
    def _show(self, snapshot: LiveSnapshot) -> None:
        """Draw or publish."""

    def _turn(self, samples: list[Sample], ending: bool) -> bool:
        del ending
        try:
            self._state.update(samples)
            if (snapshot := self._state.snapshot()) is not None:
                self._show(snapshot)
        except Exception as error:  # noqa: BLE001 - a terminal that goes away or an odd sample must not end a run
            self.problem = f"{type(error).__name__}: {error}"
            self._waiting.closed = True
        return not self.problem
