"""Motions in settings files: one settings block per kind, selected by the key `kind`."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field

from hystmpc.trials.config import NotNegative, OfBothAxes, Positive, Settings
from hystmpc.trials.errors import ConfigError, did_you_mean

from .motion import MotionLimits, MotionSettings, TrajectorySettings
from .plane import (
    PlaneMotion,
    circle,
    lissajous,
    raster,
    ring,
    spiral,
    star,
    through_points,
    through_tips,
)
from .point_to_point import PointToPoint, RandomPointToPointSettings
from .scan import Raster, SinusoidScan, TriangleScan
from .tissue import TissueMotion, on_tissue
from .trajectory import Sampled, read_sampled


class SampledSettings(MotionSettings):
    """Linear interpolation of a CSV file with the columns time_s and angle_deg, see read_sampled.

    Attributes:
        file: name of the CSV file; a relative name starts at the folder of the configuration.
    """

    kind: Literal["sampled"] = "sampled"
    file: Path

    def build(self, folder: Path | str = ".") -> Sampled:
        """Read the CSV file."""
        return read_sampled(Path(folder) / self.file)


Point = Annotated[tuple[float, float], OfBothAxes]
AnyMotion = PointToPoint | RandomPointToPointSettings | SinusoidScan | TriangleScan | Raster | SampledSettings
MOTIONS: Mapping[str, type[AnyMotion]] = {kind.model_fields["kind"].default: kind for kind in get_args(AnyMotion)}
"""Every kind of motion that a configuration can name."""


class TissueSettings(Settings):
    """Block `tissue`: shifts of a target, see `TissueMotion`; in the numbers of its motion.

    Attributes:
        breathing: greatest shift of x and y by a breath.
        breath_s: duration of a breath [s].
        heartbeat: greatest shift of x and y by a heartbeat.
        beats_per_min: heart rate.
    """

    breathing: Point = (0.0, 0.0)
    breath_s: Positive = 4.0
    heartbeat: Point = (0.0, 0.0)
    beats_per_min: Positive = 70.0

    def build(self) -> TissueMotion:
        """The shifts over time."""
        return TissueMotion(self.breathing, self.breath_s, self.heartbeat, self.beats_per_min)


class PlaneMotionSettings(TrajectorySettings):
    """Base of the settings of motions of two axes; points and sizes are angles x, y [deg], or mm with `length_mm`.

    Attributes:
        length_mm: length of the bending part: points and sizes are then tip positions x, y [mm], of a bend of constant
            curvature.
        tissue: breathing and heartbeat that move the target; null for a target at rest.
    """

    length_mm: Positive | None = None
    tissue: TissueSettings | None = None

    @abstractmethod
    def drawn(self) -> PlaneMotion:
        """Motion in the numbers of the settings."""

    def build(self) -> PlaneMotion:
        """Motion of both angles [deg].

        Raises:
            TrajectoryError: if it cannot be drawn, or a tip is out of reach.
        """
        motion = self.drawn() if self.tissue is None else on_tissue(self.drawn(), self.tissue.build())
        return motion if self.length_mm is None else through_tips(motion, self.length_mm)


class CircleSettings(PlaneMotionSettings):
    """Circle, see `hystmpc.trajectories.circle`.

    Attributes:
        centre: x, y [deg or mm].
        radius: [deg or mm].
        period_s: of one turn [s].
        turns: number of turns.
    """

    kind: Literal["circle"] = "circle"
    centre: Point
    radius: Positive
    period_s: Positive
    turns: Positive = 1.0

    def drawn(self) -> PlaneMotion:
        return circle(self.centre, self.radius, self.period_s, self.turns)


class SpiralSettings(PlaneMotionSettings):
    """Spiral from its centre outwards, see `hystmpc.trajectories.spiral`.

    Attributes:
        centre: x, y [deg or mm].
        radius: at the end [deg or mm].
        period_s: of one turn [s].
        turns: number of turns.
    """

    kind: Literal["spiral"] = "spiral"
    centre: Point
    radius: Positive
    period_s: Positive
    turns: Positive = 3.0

    def drawn(self) -> PlaneMotion:
        return spiral(self.centre, self.radius, self.period_s, self.turns)


class LissajousSettings(PlaneMotionSettings):
    """Lissajous figure, see `hystmpc.trajectories.lissajous`.

    Attributes:
        centre: x, y [deg or mm].
        sizes: amplitudes of x and y [deg or mm].
        ratio: periods of x and of y in one turn.
        period_s: of one turn [s].
        turns: number of turns.
    """

    kind: Literal["lissajous"] = "lissajous"
    centre: Point
    sizes: Annotated[tuple[Positive, Positive], OfBothAxes]
    ratio: tuple[int, int] = (3, 2)
    period_s: Positive
    turns: Positive = 1.0

    def drawn(self) -> PlaneMotion:
        return lissajous(self.centre, self.sizes, self.ratio, self.period_s, self.turns)


class MovesSettings(PlaneMotionSettings):
    """Base of motions along straight lines.

    Attributes:
        hold_s: rest at every corner [s].
        limits: along each line; with `length_mm` a degree is the way of the tip of a nearly straight device,
            length_mm / 2 per rad.
    """

    hold_s: NotNegative = 0.5
    limits: MotionLimits = MotionLimits()

    @property
    def along(self) -> MotionLimits:
        """Limits in the numbers of the settings."""
        share = 1.0 if self.length_mm is None else math.radians(self.length_mm / 2)
        return MotionLimits(*(share * getattr(self.limits, name) for name in MotionLimits.model_fields))


class PointsSettings(MovesSettings):
    """Straight moves through points, see `hystmpc.trajectories.through_points`.

    Attributes:
        points: x, y of each [deg or mm], at least two.
    """

    kind: Literal["points"] = "points"
    points: tuple[Point, ...] = Field(min_length=2)

    def drawn(self) -> PlaneMotion:
        return through_points(self.points, self.hold_s, self.along)


class StarSettings(MovesSettings):
    """Star of straight lines, see `hystmpc.trajectories.star`.

    Attributes:
        centre: x, y [deg or mm].
        radius: of its tips [deg or mm].
        tips: number of tips, odd.
    """

    kind: Literal["star"] = "star"
    centre: Point
    radius: Positive
    tips: int = Field(5, ge=3)

    def drawn(self) -> PlaneMotion:
        return star(self.centre, self.radius, self.tips, self.hold_s, self.along)


class RingSettings(MovesSettings):
    """Targets on a ring, each reached from the centre, see `hystmpc.trajectories.ring`.

    Attributes:
        centre: x, y [deg or mm].
        radius: of the ring [deg or mm].
        targets: number of targets.
    """

    kind: Literal["ring"] = "ring"
    centre: Point
    radius: Positive
    targets: int = Field(8, ge=3)

    def drawn(self) -> PlaneMotion:
        return ring(self.centre, self.radius, self.targets, self.hold_s, self.along)


class RowsSettings(MovesSettings):
    """Raster of rows along x, to and fro, see `hystmpc.trajectories.raster`.

    Attributes:
        corner, far_corner: x, y of two opposite corners [deg or mm].
        rows: number of rows.
    """

    kind: Literal["raster"] = "raster"
    corner: Point
    far_corner: Point
    rows: int = Field(4, ge=1)

    def drawn(self) -> PlaneMotion:
        return raster(self.corner, self.far_corner, self.rows, self.hold_s, self.along)


AnyPlaneMotion = (
    CircleSettings | SpiralSettings | LissajousSettings | PointsSettings | StarSettings | RingSettings | RowsSettings
)
PLANE_MOTIONS: Mapping[str, type[AnyPlaneMotion]] = {
    kind.model_fields["kind"].default: kind for kind in get_args(AnyPlaneMotion)
}
"""Every kind of motion of two axes that a configuration can name."""


def _kind_among(kinds: Mapping[str, Any], others: Mapping[str, Any], axes: str) -> Callable[[Any], Any]:
    """Refuse a missing or unknown kind with a list of the kinds; `others` are those of other devices than `axes`."""

    def known(data: Any) -> Any:
        if isinstance(data, Mapping):
            if "kind" not in data:
                raise ValueError(f"no key 'kind', available: {', '.join(sorted(kinds))}")
            kind = data["kind"]
            # A kind read from YAML may be anything, also what a mapping cannot be asked for.
            if not isinstance(kind, str) or kind not in kinds:
                hint = f", which is none of {axes}" if isinstance(kind, str) and kind in others else ""
                raise ValueError(f"unknown kind {kind!r}{hint}, {did_you_mean(str(kind), kinds)}")
        return data

    return known


_known_kind = _kind_among(MOTIONS, PLANE_MOTIONS, "one axis")
Motion = Annotated[AnyMotion, Field(discriminator="kind"), BeforeValidator(_known_kind)]
"""Type of a field of another block: `reference: Motion`."""
MotionInPlane = Annotated[
    AnyPlaneMotion, Field(discriminator="kind"), BeforeValidator(_kind_among(PLANE_MOTIONS, MOTIONS, "two axes"))
]
"""The same of two axes."""


def motion_in(folder: Path, motion: AnyMotion) -> AnyMotion:
    """Motion of a configuration in `folder`, with an absolute file name."""
    return motion.model_copy(update={"file": folder / motion.file}) if isinstance(motion, SampledSettings) else motion


def parse_motion(data: Any, where: str = "<memory>") -> MotionSettings:
    """Validate one motion given as plain data.

    Raises:
        ConfigError: on an unknown kind, an unknown key or a value out of bounds.
    """
    if not isinstance(data, Mapping):
        raise ConfigError(f"{where}: got {type(data).__name__}, expected a mapping with the key 'kind'")
    try:
        _known_kind(data)
    except ValueError as error:
        raise ConfigError(f"{where}: {error}") from None
    return MOTIONS[data["kind"]].parse(dict(data), where)
