"""References of the tip angle, and excitation commands for the identification of models.

A trajectory is any object with `duration_s` and `__call__(t)`; see `trajectory.Trajectory`. References are tip
angles [deg]; the excitations of the papers (`excitation`) are commands [mm or bar].
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hystmpc.trials import lazily

if TYPE_CHECKING:
    from .motion import MotionLimits
    from .plane import PlaneMotion, circle, lissajous, raster, ring, spiral, star, through_points, through_tips
    from .point_to_point import PointToPoint, random_point_to_point
    from .scan import Raster, SinusoidScan, TriangleScan
    from .tissue import TissueMotion, on_tissue
    from .trajectory import PreviewTable, Sampled, Trajectory, preview, sample

__all__ = [
    "MotionLimits",
    "PlaneMotion",
    "PointToPoint",
    "PreviewTable",
    "Raster",
    "Sampled",
    "SinusoidScan",
    "TissueMotion",
    "Trajectory",
    "TriangleScan",
    "circle",
    "lissajous",
    "on_tissue",
    "preview",
    "random_point_to_point",
    "raster",
    "ring",
    "sample",
    "spiral",
    "star",
    "through_points",
    "through_tips",
]

if not TYPE_CHECKING:
    __getattr__ = lazily(
        __name__,
        ("hystmpc.trajectories.point_to_point", "PointToPoint random_point_to_point"),
        ("hystmpc.trajectories.motion", "MotionLimits"),
        (
            "hystmpc.trajectories.plane",
            "PlaneMotion circle lissajous raster ring spiral star through_points through_tips",
        ),
        ("hystmpc.trajectories.scan", "Raster SinusoidScan TriangleScan"),
        ("hystmpc.trajectories.tissue", "TissueMotion on_tissue"),
        ("hystmpc.trajectories.trajectory", "PreviewTable Sampled Trajectory preview sample"),
    )
