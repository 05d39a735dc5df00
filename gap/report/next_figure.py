"""What next: the motion to record, what the candidates make of it, and where they part."""

from __future__ import annotations

from matplotlib.figure import Figure

from hystmpc.trials.report import MODEL, PALETTE, REFERENCE, new_figure

from ..next_motion import Proposal
from .look import COMMANDED, plain, thin

_DASHES = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (6, 1, 1, 1)), (0, (3, 1, 1, 1, 1, 1)))
_COLOURS = (PALETTE[0], PALETTE[1], PALETTE[3], PALETTE[5], PALETTE[4])


def next_figure(proposal: Proposal, unit: str) -> Figure:
    """Command of the proposed motion, angles expected of each candidate, and their separation after retuning."""
    chosen = proposal.chosen
    t, command, separation, *angles = thin(chosen.motion.t, chosen.motion.command, chosen.separation, *chosen.angles)
    with new_figure(7.0, 4.6) as figure:
        rows = figure.subplots(3, 1, sharex=True, height_ratios=(3, 4, 2.4))
        rows[0].plot(t, command, **COMMANDED)
        rows[0].set(ylabel=f"command [{unit}]", title=plain(chosen.motion.name))
        for k, (name, angle) in enumerate(zip(proposal.names, angles, strict=True)):
            style = {"color": _COLOURS[k % 5], "linestyle": _DASHES[k % 5], "linewidth": 1.2}
            rows[1].plot(t, angle, label=f"if {plain(name)}", **style)
        rows[1].set_ylabel("tip angle [deg]")
        rows[1].legend(loc="upper right", ncols=min(len(angles), 3))
        low, high = rows[1].get_ylim()
        rows[1].set_ylim(low, high + 0.22 * (high - low))
        rows[2].fill_between(t, separation, color=MODEL, alpha=0.75, linewidth=0.0)
        rows[2].set_ylabel("apart after\nretuning [deg]")
        rows[2].set_ylim(bottom=0.0)
        rows[2].set_xlabel("time [s]")
        rows[2].axhline(0.0, color=REFERENCE, linewidth=0.6)
    return figure
