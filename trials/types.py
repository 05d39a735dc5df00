"""Types of arrays that all rooms use; time is the first axis everywhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vec = NDArray[np.float64]
"""One number a sample or a parameter (T,); also where the axes are named at the place."""

Mat = NDArray[np.float64]
"""Rows by columns, such as samples by parameters (T, P)."""

Mask = NDArray[np.bool_]
"""Whether each sample counts (T,)."""

Index = NDArray[np.intp]
"""Numbers of samples or rows (N,)."""
