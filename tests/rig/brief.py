"""Cases of the campaign as short as they can be: the fault comes in the first rise, of a scan that is twice as fast."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hystmpc_lab.faults.cases import CASES, FaultCase

AT_S = 1.2  # the device holds some 2.5 mm and rises


def brief(name: str, **settings: Any) -> FaultCase:
    """Case of a name, in which two cycles of the scan follow the fault; `settings` change those of the run."""
    case = next(case for case in CASES if case.name == name)
    reference = {"frequency_hz": 0.8, "cycles": 3, **case.settings.get("reference", {})}
    return replace(
        case,
        at_s=AT_S,
        device=tuple({**fault, "start_s": AT_S} for fault in case.device),
        settings={**case.settings, **settings, "reference": reference},
    )
