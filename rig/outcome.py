"""How a run at a bench ended."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Outcome:
    """What the loop says of a run when it is over.

    Attributes:
        cause: why it was stopped; empty after a run that came to its end.
        samples: samples with a command, and those skipped.
        stop_s, safe_s: monotonic time since the start at which the stop began, and at which the safe command had been
            sent and, where `confirmed`, was held [s]; NaN without a stop, or where nothing could be sent any more.
        confirmed: whether the device has said that it holds the safe command.
        clipped: commands that the last line has limited.
        unsent: commands that the transport did not take.
        refused: samples on which the sink raised, which it should not.
        faults: samples by fault.
    """

    cause: str
    samples: int
    stop_s: float
    safe_s: float
    confirmed: bool
    clipped: int
    unsent: int
    refused: int
    faults: dict[str, int]
