"""Settings of work at a device: a bench, with the block `commission`, the block `investigate`, or both."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import Field, model_validator

from hystmpc.models.load import model_path
from hystmpc.rig.axes import PerAxis, each
from hystmpc.rig.config import BenchSettings, located
from hystmpc.rig.plane_config import PlaneBenchSettings, says_two_axes
from hystmpc.trajectories.config import Motion, MotionInPlane, motion_in
from hystmpc.trials.config import Count, FolderName, NotNegativeInt, Settings

MOST_MINUTES, MOST_PLANE_MINUTES = 5.0, 10.0
_STILL_MARGIN, _MOST_TRAVEL = 1.5, 0.9  # of the travel seen without motion, and of the range
_MARGIN = 0.05  # of the sensor's range: distance of the default angle limits from its ends


class CommissionBlock(Settings):
    """Block `commission` of a bench file; every key has a default.

    Attributes:
        minutes: of device time, all motions together [min]; a motion that is repeated after an interruption adds to it.
        angle_limits_deg: of the tip [deg]; the sensor's range less 5 % at either end where left out.
        range_steps: steps of the first climb, each with a rest.
        motions: references of the verification by name; drawn within the reached angles where left out.
        diagnose: whether the model's residual is diagnosed; takes minutes of computing time.
        tune_evaluations: closed-loop runs over all tuning motions, about, for the gains of the PID; above 50 Hz fewer,
            in proportion.
        seed: of everything random.
    """

    minutes: Annotated[float, Field(gt=0, le=MOST_MINUTES)] = MOST_MINUTES
    angle_limits_deg: tuple[float, float] | None = None
    range_steps: Annotated[int, Field(ge=4, le=50)] = 12
    motions: Mapping[FolderName, Motion] | None = Field(default=None, min_length=1)
    diagnose: bool = True
    tune_evaluations: Annotated[Count, Field(ge=24)] = 150
    seed: NotNegativeInt = 1


class PlaneCommissionBlock(CommissionBlock):
    """Block `commission` of a bench file of two axes; keys as of one axis.

    Attributes:
        minutes: of device time, all motions together [min]; twice as many as of one axis.
        angle_limits_deg: of both angles [deg]; the sensor's range less 5 % at either end where left out.
        range_steps: steps of the first climb of each axis, each with a rest.
        motions: references in the plane of both angles; drawn within the reached angles where left out.
        diagnose: whether what joins the axes, and the residual of each, are diagnosed; takes minutes of computing time.
        tune_evaluations: as of one axis.
        seed: of everything random.
    """

    minutes: Annotated[float, Field(gt=0, le=MOST_PLANE_MINUTES)] = MOST_PLANE_MINUTES
    motions: Mapping[FolderName, MotionInPlane] | None = Field(default=None, min_length=1)  # type: ignore[assignment]  # pyright: ignore[reportIncompatibleVariableOverride]  # settings are frozen


class InvestigateBlock(Settings):
    """Block `investigate` of a bench file; every key has a default.

    Attributes:
        minutes: greatest device time of all motions together [min].
        model: simulator to be judged: a file of `fit` (`.yaml`), or `builtin:NAME`; identified first from recordings of
            the device where left out.
        first_motions: recorded before the first diagnosis; the last one repeats the first.
        longest_motion_s: greatest duration of a motion [s]; twice as long where shorter ones left the verdict
            unchanged.
        seed: of everything random.
    """

    minutes: Annotated[float, Field(gt=0, le=30)] = 5.0
    model: str | None = None
    first_motions: Annotated[int, Field(ge=2, le=6)] = 3
    longest_motion_s: Annotated[float, Field(ge=8, le=120)] = 14.0
    seed: NotNegativeInt = 1


class CommissionSettings(BenchSettings):
    """Settings of a whole bench file for `hystmpc commission`, with its block `commission`.

    Attributes:
        commission: what may be done.
    """

    commission: CommissionBlock = CommissionBlock()

    @model_validator(mode="after")
    def _angles_inside(self) -> CommissionSettings:
        if self.sensor.kind != "continuous":
            raise ValueError(
                f"got sensor.kind {self.sensor.kind}, expected continuous: every step of a commissioning looks at the "
                "angle of the moment"
            )
        low, high = self.angle_limits
        if not self.sensor.lower_deg <= low < high <= self.sensor.upper_deg:
            raise ValueError(
                f"got commission.angle_limits_deg {low:g} to {high:g}, expected lower < upper within the sensor's "
                f"{self.sensor.lower_deg:g} to {self.sensor.upper_deg:g} deg"
            )
        return self

    @property
    def angle_limits(self) -> tuple[float, float]:
        """Least and greatest permitted tip angle [deg]."""
        if self.commission.angle_limits_deg is not None:
            return self.commission.angle_limits_deg
        low, high = self.sensor.lower_deg, self.sensor.upper_deg
        return low + _MARGIN * (high - low), high - _MARGIN * (high - low)


class PlaneCommissionSettings(PlaneBenchSettings, CommissionSettings):  # pyright: ignore[reportIncompatibleVariableOverride]
    """Settings of a whole bench file of two axes for `hystmpc commission`, with its block `commission`.

    Attributes:
        commission: what may be done.
    """

    commission: PlaneCommissionBlock = PlaneCommissionBlock()  # pyright: ignore[reportIncompatibleVariableOverride]


def kind_of_commission(data: Any, folder: Path) -> type[CommissionSettings]:
    """Settings that plain data of a bench are of: those of one axis, or of two."""
    return PlaneCommissionSettings if says_two_axes(data, folder) else CommissionSettings


class InvestigateSettings(CommissionSettings):
    """Settings in a bench file with the block `investigate`; of a block `commission` the angle limits count.

    Attributes:
        investigate: what is judged, and how long the device may be moved.
    """

    investigate: InvestigateBlock = InvestigateBlock()

    @property
    def budget_s(self) -> float:
        """Permitted device time [s]."""
        return 60.0 * self.investigate.minutes


class PlaneInvestigateSettings(PlaneCommissionSettings, InvestigateSettings):  # pyright: ignore[reportIncompatibleVariableOverride]
    """Settings in a bench file of two axes with the block `investigate`; of `commission` the angle limits count.

    Attributes:
        investigate: what is judged, and how long the device may be moved.
    """


C = TypeVar("C", bound=CommissionSettings)
J = TypeVar("J", bound=InvestigateSettings)


def located_commission(settings: C, folder: Path) -> C:
    """Settings with file names resolved against `folder`."""
    changes: dict[str, Any] = located(settings, folder)
    if (motions := settings.commission.motions) is not None:
        absolute = {name: motion_in(folder, motion) for name, motion in motions.items()}  # of two axes none is a file
        changes["commission"] = settings.commission.model_copy(update={"motions": absolute})
    return settings.model_copy(update=changes)


def located_investigation(
    settings: J, folder: Path, model: Path | str | None = None, minutes: float | None = None
) -> J:
    """Settings with absolute file names; relative ones start at `folder`, those of `model` at the present folder.

    `model` and `minutes` replace the file's.

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


def narrowed(
    settings: BenchSettings, lower: PerAxis, upper: PerAxis, rate_per_s: PerAxis, still: float = 0.0
) -> BenchSettings:
    """Settings of the bench with narrower limits of the command, or of both commands.

    The overshoot of a stop stays as it was. The implausible travel without a motion of the tip is at most nine tenths
    of the narrower range, over all of which the tip has moved:

        travel = min(0.9 range, plausibility.travel, or where that is not given max(range / 2, 1.5 still))

    with `still`, the longest travel in which the tip did not move. Of two axes the range is the smaller one in the
    first term, and the greater one in the last.

    Raises:
        ConfigError: if the safe command lies outside.
    """
    plain = {name: getattr(settings, name) for name in BenchSettings.model_fields}
    spans = [high - low for low, high in zip(each(lower), each(upper), strict=True)]
    watch, ramps = settings.plausibility, settings.ramps
    widest = watch.travel or max(watch.travel_of(max(spans)), _STILL_MARGIN * still)
    changes: dict[str, Any] = {
        "limits": {"lower": lower, "upper": upper, "rate_per_s": rate_per_s},
        "ramps": ramps.model_copy(update={"velocity_per_s": min(ramps.velocity_per_s, *each(rate_per_s))}),
        "plausibility": watch.model_copy(update={"travel": min(widest, _MOST_TRAVEL * min(spans))}),
        "stop_overshoot": settings.overshoot,
    }
    kind = PlaneBenchSettings if isinstance(settings, PlaneBenchSettings) else BenchSettings
    return kind.parse(plain | changes, f"{settings.name}: narrowed limits")
