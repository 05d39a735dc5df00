"""Result of a diagnosis and its fixed JSON form."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

from hystmpc.models.identify.uncertainty import Interval
from hystmpc.trials.brief import brief, in_brief

FORMAT = "hystmpc-diagnosis/3"
FORMATS = ("hystmpc-diagnosis/1", "hystmpc-diagnosis/2", FORMAT)
"""Accepted formats; a version has all keys of those before, with their meaning."""

FIXED_FILE, MOTION_FILE = "sim.fixed.yaml", "next_motion.csv"
"""Files of the corrected simulator and of the proposed motion in the folder of a diagnosis."""

Verdict = Literal["named", "one_of", "retuned", "unknown", "none", "too_little"]
FloorKind = Literal["repeats", "noise"]
Order = Literal["known", "unknown"]
"""Whether the order in which the trials were recorded is known."""


FLIPS = "the verdict flips between splits of the trials, so that no simulator surely stands for the device"
REFUTED = "the replay in your simulator does not confirm every effect"
"""Reasons for no prediction from effects that are unreliable."""

_STABLE = 0.7  # of the resamples: a verdict that comes out less often is said to flip
_NO_FALL, _HIDDEN = 0.05, 0.3  # of the error: less is no fall; the same where the fall is below the floor


@dataclass(frozen=True)
class IdentifiedEffect:
    """Effect that the diagnosis added to the simulator.

    Attributes:
        probability: calibrated probability that this effect is present, at most (1 + inclusion) / 2.
        inclusion: share of block resamples that choose it.
        closed_share: share of the structural gap that it closes on the final trials, by the error without it.
        closed_ci90: 90 % interval of that share, block bootstrap over the final trials.
        rmse_before_deg, rmse_after_deg: on the final trials, the other effects present, without and with it [deg].
        units: of the parameters; 1 for a plain number.
        undetermined: parameters whose 90 % interval is about as wide as their range, so that their values are unusable.
    """

    name: str
    probability: float
    inclusion: float
    closed_share: float
    __repr__ = brief
    closed_ci90: Interval
    rmse_before_deg: float
    rmse_after_deg: float
    parameters: Mapping[str, float]
    units: Mapping[str, str] = field(default_factory=dict)
    undetermined: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """Name of the effect in words; for a sensor with the resolution of its readings."""
        name, step = self.name.replace("_", " "), self.parameters.get("resolution_deg", 0.0)
        return f"{name} with steps of {step:.3g} {self.units.get('resolution_deg', '')}".strip() if step > 0 else name


@dataclass(frozen=True)
class InputDependence:
    """Slope of a difference between trials over a measured input.

    Attributes:
        input: name of the input.
        parameter: offset_deg, gain_share or width_deg, as in a configuration change.
        slope: of the parameter, per unit of the input.
        share: of what differs between trials, explained by the input on trials left out.
    """

    input: str
    parameter: str
    slope: float
    share: float
    __repr__ = brief


@dataclass(frozen=True)
class ConfirmedShare:
    """Share of the structural gap that an effect closes in the user's own simulator, after a replay.

    Attributes:
        ci90: 90 % interval, as that of `IdentifiedEffect.closed_ci90`.
    """

    closed_share: float
    ci90: Interval


@dataclass(frozen=True)
class Gap:
    """Sizes of the gap on the final trials, which were not used for any choice.

    closed_share = (MSE_retuned - MSE_with) / (MSE_retuned - MSE_floor)

    Attributes:
        nominal_rmse_deg, retuned_rmse_deg, with_effects_rmse_deg: on the final trials [deg]; retuned is at most
            nominal, since a worse retuning is rejected.
        floor_rmse_deg: irreducible error of any simulator [deg], at least the rounding of the readings.
        floor_kind: from repeats of a motion, or from the noise of the residual (a lower bound).
        closed_share, unexplained_share: of the structural gap; they add up to one.
        closed_ci90: 90 % interval of the closed share.
        repeats_rmse_deg: difference between repeats of a motion, retuned [deg]; not-a-number without repeats. If the
            retuned error is at most this and has no known cause, the floor is the noise.
        model_form_rmse_deg: error that the simulator left on the trials it was identified on, in motions like those
            of these trials, noise included [deg]; not-a-number if unknown.
    """

    nominal_rmse_deg: float
    retuned_rmse_deg: float
    with_effects_rmse_deg: float
    floor_rmse_deg: float
    floor_kind: FloorKind
    closed_share: float
    unexplained_share: float
    __repr__ = brief
    closed_ci90: Interval
    final_trials: tuple[str, ...]
    repeats_rmse_deg: float = math.nan
    model_form_rmse_deg: float = math.nan

    @property
    def unrepeatable(self) -> bool:
        """Whether the whole error after retuning differs between repeats: no structural gap of the command."""
        return self.floor_kind == "noise" and math.isfinite(self.repeats_rmse_deg)


@dataclass(frozen=True)
class ResidualShare:
    """Share of the retuned gap in one part of the motion.

    Attributes:
        share: of the residual's energy.
        density: that share over the share of time spent there; one is average.
        ci90: 90 % interval of the share, block bootstrap.
    """

    share: float
    density: float
    ci90: Interval


@dataclass(frozen=True)
class RetunedParameter:
    """Parameter of the hysteresis core that retuning has changed.

    Attributes:
        name: `gain`, `offset`, `backlash_width`, or the core's name for it.
        unit: of it; 1 for a plain number.
        ci90: 90 % interval of the retuned value.
    """

    name: str
    unit: str
    given: float
    value: float
    ci90: Interval


@dataclass(frozen=True)
class Untestable:
    """Item that these logs cannot test, and the reason in one sentence."""

    name: str
    why: str


@dataclass(frozen=True)
class Detectable:
    """Smallest detectable size of one effect.

    Attributes:
        parameter, unit: in which the size is stated, and its unit.
        size: distance of the parameter from its value without the effect; infinite if no size is detectable.
        hidden: share of the effect's energy that retuning absorbs at that size, 0 to 1; not-a-number without a size.
        untestable: whether it needs the order of recording, which is unknown.
    """

    effect: str
    parameter: str
    unit: str
    size: float
    hidden: float
    untestable: bool = False


@dataclass(frozen=True)
class DetectableSizes:
    """Smallest detectable size of every effect, from the commands of the logs alone.

    Attributes:
        needed_rmse_deg: RMSE after retuning from which an effect counts as a gap [deg].
        effects: the smallest size of each; empty if unknown.
        why_not: reason why it is unknown, in one sentence; otherwise empty.
        unit: of the needed RMSE, that of the log.
    """

    needed_rmse_deg: float
    effects: tuple[Detectable, ...] = ()
    why_not: str = ""
    unit: str = "deg"


@dataclass(frozen=True)
class Stability:
    """Stability of the verdict over resampled splits of the trials."""

    share: float
    resamples: int
    otherwise: tuple[tuple[str, float], ...] = ()

    @property
    def flips(self) -> bool:
        """Whether the verdict depends on the choice of the final trials."""
        return self.share < _STABLE


@dataclass(frozen=True)
class NextMotion:
    """Proposed motion of the next recording.

    Attributes:
        file: name of the motion's file in the folder of the diagnosis.
        separates: effects that the motion shall distinguish.
        expected_probability: probability that it names the right one of them, if the device follows one of their
            equations exactly.
        duration_s: of the motion [s].
    """

    file: str
    separates: tuple[str, ...]
    expected_probability: float
    duration_s: float
    __repr__ = brief


@dataclass(frozen=True)
class MotionTracking:
    """Expected RMS tracking error along one motion, before and after the correction [deg]."""

    name: str
    before_deg: float
    after_deg: float


@dataclass(frozen=True)
class TrackingGap:
    """Expected fall of the closed-loop tracking error with the corrected simulator as the model.

    All errors are RMS, true angle minus reference, simulated on the corrected simulator with its noise.

    Attributes:
        before_deg, after_deg: with the simulator as given, and with the corrected one, over all motions; not-a-number
            if unknown.
        before_range_deg, after_range_deg: least and greatest value over several seeds of the noise.
        why_not: reason why it is unknown, in one sentence; otherwise empty.
    """

    before_deg: float = math.nan
    after_deg: float = math.nan
    before_range_deg: Interval = (math.nan, math.nan)
    after_range_deg: Interval = (math.nan, math.nan)
    motions: tuple[MotionTracking, ...] = ()
    why_not: str = ""
    __repr__ = brief

    @property
    def fall_deg(self) -> float:
        """Fall of the error [deg]; negative if it rises."""
        return self.before_deg - self.after_deg

    @property
    def fall_share(self) -> float:
        """Fall of the error as a share of the error before."""
        return self.fall_deg / self.before_deg if self.before_deg > 0 else 0.0

    def changes(self, floor_deg: float) -> bool:
        """Whether the error is expected to change: by 5 %, and by 30 % if it is below the floor [deg]."""
        least = _HIDDEN if abs(self.fall_deg) < floor_deg else _NO_FALL
        return self.fall_deg != 0 and abs(self.fall_deg) >= least * self.before_deg


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis: location and causes of the gap, closed share, and the next motion.

    Attributes:
        verdict: named | one_of (see `ambiguity`) | retuned (see `moved`) | unknown | none | too_little.
        effects: chosen effects, the most probable first.
        ambiguity: sets of effects that these trials cannot distinguish.
        ranking: every effect with its probability, most likely first.
        retuned: baseline quantities, each (nominal, retuned).
        moved: parameters significantly changed by retuning; empty unless the verdict is `retuned`.
        groups: names of the trials that share a configuration, the largest group first; only with the effect
            `configuration_change`.
        depends_on: measured input that explains what differs between trials, and how; empty without one.
        where: share of the residual by part of the motion.
        notes: faults and shortcomings of the trials, a sentence each.
        next_motion: proposed motion of the next recording; None if no hypothesis is open.
        tracking: fall of the closed-loop tracking error; None if not requested.
        order: whether the order of recording is known.
        untestable: items that these logs cannot test without the order of recording.
        stability: of the verdict over resampled splits; None if the trials allow no choice.
        explainable_share: share of the structural gap that a flexible model of the command's past explains on held-out
            trials; None without a gap.
        detectable: smallest detectable size of each effect; None if not requested.
        unit: of the output as logged, such as deg or N; it applies to all numbers named `..._deg`.
        command_unit: of the command as logged.
        simulator: given | stand_in: whether the simulator was run, or the logs hold the output of the user's own.
        stand_in_rmse_deg: error of the stand-in on that output [deg]; None for a given simulator.
        replay: files of the folder `replay`: the commands of the final trials behind the named effects, for the user's
            simulator to play.
        confirmed: by effect, after a replay; effects in the core or on the output cannot be replayed.
        confirmed_rmse_deg: on the final trials, with all effects and the replayed output [deg]; None before a replay.
    """

    verdict: Verdict
    reason: str
    effects: tuple[IdentifiedEffect, ...]
    ambiguity: tuple[tuple[str, ...], ...]
    ranking: tuple[tuple[str, float], ...]
    gap: Gap
    retuned: Mapping[str, tuple[float, float]]
    where: Mapping[str, ResidualShare]
    notes: tuple[str, ...] = ()
    next_motion: NextMotion | None = None
    tracking: TrackingGap | None = None
    order: Order = "known"
    untestable: tuple[Untestable, ...] = ()
    stability: Stability | None = None
    explainable_share: float | None = None
    moved: tuple[RetunedParameter, ...] = ()
    groups: tuple[tuple[str, ...], ...] = ()
    depends_on: tuple[InputDependence, ...] = ()
    detectable: DetectableSizes | None = None
    unit: str = "deg"
    command_unit: str = "mm"
    simulator: Literal["given", "stand_in"] = "given"
    stand_in_rmse_deg: float | None = None
    replay: tuple[str, ...] = ()
    confirmed: Mapping[str, ConfirmedShare] = field(default_factory=dict)
    confirmed_rmse_deg: float | None = None

    def __repr__(self) -> str:
        return in_brief(self, f"{self.verdict}: {self.reason}")

    @property
    def relies_on_its_split(self) -> bool:
        """Whether effects are named that too few other splits of the trials confirm."""
        return bool(self.effects) and self.stability is not None and self.stability.flips

    @property
    def refuted(self) -> tuple[str, ...]:
        """Effects that a replay does not confirm: the interval of their closed share reaches 0 or below."""
        return tuple(name for name, one in self.confirmed.items() if one.ci90[0] <= 0)

    @property
    def doubt(self) -> str:
        """Reason not to rely on the named effects; empty without one."""
        return FLIPS if self.relies_on_its_split else REFUTED if self.refuted else ""

    @property
    def probabilities(self) -> dict[str, float]:
        """Probability of every effect by name."""
        return dict(self.ranking) | {effect.name: effect.probability for effect in self.effects}

    @property
    def kept_as_given(self) -> bool:
        """Whether retuning was rejected, since it did not lower the error of the final trials."""
        return bool(self.retuned) and all(given == retuned for given, retuned in self.retuned.values())

    def as_json(self) -> dict[str, Any]:
        """Convert to the fixed form `hystmpc-diagnosis/3`: plain dicts, lists, numbers and strings."""
        fields, stability = _plain(asdict(self)), self.stability
        fields |= {
            "stability": None if stability is None else stability.share,
            "resamples": 0 if stability is None else stability.resamples,
            "otherwise": [] if stability is None else _plain(stability.otherwise),
        }
        return {"format": FORMAT, **fields}

    def __str__(self) -> str:
        lines = [f"{self.verdict}: {self.reason}"]
        for effect in self.effects:
            numbers = (f"{name} = {value:.4g} {effect.units[name]}" for name, value in effect.parameters.items())
            closes = f"closes {100 * effect.closed_share:.0f} % of the gap"
            lines.append(f"  {effect.name}: {', '.join(numbers)}; probability {effect.probability:.2f}; {closes}")
        return "\n".join(lines)

    def plot(self) -> Figure:
        """Draw the probability of each effect, and the share of the structural gap closed by the chosen ones."""
        from hystmpc.trials.report import MODEL, REFERENCE, new_figure  # matplotlib, not needed for a verdict

        names, closed = [name for name, _ in self.ranking], {e.name: e.closed_share for e in self.effects}
        with new_figure(7.0, 1.0 + 0.25 * len(names)) as figure:
            chance, share = figure.subplots(1, 2, sharey=True)
            chance.barh(names, [p for _, p in self.ranking], color=[MODEL if n in closed else REFERENCE for n in names])
            chance.set(xlim=(0, 1), xlabel="probability")
            chance.invert_yaxis()
            share.barh(names, [closed.get(name, 0.0) for name in names], color=MODEL)
            share.set(xlim=(min(0.0, *closed.values(), 0.0), 1), xlabel="closed share of the gap")
        return figure

    def _repr_html_(self) -> str:
        from hystmpc.trials.report import Paragraph, Plot, Report, Table

        rows = [(e.name, e.probability, e.closed_share, str(dict(e.parameters))) for e in self.effects]
        columns, gap = ("effect", "probability", "closed share", "parameters"), self.gap
        sizes = {
            "simulator as given": gap.nominal_rmse_deg,
            "retuned": gap.retuned_rmse_deg,
            "with effects": gap.with_effects_rmse_deg,
            "floor": gap.floor_rmse_deg,
        }
        pieces = (
            Paragraph(self.reason),
            Table(columns, rows),
            Table(("final trials", f"RMSE [{self.unit}]"), [*sizes.items()]),
        )
        shown = (*pieces, Plot(self.plot())) if self.ranking else pieces
        return Report(f"Diagnosis: {self.verdict}", shown).fragment()


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple) else value
