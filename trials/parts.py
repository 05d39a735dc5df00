"""Progress of a computation of several parts, told as that of the whole."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

from .types import Progress


def parts(progress: Progress | None, seconds: Sequence[float]) -> tuple[Progress, ...]:
    """The progress of each part, in units of the whole: a bar's time left is then that of all of them.

    Args:
        progress: of the whole; None where nobody looks.
        seconds: expected time of each part, in their order; only their ratios matter.
    """
    total = sum(seconds)

    def part(before: float, own: float) -> Progress:
        def told(done: float, steps: float, note: str = "", /) -> None:
            if progress is not None:
                progress(before + own * min(done / max(steps, 1e-9), 1.0), total, note)

        return told

    starts = [0.0, *accumulate(seconds)][:-1]
    return tuple(part(before, own) for before, own in zip(starts, seconds, strict=True))
