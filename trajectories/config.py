"""Motions in settings files: one settings block per kind, selected by the key `kind`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field

from hystmpc.trials.errors import ConfigError, did_you_mean

from .motion import MotionSettings
from .point_to_point import PointToPoint, RandomPointToPointSettings
from .scan import Raster, SinusoidScan, TriangleScan
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


AnyMotion = PointToPoint | RandomPointToPointSettings | SinusoidScan | TriangleScan | Raster | SampledSettings
MOTIONS: Mapping[str, type[AnyMotion]] = {kind.model_fields["kind"].default: kind for kind in get_args(AnyMotion)}
"""Every kind of motion that a configuration can name."""


def _known_kind(data: Any) -> Any:
    """Refuse a missing or unknown kind with a list of the kinds."""
    if isinstance(data, Mapping):
        if "kind" not in data:
            raise ValueError(f"no key 'kind', available: {', '.join(sorted(MOTIONS))}")
        kind = data["kind"]
        # A kind read from YAML may be anything, also what a mapping cannot be asked for.
        if not isinstance(kind, str) or kind not in MOTIONS:
            raise ValueError(f"unknown kind {kind!r}, {did_you_mean(str(kind), MOTIONS)}")
    return data


Motion = Annotated[AnyMotion, Field(discriminator="kind"), BeforeValidator(_known_kind)]
"""Type of a field of another block: `reference: Motion`."""


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
