"""What may go wrong between a device and a controller, on purpose."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from hystmpc.trials.config import Settings

from ..settings_types import NotNegative

Direction = Literal["readings", "commands"]
FaultName = Literal[
    "freeze",
    "blocked",
    "dislodged",
    "nan",
    "outlier",
    "dropout",
    "delay",
    "jitter",
    "reorder",
    "duplicate",
    "replay",
    "stamp_jump",
    "out_of_range",
    "corrupt",
]
_SENSOR = ("freeze", "blocked", "dislodged", "nan", "outlier", "stamp_jump", "out_of_range")


class FaultSettings(Settings):
    """One fault of the readings, or of the commands on their way to the device.

    Attributes:
        fault: `dropout` sends nothing; `delay` sends `delay_s` late; `jitter` up to `delay_s` late; `reorder` holds a
            message back behind the next; `duplicate` sends it twice; `replay` sends an old one again; `corrupt` spoils
            one byte of a datagram. Of readings only: `freeze` repeats the last angle; `blocked` sends the last angle
            plus noise, as of a tip that cannot move; `dislodged` the same shifted by `size_deg`, as of a sensor that
            has come off; `nan`; `outlier` adds `size_deg` with a random sign; `stamp_jump` shifts the sender's clock by
            `delay_s`, of either sign; `out_of_range` sends 10 000 deg.
        of: which way the messages go that it hits.
        start_s: when it begins, counted from the first command.
        duration_s: how long it lasts.
        share: of the messages that it hits.
        size_deg: of an outlier, or of the shift of a dislodged sensor.
        noise_deg: standard deviation of the angle of a blocked tip or a dislodged sensor.
        delay_s: see `fault`.
    """

    fault: FaultName
    of: Direction = "readings"
    start_s: NotNegative = 0.0
    duration_s: NotNegative = 1e9
    share: float = Field(default=1.0, gt=0, le=1)
    size_deg: NotNegative = 40.0
    noise_deg: NotNegative = 0.05
    delay_s: float = 0.2

    @model_validator(mode="after")
    def _possible(self) -> FaultSettings:
        if self.of == "commands" and self.fault in _SENSOR:
            known = "dropout, delay, jitter, reorder, duplicate, replay, corrupt"
            raise ValueError(f"got fault {self.fault} of commands, available for them: {known}")
        return self

    @property
    def of_datagrams(self) -> bool:
        """Whether it needs to get at the datagrams themselves."""
        return self.of == "commands" or self.fault == "corrupt"
