"""Figure of the closed loops before and after the correction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from hystmpc.trials.figure_data import draw_long
from hystmpc.trials.report import ACCENTS, DASHES, MODEL, REFERENCE, new_figure

from .report_data import TrackingCurve
from .words import in_words

_WANTED: Any = {"color": REFERENCE, "linewidth": 2.4, "alpha": 0.45, "label": "reference"}
_BEFORE: Any = {"color": ACCENTS[2], "linewidth": 1.0, "linestyle": DASHES[1], "label": "before"}
_AFTER: Any = {"color": MODEL, "linewidth": 1.0, "label": "after"}


def tracking_figure(curves: Sequence[TrackingCurve]) -> Figure:
    """Above: reference and tip angle before and after. Below: the errors. A column for each motion."""
    with new_figure(7.0, 4.4) as figure:
        rows = figure.subplots(2, len(curves), squeeze=False, sharex="col", sharey="row", height_ratios=(3, 2))
        for (angle, error), curve in zip(rows.T, curves, strict=True):
            draw_long(angle, curve.t, curve.reference_deg, **_WANTED)
            for values, style in ((curve.before_deg, _BEFORE), (curve.after_deg, _AFTER)):
                draw_long(angle, curve.t, values, **style)
                draw_long(error, curve.t, values - curve.reference_deg, **style)
            for axes in (angle, error):
                axes.axvspan(0.0, curve.t[max(curve.first - 1, 0)], color=REFERENCE, alpha=0.12, linewidth=0.0)
            angle.set_title(in_words(curve.name))
            error.set_xlabel("time [s]")
        rows[0, 0].set_ylabel("tip angle [deg]")
        rows[1, 0].set_ylabel("error [deg]")
        figure.legend(*rows[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure
