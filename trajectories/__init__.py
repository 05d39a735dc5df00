"""References and excitations: what the tip shall do, and what commands a model is identified on.

A trajectory is any object with `duration_s` and `__call__(t)`; see `trajectory.Trajectory`. References are tip
angles [deg]; the excitations of the papers (`excitation`) are commands [mm or bar].
"""

from .point_to_point import PointToPoint, random_point_to_point
from .preview import PreviewTable, preview
from .ruckig_ import MotionLimits
from .scan import Raster, SinusoidScan, TriangleScan
from .trajectory import Sampled, Trajectory, sample

__all__ = [
    "MotionLimits",
    "PointToPoint",
    "PreviewTable",
    "Raster",
    "Sampled",
    "SinusoidScan",
    "Trajectory",
    "TriangleScan",
    "preview",
    "random_point_to_point",
    "sample",
]
