"""Motions in YAML: one settings block per kind, told apart by the key `kind`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field

from hystmpc.trials.config import NotNegative, Positive, Settings
from hystmpc.trials.errors import ConfigError, did_you_mean

from .motion import MotionLimitsSettings
from .point_to_point import PointToPoint, random_point_to_point
from .scan import Raster, Shape, SinusoidScan, TriangleScan
from .trajectory import Trajectory, read_sampled


class MotionSettings(Settings):
    """Base of the motion blocks, whose keys are the arguments of what they make.

    Attributes:
        make: the trajectory's class, or a function that returns one.
    """

    make: ClassVar[Callable[..., Trajectory]]

    def build(self, folder: Path | str = ".") -> Trajectory:
        """Make the trajectory; relative file names start at `folder`.

        Raises:
            TrajectoryError: if the settings are each valid but no motion fits them together.
        """
        del folder
        given = {name: getattr(self, name) for name in type(self).model_fields if name != "kind"}
        limits = given.get("limits")
        return self.make(**given | ({"limits": limits.build()} if isinstance(limits, MotionLimitsSettings) else {}))


class PointToPointSettings(MotionSettings):
    """`kind: point_to_point`; see PointToPoint.

    Attributes:
        start_deg: angle at time 0, at rest [deg].
        targets_deg: angles to reach, in order [deg].
        holds_s: time to rest at each target [s]; as many as targets, 0 allowed.
        limits: greatest velocity, acceleration and jerk of every move.
    """

    make = PointToPoint
    kind: Literal["point_to_point"]
    start_deg: float
    targets_deg: tuple[float, ...] = Field(min_length=1)
    holds_s: tuple[NotNegative, ...] = Field(min_length=1)
    limits: MotionLimitsSettings = MotionLimitsSettings()


class RandomPointToPointSettings(MotionSettings):
    """`kind: random_point_to_point`; see random_point_to_point.

    Attributes:
        seed: of the random numbers.
        start_deg: angle at time 0, at rest [deg].
        range_deg: lowest and highest target [deg].
        moves: number of moves.
        hold_range_s: shortest and longest hold [s].
        limits: greatest velocity, acceleration and jerk of every move.
    """

    make = staticmethod(random_point_to_point)
    kind: Literal["random_point_to_point"]
    seed: int = Field(ge=0)
    start_deg: float
    range_deg: tuple[float, float]
    moves: int = Field(default=10, ge=1)
    hold_range_s: tuple[NotNegative, NotNegative] = (1.0, 5.0)
    limits: MotionLimitsSettings = MotionLimitsSettings()


class _ScanSettings(MotionSettings):
    """The keys all scans share.

    Attributes:
        start_deg: angle at time 0, at rest [deg].
        centre_deg: centre of the sweeps [deg].
        frequency_hz: of every sweep [Hz].
        cycles: periods of each sweep, a multiple of 0.5.
        limits: of the lead-in, for triangles of every leg; null for a sinusoid's own rates, or a triangle's sharp
            corners.
    """

    start_deg: float
    centre_deg: float
    frequency_hz: Positive
    cycles: float = Field(gt=0, multiple_of=0.5)
    limits: MotionLimitsSettings | None = None


class SinusoidScanSettings(_ScanSettings):
    """`kind: scan_sinusoid`; see SinusoidScan.

    Attributes:
        amplitude_deg: half the peak-to-peak angle [deg].
    """

    make = SinusoidScan
    kind: Literal["scan_sinusoid"]
    amplitude_deg: Positive


class TriangleScanSettings(_ScanSettings):
    """`kind: scan_triangle`; see TriangleScan.

    Attributes:
        amplitude_deg: half the peak-to-peak angle [deg].
    """

    make = TriangleScan
    kind: Literal["scan_triangle"]
    amplitude_deg: Positive


class RasterSettings(_ScanSettings):
    """`kind: raster`; see Raster.

    Attributes:
        amplitudes_deg: half the peak-to-peak angle of each sweep, in order [deg].
        shape: of every sweep.
    """

    make = Raster
    kind: Literal["raster"]
    amplitudes_deg: tuple[Positive, ...] = Field(min_length=1)
    shape: Shape = "sinusoid"


class SampledSettings(MotionSettings):
    """`kind: sampled`; a CSV file with the columns time_s and angle_deg, see read_sampled.

    Attributes:
        file: name of the CSV file; a relative name starts at the folder of the configuration.
    """

    kind: Literal["sampled"]
    file: Path

    def build(self, folder: Path | str = ".") -> Trajectory:
        """Read the file."""
        return read_sampled(Path(folder) / self.file)


# Every kind of motion: what a configuration can name and what the contract tests run over.
MOTIONS: Mapping[str, type[MotionSettings]] = {
    "point_to_point": PointToPointSettings,
    "random_point_to_point": RandomPointToPointSettings,
    "scan_sinusoid": SinusoidScanSettings,
    "scan_triangle": TriangleScanSettings,
    "raster": RasterSettings,
    "sampled": SampledSettings,
}


def _known_kind(data: Any) -> Any:
    """Answer a missing or unknown kind with the kinds there are."""
    if isinstance(data, Mapping):
        if "kind" not in data:
            raise ValueError(f"no key 'kind', available: {', '.join(sorted(MOTIONS))}")
        kind = data["kind"]
        # A kind read from YAML may be anything, also what a mapping cannot be asked for.
        if not isinstance(kind, str) or kind not in MOTIONS:
            raise ValueError(f"unknown kind {kind!r}, {did_you_mean(str(kind), MOTIONS)}")
    return data


# For a field of another settings block: `reference: Motion`.
Motion = Annotated[
    Annotated[
        PointToPointSettings
        | RandomPointToPointSettings
        | SinusoidScanSettings
        | TriangleScanSettings
        | RasterSettings
        | SampledSettings,
        Field(discriminator="kind"),
    ],
    BeforeValidator(_known_kind),
]


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
