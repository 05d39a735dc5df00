"""Cases of the campaign as short as they can be: the fault comes in the first rise, of a scan that is twice as fast."""

from __future__ import annotations

from dataclasses import replace

from hystmpc_lab.faults.cases import CASES, FaultCase

AT_S = 1.2  # the device holds some 2.5 mm and rises


def brief(name: str, cycles: int = 3) -> FaultCase:
    """Case of a name, with so many cycles of the scan where it does not say how many."""
    case = next(case for case in CASES if case.name == name)
    reference = {"frequency_hz": 0.8, "cycles": cycles, **case.settings.get("reference", {})}
    return replace(
        case,
        at_s=AT_S,
        device=tuple({**fault, "start_s": AT_S} for fault in case.device),
        settings={**case.settings, "reference": reference},
    )
