"""Settings of an investigation: a bench as of a commissioning, the simulator to be judged, and the device time."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from pydantic import Field

from hystmpc.models.load import model_path
from hystmpc.trials.config import Settings, load_settings

from .config import CommissionSettings, located_commission


class InvestigateBlock(Settings):
    """Block `investigate`; every key has a default.

    Attributes:
        minutes: of device time, which all motions together never exceed [min].
        model: simulator to be judged: a file of `fit` (`.yaml`), or `builtin:NAME`; one is identified first from
            recordings of the device where left out.
        first_motions: recorded before the first diagnosis; the last one repeats the first.
        longest_motion_s: duration that a motion does not exceed [s]; twice as long where shorter ones left the verdict
            as it was.
        seed: of everything drawn at random.
    """

    minutes: Annotated[float, Field(gt=0, le=30)] = 5.0
    model: str | None = None
    first_motions: Annotated[int, Field(ge=2, le=6)] = 3
    longest_motion_s: Annotated[float, Field(ge=8, le=120)] = 14.0
    seed: Annotated[int, Field(ge=0)] = 1


class InvestigateSettings(CommissionSettings):
    """A bench file with the block `investigate`; a block `commission` may stay, of which the angle limits count.

    Attributes:
        investigate: what is judged, and how long the device may be moved.
    """

    investigate: InvestigateBlock = InvestigateBlock()

    @property
    def budget_s(self) -> float:
        """Device time [s]."""
        return 60.0 * self.investigate.minutes


def load_investigation(path: Path | str, overrides: Iterable[str] = ()) -> InvestigateSettings:
    """Read a bench file with the block `investigate`; file names in it start at its own folder and come out absolute.

    Raises:
        ConfigError: on an unreadable file, an unknown key or a value out of bounds.
        ModelError: if a built-in simulator is unknown.
    """
    settings = load_settings(InvestigateSettings, path, overrides)
    return located_investigation(settings, Path(path).resolve().parent)


def located_investigation(
    settings: InvestigateSettings, folder: Path, model: Path | str | None = None, minutes: float | None = None
) -> InvestigateSettings:
    """The settings with file names that start at `folder`.

    Args:
        model: taken in place of the file's own; starts at the present folder.
        minutes: taken in place of the file's own.

    Raises:
        ConfigError: if the minutes are out of bounds.
        ModelError: if a built-in simulator is unknown.
    """
    block = settings.investigate.model_dump()
    if model is not None:
        block["model"] = str(model_path(str(model), Path().resolve()))
    elif settings.investigate.model is not None:
        block["model"] = str(model_path(settings.investigate.model, folder))
    if minutes is not None:
        block["minutes"] = minutes
    changed = InvestigateBlock.parse(block, "investigate")
    return located_commission(settings, folder).model_copy(update={"investigate": changed})
