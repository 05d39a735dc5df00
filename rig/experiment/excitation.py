"""Excitations of `record`: the identification commands of the papers, jerk-limited ramps, and motion files.

S1 is Wu et al., RA-L 2021 (DOI 10.1109/LRA.2021.3061069), S2 RA-L 2024, PMC11633443.
"""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from hystmpc.trajectories.excitation import (
    Offset,
    Split,
    s1_raised_baseline,
    s1_zero_baseline,
    s2_point_to_point,
    s2_sinusoid,
)
from hystmpc.trajectories.trajectory import Trajectory, sample
from hystmpc.trials.config import NotNegative, Positive, Settings
from hystmpc.trials.errors import LogError
from hystmpc.trials.formats import read_lines
from hystmpc.trials.layouts import CANONICAL
from hystmpc.trials.tables import LogTable, read_table
from hystmpc.trials.types import Vec

from ..safety.ramp import RampSettings, waypoint_commands


class TrajectoryExcitation(Settings):
    """An excitation that is a trajectory of commands in one unit."""

    unit: ClassVar[str]

    @abstractmethod
    def trajectory(self) -> Trajectory:
        """Commands over time."""

    def commands(self, rate_hz: float, ramps: RampSettings) -> Vec:
        """Commands (N,)."""
        del ramps
        return sample(self.trajectory(), rate_hz)[1]


class S1SinusoidSettings(TrajectoryExcitation):
    """`kind: s1_sinusoid`: a decaying sinusoid of pressure, S1 eq. (5) (`zero`) or (6) (`raised`) [bar].

    Attributes:
        baseline: `zero`: the decaying sinusoid has its lowest points at 0 bar; `raised`: it decays towards 1.5 bar.
        frequency_hz: of the sinusoid [Hz].
    """

    unit: ClassVar[str] = "bar"

    kind: Literal["s1_sinusoid"]
    baseline: Literal["zero", "raised"] = "zero"
    frequency_hz: Positive

    def trajectory(self) -> Trajectory:
        wave = s1_zero_baseline if self.baseline == "zero" else s1_raised_baseline
        return wave(self.frequency_hz)


class S2SinusoidSettings(TrajectoryExcitation):
    """`kind: s2_sinusoid`: seven decaying periods of tendon travel, S2 eq. (9), (10) [mm].

    Attributes:
        frequency_hz: of the sinusoid [Hz].
        offset: `0BL`: lowest points at the pretension; `MidBL`: about 3 mm; `EndBL`: highest points at 6 mm.
    """

    unit: ClassVar[str] = "mm"

    kind: Literal["s2_sinusoid"]
    frequency_hz: Positive
    offset: Offset

    def trajectory(self) -> Trajectory:
        return s2_sinusoid(self.frequency_hz, self.offset)


class S2PointToPointSettings(TrajectoryExcitation):
    """`kind: s2_point_to_point`: ten moves and holds drawn from a seed, S2 eq. (11) [mm].

    Attributes:
        seed: of the random numbers.
        split: part of the paper's data from whose distribution moves and holds are drawn.
    """

    unit: ClassVar[str] = "mm"

    kind: Literal["s2_point_to_point"]
    seed: int = Field(ge=0)
    split: Split = "train"

    def trajectory(self) -> Trajectory:
        return s2_point_to_point(self.seed, self.split)


class StopsSettings(Settings):
    """`kind: ramps`: jerk-limited ramps to commands, each with its hold; the first starts at `start`.

    Attributes:
        start: command at the start [mm or bar].
        stops: commands to reach, in order [mm or bar].
        holds_s: rest at each stop [s]; as many as stops.
    """

    unit: ClassVar[str | None] = None  # the numbers are in that of the bench

    kind: Literal["ramps"]
    start: float
    stops: tuple[float, ...] = Field(min_length=1)
    holds_s: tuple[NotNegative, ...]

    @model_validator(mode="after")
    def _as_many(self) -> StopsSettings:
        if len(self.stops) != len(self.holds_s):
            raise ValueError(f"got {len(self.stops)} stops and {len(self.holds_s)} holds_s, expected as many")
        return self

    def commands(self, rate_hz: float, ramps: RampSettings) -> Vec:
        """Commands (N,)."""
        return np.concatenate(
            [[self.start], waypoint_commands(self.start, self.stops, self.holds_s, ramps, 1 / rate_hz)]
        )


class MotionFileSettings(Settings):
    """`kind: file`: columns `time_s` and `command` (or `command_mm`, ...), as `diagnose` writes next_motion.csv.

    Attributes:
        file: its name; a relative name starts at the folder of the configuration.
    """

    kind: Literal["file"]
    file: Path

    @property
    def unit(self) -> str | None:
        """Unit that the column's name says; a bare `command` is in mm, as in every log.

        Raises:
            LogError: if the file cannot be read or lacks a column.
        """
        return CANONICAL.command[_motion_table(self.file)[1]]

    def commands(self, rate_hz: float, ramps: RampSettings) -> Vec:
        """Commands (N,), interpolated linearly.

        Raises:
            LogError: if the file cannot be read, lacks a column, or holds numbers that are not finite or in order.
        """
        del ramps
        table, column = _motion_table(self.file)
        t, u = table.numbers["time_s"], table.numbers[column]
        if t.size < 2 or not np.isfinite([t, u]).all() or not (np.diff(t) > 0).all():
            raise LogError(
                f"{self.file}: got {t.size} rows, expected at least 2 with finite numbers and increasing time_s"
            )
        steps = int(np.ceil((t[-1] - t[0]) * rate_hz - 1e-9))
        return np.interp(t[0] + np.arange(steps + 1) / rate_hz, t, u)


Excitation = Annotated[
    S1SinusoidSettings | S2SinusoidSettings | S2PointToPointSettings | StopsSettings | MotionFileSettings,
    Field(discriminator="kind"),
]


def _motion_table(path: Path | str) -> tuple[LogTable, str]:
    """Table of a motion file, and the name of its command column."""
    table = read_table(read_lines(path), str(path))
    names = [name for name in table.header if name in CANONICAL.command]
    if "time_s" not in table.numbers or len(names) != 1 or names[0] not in table.numbers:
        raise LogError(
            f"{path}: got columns {', '.join(table.header)}, expected time_s and one of {', '.join(CANONICAL.command)}"
        )
    return table, names[0]
