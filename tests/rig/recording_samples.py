"""Samples as a loop would make them, for the tests of recording and live view."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from hystmpc.rig.recording.sample import Sample

START_NS = 1_700_000_000_000_000_000


def sample(k: int, rate_hz: float = 100.0, **changes: Any) -> Sample:
    """Sample k of a sine."""
    t = k / rate_hz
    reference, command = 30 + 20 * math.sin(t), 3 + 2 * math.sin(t)
    plain = Sample(
        t_s=t,
        wall_ns=START_NS + round(1e9 * t),
        reference_deg=reference,
        measured_deg=reference - 0.4 * math.cos(3 * t),
        command=command,
        source="mpc",
        status="solved",
        predicted_deg=reference + 0.1,
        stages_s=(("estimate", 1e-4), ("plan", 5e-4), ("total", 7e-4)),
        period_s=1 / rate_hz,
        lateness_s=5e-5,
        missed=False,
        faults=(),
        sequence=k,
        taken_s=t,
    )
    return replace(plain, **changes)
