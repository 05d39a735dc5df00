"""Preparation before an experiment, as configured: S2's initial flexure, relaxation and pretension check."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from hystmpc.trials.config import Settings

from .phases.motion import CommandMotion, PretensionCheck
from .phases.phase import Phase
from .ramp import RampSettings, ramp_commands, way_commands
from .settings_types import Count, NotNegative, Positive


class MoveSettings(Settings):
    """`step: move`: a ramp to a command."""

    step: Literal["move"]
    to: float

    def phase(self, ramps: RampSettings, dt_s: float) -> Phase:
        """The phase of this step."""
        return CommandMotion("move", lambda held: ramp_commands(held, 0.0, self.to, ramps, dt_s))


class FlexureSettings(Settings):
    """`step: flexure`: to the upper command and back to the lower one, `cycles` times (S2: once, discarded)."""

    step: Literal["flexure"]
    lower: float
    upper: float
    cycles: Count = 1
    hold_s: NotNegative = 0.0

    def phase(self, ramps: RampSettings, dt_s: float) -> Phase:
        """The phase of this step."""
        stops = [self.upper, self.lower] * self.cycles
        holds = [self.hold_s] * len(stops)
        return CommandMotion("flexure", lambda held: way_commands(held, stops, holds, ramps, dt_s))


class RelaxationSettings(Settings):
    """`step: relaxation`: hold the command while creep dies down."""

    step: Literal["relaxation"]
    duration_s: Positive

    def phase(self, ramps: RampSettings, dt_s: float) -> Phase:
        """The phase of this step."""
        return CommandMotion("relaxation", lambda held: way_commands(held, [held], [self.duration_s], ramps, dt_s))


class PretensionSettings(Settings):
    """`step: pretension_check`: the angle has to be plausible and to move with the command.

    Attributes:
        by: how far the command goes, from where it is and back.
        hold_s: rest at the far end before the verdict.
        least_move_deg, most_move_deg: what the angle has to move, sign included.
    """

    step: Literal["pretension_check"]
    by: float
    hold_s: Positive = 0.5
    least_move_deg: float
    most_move_deg: float

    @model_validator(mode="after")
    def _ordered(self) -> PretensionSettings:
        if not self.least_move_deg < self.most_move_deg or self.by == 0:
            raise ValueError(
                f"got by {self.by}, least_move_deg {self.least_move_deg}, most_move_deg {self.most_move_deg}, expected "
                "by other than 0 and least < most"
            )
        return self

    def phase(self, ramps: RampSettings, dt_s: float) -> Phase:
        """The phase of this step."""
        return PretensionCheck(
            lambda held: (
                way_commands(held, [held + self.by], [self.hold_s], ramps, dt_s),
                ramp_commands(held + self.by, 0.0, held, ramps, dt_s),
            ),
            self.least_move_deg,
            self.most_move_deg,
        )


PrepareStep = Annotated[
    MoveSettings | FlexureSettings | RelaxationSettings | PretensionSettings, Field(discriminator="step")
]
