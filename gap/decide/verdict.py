"""The verdict of a diagnosis: one decision table over the facts of the earlier steps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from ..diagnosis import Verdict
from .retuning import Retuning

VERDICTS: Mapping[str, Verdict] = {
    "too_little": "too_little",
    "unrelated": "unknown",
    "no_gap": "none",
    "sensor_alone": "named",
    "small_gap": "none",
    "no_effect": "unknown",
    "left_open": "unknown",
    "structure_left": "unknown",
    "unproven": "unknown",
    "not_confirmed": "unknown",
    "ambiguous": "one_of",
    "explained": "named",
    "jumps": "named",
    "sensor_beside_unknown": "named",
    "at_floor": "none",
    "moved": "retuned",
    "reshaped": "retuned",
}
"""Verdict of each case of `decide_verdict`."""

_UNUSABLE = ("too_little", "unrelated")
_LEAST_MSE = 1e-9  # [deg^2]
_MENDS_FORM = frozenset(
    {"asymmetry", "nonlinear_gain", "trial_shift"}
)  # what the form error of a simple core of friction looks like


@dataclass(frozen=True)
class VerdictSettings:
    """Thresholds of the verdict; chosen on development cases and frozen. MSE: mean square error.

    Attributes:
        no_gap: retuned MSE over the model-form error, below which there is no gap.
        at_floor: retuned MSE over that of a floor, on the final trials, up to which there is no gap above it.
        no_cause: the same where no effect of the library lowers the error, or not enough to explain it: a simulator
            whose model-form error has grown, as by friction, is then likelier than an unknown cause.
        least_closed: share of the structural error that the causes have to close to explain it.
        still_open: remaining MSE over the floor, below which the error counts as explained all the same.
        curve_left, curve_size: a curved gain alone is no explanation where two free curves of the angle explain more
            than the first share of the structural error that it leaves, and more than the second share of all of it.
        wander: slow change within trials, over what shifts between them explain, above which a shift is no explanation.
        nearer: how much nearer the measurement is to the chosen explanation than to another, -1 to 1, for the two to
            be told apart ...
        nearer_errors: ... and by how many standard errors.
        timing_errors, quick_errors: standard errors by which a lag, a delay and a rate dependence are told apart, of
            errors held out in parts, or of quick ones.
        significant_drift: standard errors by which a drift has to show within trials to be told apart from shifts
            between them.
        scatter: chance by which shifts that scatter follow the clock so well, below which they are a drift.
        confirmed_alone, confirmed_several: share of the gap on the final trials that one cause, or several, must close.
        confirmed_left: RMSE with all causes over noise and model-form error, up to which they are confirmed as well.
        noise_share: share of the remaining error from which noise and resolution of the sensor are named.
        mended_share: the same for outliers and dropouts.
        step_share: share of the retuned error from which steps that the readings did not have are named where there is
            no other gap: the log itself proves them.
        simplicity: share of the structural error that a resample has to gain by one more cause.
        moved: MSE of the simulator as given over that of the retuned one, from which numbers were off ...
        lowered: ... and the same where the retuned one leaves more than its form error had been.
        friction: share of the retuned error that plays of other weights and widths have to explain for it to be the
            form error of a friction that has changed.
        width_grown: width of the loop with the effects in place, over the given one, from which the friction has
            grown so far that effects may be what it does: a tendon that only pulls goes slack under it, for example.
        anew: share of the structural error that a core identified anew has to explain for them to be that.
        unrepeatable: share of the retuned error in which repeats of one motion differ, from which it is no form error.
    """

    no_gap: float = 2.2
    at_floor: float = 1.1
    no_cause: float = 7.0
    least_closed: float = 0.4
    still_open: float = 1.5
    curve_left: float = 0.7
    curve_size: float = 0.012
    wander: float = 0.7
    nearer: float = 0.2
    nearer_errors: float = 1.5
    timing_errors: float = 2.0
    quick_errors: float = 3.0
    significant_drift: float = 3.0
    scatter: float = 0.01
    confirmed_alone: float = 0.55
    confirmed_several: float = 0.8
    confirmed_left: float = 2.4
    noise_share: float = 0.3
    mended_share: float = 0.1
    step_share: float = 0.005
    simplicity: float = 0.04
    moved: float = 2.0
    lowered: float = 1.2
    friction: float = 0.6
    width_grown: float = 1.35
    anew: float = 0.9
    unrepeatable: float = 0.5


@dataclass(frozen=True)
class FinalFacts:
    """Errors on the final trials.

    Attributes:
        closed_share: share of the gap that the causes close.
        residual_ratio: RMSE with all causes over noise and model-form error; 1 where that is unknown.
        unproven: whether effects were selected and none of them surely lowers the error.
        at_floor: whether the retuned simulator leaves no more than the noise.
        moved: error of the simulator as given over that of the retuned one, mean squares.
    """

    closed_share: float
    residual_ratio: float
    unproven: bool = False
    at_floor: bool = False
    moved: float = math.inf


@dataclass(frozen=True)
class VerdictFacts:
    """Errors and findings on which the verdict depends.

    Attributes:
        effects: names of the effects selected on the development trials.
        retuned_mse, chosen_mse: held-out errors without and with them [deg^2].
        retuned_fit_mse: error of the retuned simulator on the trials that it was retuned on [deg^2].
        floor_mse: below which an error carries no evidence [deg^2].
        form_mse: model-form error, or `floor_mse` where that is unknown [deg^2].
        structure_left: whether the selected effect alone leaves structure that contradicts it (`structure_left`).
        ambiguity: for each effect the others that explain the development trials as well.
        sensor: whether the sensor's faults are a good part of the error that the effects leave.
        sensor_gap: whether they would be a gap without any other cause.
        new_step: whether the readings have steps that the simulator's device did not have, and that do not vanish
            beside the error.
        jumps: whether the tip sticks and slips in steady motion.
        too_little, unrelated: whether the trials are too short, or no angle follows its command.
        retuning: what retuning did.
        width_grown: width of the loop with the selected effects in place, over the given one.
        final: errors on the final trials with the causes that were selected; None before these are evaluated.
    """

    effects: frozenset[str]
    retuned_mse: float
    chosen_mse: float
    retuned_fit_mse: float
    floor_mse: float
    form_mse: float
    structure_left: bool = False
    ambiguity: tuple[tuple[str, ...], ...] = ()
    sensor: bool = False
    sensor_gap: bool = False
    new_step: bool = False
    jumps: bool = False
    too_little: bool = False
    unrelated: bool = False
    retuning: Retuning = field(default_factory=Retuning)
    width_grown: float = 1.0
    final: FinalFacts | None = None

    @property
    def least_retuned_mse(self) -> float:
        """Retuned error, held out or fitted, the lesser of the two [deg^2].

        Held-out motions that are unlike the fitted ones add no structural gap.
        """
        return min(self.retuned_mse, self.retuned_fit_mse)

    @property
    def closed(self) -> float:
        """Share of the structural error of the development trials that the selected effects close."""
        return (self.retuned_mse - self.chosen_mse) / max(self.retuned_mse - self.floor_mse, 1e-12)

    def with_only(self, effects: frozenset[str], chosen_mse: float, width_grown: float) -> VerdictFacts:
        """Facts with some of the selected effects dropped, by the error and the loop width without these."""
        ambiguity = tuple(names for names in self.ambiguity if names[0] in effects)
        return replace(self, effects=effects, chosen_mse=chosen_mse, ambiguity=ambiguity, width_grown=width_grown)


def residual_ratio(mse: float, form_mse: float, noise_mse: float) -> float:
    """RMSE with all causes over noise and model-form error; 1 where the model-form error is unknown (zero)."""
    return math.sqrt(mse / max(form_mse, noise_mse, _LEAST_MSE)) if form_mse > 0 else 1.0


@dataclass(frozen=True)
class VerdictDecision:
    """Verdict of the decision table, and what follows from it.

    Attributes:
        case: row of the table in `decide_verdict`.
        ambiguity: sets of effects that these trials cannot tell apart; empty but for the verdict `one_of`.
        sensor: whether the sensor is a cause.
    """

    case: str
    ambiguity: tuple[tuple[str, ...], ...] = ()
    sensor: bool = False

    @property
    def verdict(self) -> Verdict:
        """Verdict of the diagnosis."""
        return VERDICTS[self.case]

    @property
    def explained(self) -> bool:
        """Whether the selected effects are the explanation, and part of the corrected simulator."""
        return self.case in ("ambiguous", "explained")

    @property
    def effects_unknown(self) -> bool:
        """Whether a gap remains for which no effect is known."""
        return self.verdict in ("unknown", "too_little") or self.case == "sensor_beside_unknown"


def decide_verdict(facts: VerdictFacts, settings: VerdictSettings) -> VerdictDecision:
    """Decide the verdict by the first row of the table that applies.

    | case                  | applies if                                                                  | verdict    |
    |-----------------------|-----------------------------------------------------------------------------|------------|
    | too_little            | the trials are too short or turn too rarely                                 | too_little |
    | unrelated             | no angle follows its command                                                | unknown    |
    | sensor_alone          | the sensor's faults are the gap: without them there is none, or no effect   | named      |
    |                       | was selected                                                                |            |
    | no_gap                | retuned MSE < `no_gap` x model-form error                                   | none (a)   |
    | small_gap             | no effect, or effects that leave the gap open; MSE < `no_cause` x form error | none (a)  |
    | no_effect             | no effect was selected                                                      | unknown (b)|
    | left_open             | the effects close < `least_closed`, and leave > `still_open` x floor        | unknown (b)|
    | structure_left        | the effect leaves structure that contradicts it                             | unknown (b)|
    | unproven              | final trials: no effect has an interval of its closed share above 0         | unknown (b)|
    | not_confirmed         | final trials: the effects close too little and leave too much; no sensor    | unknown    |
    |                       | fault, no jumps (what these leave is noise to any free run)                 |            |
    | ambiguous             | other effects explain the trials as well                                    | one_of     |
    | explained             | otherwise                                                                   | named      |
    | jumps                 | in place of (a) and (b): the tip sticks and slips                           | named      |
    | sensor_beside_unknown | in place of (b): repairing the sensor closes >= `least_closed` of the gap   | named      |
    | at_floor              | in place of any other unknown: the retuned error is that of the noise       | none       |
    | moved                 | in place of any none: the error fell by retuning                            | retuned    |
    | sensor_alone          | in place of any none: the readings have steps that they did not have        | named      |
    | reshaped              | the error fell by retuning, and a core of the same structure explains the   | retuned    |
    |                       | rest: one row of the table of `_reshaped`                                   |            |

    Effects that are not in the library are imitated by others, mostly several at once, that close a part of the gap:
    therefore several effects have to close more on the final trials than one alone.
    """
    none_selected, form, retuned = not facts.effects, facts.form_mse, facts.least_retuned_mse
    left_open = facts.closed < settings.least_closed and facts.chosen_mse > settings.still_open * facts.floor_mse
    repeats = facts.retuning.unrepeatable < settings.unrepeatable
    no_gap = retuned < settings.no_gap * form
    rows: tuple[tuple[str, bool], ...] = (
        ("too_little", facts.too_little),
        ("unrelated", facts.unrelated),
        ("sensor_alone", no_gap and facts.sensor and facts.sensor_gap),
        ("no_gap", no_gap),
        ("sensor_alone", none_selected and facts.sensor),
        ("small_gap", (none_selected or left_open) and repeats and retuned < settings.no_cause * form),
        ("no_effect", none_selected),
        ("left_open", left_open),
        ("structure_left", facts.structure_left),
        ("unproven", facts.final is not None and facts.final.unproven),
        ("not_confirmed", not (facts.sensor or facts.jumps or _confirmed(facts, settings))),
        ("ambiguous", bool(facts.ambiguity)),
        ("explained", True),
    )
    case = next(name for name, applies in rows if applies)
    usable = case not in _UNUSABLE
    if usable and facts.jumps and VERDICTS[case] in ("none", "unknown"):
        case = "jumps"
    if usable and facts.sensor and VERDICTS[case] == "unknown" and facts.final is not None:
        case = "sensor_beside_unknown" if facts.final.closed_share >= settings.least_closed else case
    if usable and VERDICTS[case] == "unknown" and facts.final is not None and facts.final.at_floor:
        case = "at_floor"
    case = _retuned_case(case, facts, settings) if usable else case
    if usable and facts.new_step and VERDICTS[case] == "none":
        case = "sensor_alone"
    sensor = usable and (facts.sensor or case == "sensor_alone") and VERDICTS[case] not in ("none", "retuned")
    return VerdictDecision(case, facts.ambiguity if case == "ambiguous" else (), sensor)


def _retuned_case(case: str, facts: VerdictFacts, settings: VerdictSettings) -> str:
    """`moved` or `reshaped` where retuning lowered the error and leaves model-form error; else the given case."""
    verdict, moved = VERDICTS[case], min(facts.retuning.moved, facts.final.moved if facts.final else math.inf)
    if verdict == "none":
        return "moved" if moved >= settings.moved else case
    outside_core = facts.sensor or facts.jumps
    replaced = verdict == "unknown" or (verdict in ("named", "one_of") and not outside_core)
    lowered = moved >= settings.lowered and facts.retuning.unrepeatable < settings.unrepeatable
    return "reshaped" if replaced and lowered and _reshaped(verdict, facts, settings) else case


def _reshaped(verdict: Verdict, facts: VerdictFacts, settings: VerdictSettings) -> bool:
    """Whether a hysteresis core of the same structure explains the error that retuning leaves: one row is enough.

    | the error is                                                | in place of                                      |
    |-------------------------------------------------------------|--------------------------------------------------|
    | form error of a loop that is so much higher                 | unknown; asymmetry, curved gain, shifts          |
    | such that plays of other weights and widths follow it       | the same; effects that explain less of it        |
    | such that a core identified anew follows it, and the loop   | anything                                         |
    | is far wider than it was, with the effects in place         |                                                  |
    """
    retuning = facts.retuning
    vague = verdict == "unknown" or (bool(facts.effects) and facts.effects <= _MENDS_FORM)
    higher = facts.least_retuned_mse < settings.no_gap * retuning.grown_form_mse
    spread = retuning.friction_share >= settings.friction
    better = bool(facts.effects) and retuning.friction_share >= facts.closed
    wider = facts.width_grown >= settings.width_grown and retuning.reidentified_share >= settings.anew
    return (vague and (higher or spread)) or (better and spread) or wider


def _confirmed(facts: VerdictFacts, settings: VerdictSettings) -> bool:
    """Whether the final trials confirm the selected effects; True before these are evaluated."""
    if facts.final is None:
        return True
    enough = settings.confirmed_several if len(facts.effects) > 1 else settings.confirmed_alone
    return facts.final.closed_share >= enough or facts.final.residual_ratio <= settings.confirmed_left
