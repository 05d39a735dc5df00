"""A phase that stops the run where the tip leaves the angles that the user allows, or those that the sensor shows."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import final

import numpy as np

from hystmpc.rig.experiment.phases import Decision, Past, Phase, PhaseInput
from hystmpc.rig.safety.intake import SensorSettings

MEDIAN = 3
"""Angles whose median is believed: one outlier is no angle."""

BESIDE = 0.02
"""Share of the angle limits by which the tip may pass them in motion, before the run is stopped."""


@final
class Bounded(Phase):
    """Another phase, stopped safely where the median of the last three angles passes the limits by 2 % of them.

    The command's range is found at rest; a device that overshoots in a fast motion goes farther. Angles count as they
    are shown, also beyond the sensor's range and faster than plausible: those are beyond the limits, not missing.

    Args:
        phase: what is done.
        angle_limits: where the tip may go [deg]; None for the range of the sensor.
        sensor: that shows the angle.
    """

    def __init__(self, phase: Phase, angle_limits: tuple[float, float] | None, sensor: SensorSettings) -> None:
        self.name, self._phase = phase.name, phase
        self._which = "commission.angle_limits_deg" if angle_limits else "the range of the sensor"
        low, high = angle_limits or (sensor.lower_deg, sensor.upper_deg)
        more = BESIDE * (high - low)
        self._low, self._high = low - more, high + more
        self._recent: deque[float] = deque(maxlen=MEDIAN)

    @property
    def closed_loop(self) -> bool:
        """As the phase itself."""
        return self._phase.closed_loop

    def begin(self, now: PhaseInput, past: Past) -> None:
        """As the phase itself."""
        self._recent.clear()
        self._phase.begin(now, past)

    def step(self, now: PhaseInput) -> Decision:
        """What the phase decides; a fault beyond the limits."""
        decision = self._phase.step(now)
        keep_shown(self._recent, now)
        angle = float(np.median(self._recent)) if len(self._recent) == MEDIAN else math.nan
        if math.isnan(angle) or self._low <= angle <= self._high:
            return decision
        return replace(decision, u=now.held, fault=f"the angle is {angle:.2f} deg, beyond {self._which}")


def keep_shown(recent: deque[float], now: PhaseInput) -> None:
    """Keep the angle that is shown in this sample, where one is."""
    shown = now.angle_deg if math.isfinite(now.angle_deg) else now.shown_deg
    if math.isfinite(shown):
        recent.append(shown)
