"""One case: what the diagnosis sees, and the answer that it does not."""

from __future__ import annotations

from dataclasses import dataclass

from hystmpc.models.simulator import Simulator
from hystmpc.trials.trial import Trial

from .answer import Answer


@dataclass(frozen=True, eq=False)
class Case:
    """Logs and nominal simulator of one device.

    Attributes:
        trials: in recording order.
        simulator: identified on other trials of the unaffected device.
        answer: the truth.
    """

    trials: tuple[Trial, ...]
    simulator: Simulator
    answer: Answer
