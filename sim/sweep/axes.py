"""Logarithmic axes with plain numbers."""

from __future__ import annotations

import math

from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter

_FEW = ((100.0, (1,)), (8.0, (1, 2, 5)))  # from this ratio of the ends on only these leading digits are shown


def plain_log(axis: Axis) -> None:
    """Ticks of a logarithmic axis as 0.4, 1, 2 and not as powers of ten; fewer the more decades there are."""

    def text(value: float, _: object) -> str:
        low, high = sorted(axis.get_view_interval())
        digits = next((shown for ratio, shown in _FEW if high > ratio * low), range(1, 10))
        leading = round(value / 10.0 ** math.floor(math.log10(value) + 1e-9)) if value > 0 else 0
        return f"{value:g}" if leading in digits else ""

    axis.set_major_formatter(FuncFormatter(text))
    axis.set_minor_formatter(FuncFormatter(text))
