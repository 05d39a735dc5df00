"""Settings of the reconstruction experiment. Dimensions of the cap are ours: the paper's Fig. 6 is lost."""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError, did_you_mean

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
_FULL_TURN = 360.0


class Groove(Settings):
    """A ring milled into the cap along its axis: walls are cylinders about the axis, the bottom a concentric sphere.

    Attributes:
        radius_mm: distance of its middle from the cap's axis [mm].
        width_mm: between its walls [mm].
        depth_mm: of the bottom below the smooth surface, along the sphere's radius [mm].
    """

    radius_mm: Positive
    width_mm: Positive = 2.0
    depth_mm: Positive = 1.0

    @property
    def edges_mm(self) -> tuple[float, float]:
        """Distances of the inner and the outer wall from the axis [mm]."""
        return self.radius_mm - self.width_mm / 2, self.radius_mm + self.width_mm / 2


class Pattern(Settings):
    """The surface of one sector of the cap.

    Attributes:
        grooves: from the axis outwards; none for a smooth surface.
    """

    name: Annotated[str, Field(min_length=1)]
    grooves: tuple[Groove, ...] = ()

    @model_validator(mode="after")
    def _apart(self) -> Self:
        edges = [edge for groove in self.grooves for edge in groove.edges_mm]
        if edges != sorted(set(edges)) or (edges and edges[0] <= 0):
            raise ValueError(f"pattern {self.name}: got groove edges {edges} mm, expected them apart and rising from 0")
        return self


class Cap(Settings):
    """A hollow spherical cap before the tip, open towards it, its axis along the straight catheter.

    Every sector carries one pattern; sector j covers [j sector_deg, (j + 1) sector_deg) of the rotation. Dimensions and
    groove positions are OURS (S1 Fig. 6 is lost), chosen from two conditions that know of no model: over 0 to 31 deg,
    the device's range, every ray meets the cap before the rim, and distances stay within 4 to 6 mm (to a groove's
    bottom 7 mm), as near as a ranging fibre of a few mm of depth asks. An angle error of 1 deg then displaces a point
    by 0.55 to 0.60 mm (`Segment.lever`); the tip alone by L/2 = 0.48 mm, which is S1's own "1-3 mm corresponds to
    2.09-6.26 deg".

    Attributes:
        inner_radius_mm: R of the smooth surface [mm].
        rim_deg: polar angle of the rim, seen from the sphere's centre [deg].
        standoff_mm: from the straight tip to the smooth surface on the axis [mm].
        sector_deg: of one pattern; 90 printed in S1 [deg].
        patterns: in the order of the rotation; S1: I and III with three grooves, II smooth.
    """

    inner_radius_mm: Positive = 30.0
    rim_deg: Annotated[float, Field(gt=0, le=90)] = 45.0
    standoff_mm: Positive = 6.0
    sector_deg: Positive = 90.0
    patterns: Annotated[tuple[Pattern, ...], Field(min_length=1)] = (
        Pattern(name="I", grooves=(Groove(radius_mm=4.0), Groove(radius_mm=8.0), Groove(radius_mm=12.0))),
        Pattern(name="II"),
        Pattern(name="III", grooves=(Groove(radius_mm=6.0), Groove(radius_mm=10.0), Groove(radius_mm=14.0))),
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        names = [pattern.name for pattern in self.patterns]
        if len(set(names)) != len(names):
            raise ValueError(f"cap: got patterns {', '.join(names)}, expected each name once")
        if self.sector_deg * len(names) > _FULL_TURN:
            raise ValueError(f"cap: {len(names)} sectors of {self.sector_deg:g} deg exceed a full turn")
        rim_mm = self.inner_radius_mm * math.sin(math.radians(self.rim_deg))
        for groove in (groove for pattern in self.patterns for groove in pattern.grooves):
            if groove.edges_mm[1] >= rim_mm:
                raise ValueError(f"cap: a groove ends at {groove.edges_mm[1]:g} mm, the rim lies at {rim_mm:.4g} mm")
        return self

    def pattern_at(self, rotation_deg: float) -> Pattern:
        """The pattern that lies in the bending plane after a rotation.

        Raises:
            ConfigError: if the rotation is beyond the sectors.
        """
        index = math.floor(rotation_deg / self.sector_deg) if math.isfinite(rotation_deg) else -1
        if not 0 <= index < len(self.patterns):
            end = self.sector_deg * len(self.patterns)
            raise ConfigError(f"cap: got rotation {rotation_deg:g} deg, expected 0 <= rotation < {end:g} deg")
        return self.patterns[index]

    def pattern(self, name: str) -> Pattern:
        """The pattern of that name.

        Raises:
            ConfigError: if there is none.
        """
        for pattern in self.patterns:
            if pattern.name == name:
                return pattern
        raise ConfigError(f"cap: no pattern {name!r}, {did_you_mean(name, (p.name for p in self.patterns))}")


class Oct(Settings):
    """The ranging fibre at the tip, looking along its tangent; one distance a sample. S1 prints none of these numbers.

    Attributes:
        noise_mm: standard deviation of white noise on a distance [mm].
        axial_resolution_mm: step of the distances, 0 for none [mm].
        range_mm: greatest distance with a signal [mm].
    """

    noise_mm: NotNegative = 0.01
    axial_resolution_mm: NotNegative = 0.015
    range_mm: Positive = 10.0


class ReconstructionSettings(Settings):
    """Settings of the experiment: segment, cap, fibre, seed.

    Attributes:
        segment_length_mm: L of the bending segment; from S1's "1-3 mm corresponds to 2.09-6.26 deg" [mm].
        max_angle_deg: angles beyond it, of device or model, are refused: the ray would look backwards [deg].
    """

    segment_length_mm: Positive = 54.75
    max_angle_deg: Annotated[float, Field(gt=0, le=90)] = 90.0
    cap: Cap = Cap()
    oct: Oct = Oct()
    seed: Annotated[int, Field(ge=0)] = 0

    @property
    def centre_mm(self) -> float:
        """Height of the sphere's centre above the segment's base, on the axis [mm]; below zero where it lies behind."""
        return self.segment_length_mm + self.cap.standoff_mm - self.cap.inner_radius_mm
