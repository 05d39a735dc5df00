"""Result of a diagnosis of two axes, and its fixed JSON form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from hystmpc.models.identify.uncertainty import Interval
from hystmpc.trials.brief import brief, in_brief

from ..diagnosis import Diagnosis

TWO_AXIS_FORMAT = "hystmpc-two-axis-diagnosis/1"

UNITS: Mapping[str, Mapping[str, str]] = {
    "misalignment": {"turn_deg": "deg", "skew_deg": "deg"},
    "cross_coupling": {"x_by_y": "deg/deg", "y_by_x": "deg/deg", "turn_deg": "deg"},
    "shared_friction": {"x_deg": "deg", "y_deg": "deg"},
}
"""Numbers of every effect between the axes, and their units.

`turn_deg` is the mean turn of both tendons from where the simulator has them, `skew_deg` that of x less that of y.
`x_by_y` is the share of the bend along y that angle x shows more than in the simulator; `turn_deg` of a cross-coupling
is the turn that both shares have in common. `x_deg` is the RMS change of x by friction and stiffness that both share.
"""


@dataclass(frozen=True)
class JoinEffect:
    """An effect between the axes that the simulator lacks.

    Attributes:
        name: `misalignment`, `cross_coupling` or `shared_friction`.
        parameters: its numbers, see `UNITS`.
        ci90: 90 % interval of each, from fits without one sixth of the development samples after another.
        closed_share: share that it closes, on the final trials, of the gap that neither axis explains alone.
        closed_ci90: 90 % interval of that share.
        rmse_before_deg, rmse_after_deg: on the final trials, without and with it, the axes corrected [deg].
    """

    name: str
    parameters: Mapping[str, float]
    ci90: Mapping[str, Interval]
    closed_share: float
    closed_ci90: Interval
    rmse_before_deg: float
    rmse_after_deg: float
    __repr__ = brief


@dataclass(frozen=True)
class JoinGap:
    """Errors of the tip on the final trials, without the mean of each trial [deg].

    Attributes:
        nominal_rmse_deg: of the simulator as given.
        joined_rmse_deg: of the simulator with the effects between the axes, its axes as given.
        between_rmse_deg: of the simulator as given, with axes corrected by their own lags and plays.
        left_rmse_deg: of the same with the effects between the axes.
        floor_rmse_deg: noise of the sensor.
    """

    nominal_rmse_deg: float
    joined_rmse_deg: float
    between_rmse_deg: float
    left_rmse_deg: float
    floor_rmse_deg: float
    final_trials: tuple[str, ...]
    __repr__ = brief


@dataclass(frozen=True)
class KnownJoins:
    """What joins the axes otherwise than in the simulator.

    Attributes:
        effects: those that count, the greatest share first.
        ambiguity: sets of effects that these trials cannot tell apart; one of each is in `effects`.
        held_out: error on parts left out [deg], by the effects that were tried.
    """

    effects: tuple[JoinEffect, ...]
    ambiguity: tuple[tuple[str, ...], ...]
    gap: JoinGap
    held_out: Mapping[str, float]
    __repr__ = brief


@dataclass(frozen=True)
class TwoAxisDiagnosis:
    """Result of a diagnosis of two axes.

    Attributes:
        joins: effects between the axes.
        x, y: diagnosis of each axis, with the joins taken off.
    """

    joins: KnownJoins
    x: Diagnosis
    y: Diagnosis

    def __repr__(self) -> str:
        names = ", ".join(effect.name for effect in self.joins.effects) or "none"
        return in_brief(self, f"joins {names}; x {self.x.verdict}, y {self.y.verdict}")

    @property
    def named(self) -> bool:
        """Whether the simulator is to be changed: an effect between the axes, effects of an axis or other numbers."""
        verdicts = {self.x.verdict, self.y.verdict}
        return bool(self.joins.effects) or bool(verdicts & {"named", "one_of", "retuned"})

    def as_json(self) -> dict[str, Any]:
        """Convert to the fixed form `hystmpc-two-axis-diagnosis/1`: plain dicts, lists, numbers and strings."""
        joins = asdict(self.joins)
        for effect in joins["effects"]:
            effect["units"] = dict(UNITS[effect["name"]])
        return {"format": TWO_AXIS_FORMAT, "joins": joins, "x": self.x.as_json(), "y": self.y.as_json()}
