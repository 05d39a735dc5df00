"""The verdict in one sentence."""

from __future__ import annotations

from collections.abc import Sequence

from .diagnosis import FoundEffect, Gap, Verdict
from .verdict import Ruling


def reason_for(
    verdict: Verdict, effects: Sequence[FoundEffect], ruling: Ruling, gap: Gap, lacks: str, unrelated: str = ""
) -> str:
    """What was concluded, and from which numbers; `lacks` and `unrelated` as `Prepared` has them."""
    sizes = f"retuned {gap.retuned_rmse_deg:.2f} deg, floor {gap.floor_rmse_deg:.2f} deg"
    names = ", ".join(effect.name.replace("_", " ") for effect in effects)
    closed = f"{100 * gap.closed_share:.0f} % of the structural gap closed on trials kept for the end"
    if verdict == "named":
        return f"{names}: {closed}, {100 * gap.unexplained_share:.0f} % unexplained ({sizes})"
    if verdict == "one_of":
        sets = "; ".join(" or ".join(name.replace("_", " ") for name in names) for names in ruling.ambiguity)
        return f"one of {sets}: these trials cannot tell them apart; {closed} ({sizes})"
    if verdict == "unknown" and unrelated:
        return f"{unrelated} ({sizes})"
    if verdict == "unknown":
        return f"a structural gap that no effect of the library explains ({sizes})"
    if verdict == "none":
        return f"no structural gap: retuning leaves no more than noise and the simulator's own form error ({sizes})"
    return f"too little: {lacks} ({sizes})"
