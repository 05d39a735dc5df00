"""Verdict of a diagnosis: one decision table over the facts of the earlier steps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from ..diagnosis import Verdict
from ..logs.detectable import NO_GAP
from .retuning import Retuning

VERDICTS: Mapping[str, Verdict] = {
    "too_little": "too_little",  # the trials are too short or turn too rarely
    "unrelated": "unknown",  # no angle follows its command
    "sensor_alone": "named",  # the gap is that of the sensor, or its readings have new steps
    "no_gap": "none",  # the retuned error is about the model-form error
    "small_gap": "none",  # it is not much more, and no effect closes it
    "no_effect": "unknown",  # no effect was selected
    "left_open": "unknown",  # the effects close too little and leave too much
    "structure_left": "unknown",  # the effect leaves structure that contradicts it
    "unproven": "unknown",  # final trials: no effect has an interval of its closed share above zero
    "not_confirmed": "unknown",  # final trials: the effects close too little and leave too much that they could predict
    "ambiguous": "one_of",  # other effects explain the trials as well
    "explained": "named",  # otherwise
    "jumps": "named",  # the tip sticks and slips, where nothing else is named
    "sensor_beside_unknown": "named",  # repairing the sensor closes a good part of a gap without another known cause
    "at_floor": "none",  # no known cause, and the retuned error is that of the noise
    "moved": "retuned",  # no gap, and the error fell by retuning
    "reshaped": "retuned",  # the error fell by retuning, and a core of the same structure explains the rest
}
"""Verdict of each case of `decide_verdict`; the first rows in the order of their evaluation."""

_UNUSABLE = ("too_little", "unrelated")
_LEAST_MSE = 1e-9  # [deg^2]
_MENDS_FORM = frozenset(
    {"asymmetry", "nonlinear_gain", "trial_shift"}
)  # effects that resemble the form error of a simple core of friction


# Thresholds of the verdict, chosen on development cases and frozen; others are defined at their use. MSE: mean square.
AT_FLOOR = 1.1  # retuned MSE over that of a floor, on the final trials, up to which there is no gap above it
# The same over the model-form error, grown with the loop, if no effect of the library explains the error: an increased
# model-form error, as by friction, is then more likely than an unknown cause.
_NO_CAUSE = 7.0
_LEAST_CLOSED = 0.4  # share of the structural error that the causes have to close to explain it
STILL_OPEN = 1.5  # remaining MSE over the floor, below which the error counts as explained all the same
_CONFIRMED_ALONE, _CONFIRMED_SEVERAL = 0.55, 0.8  # share of the final gap that one cause, or several, must close
# RMSE with all causes over noise and model-form error, up to which they are confirmed as well; of a simulator with a
# large model-form error nearly everything is within that, so that they must close the least share all the same. So must
# those that close enough of all trials: slow final trials hold little of what fast ones show.
_CONFIRMED_LEFT = 2.4
_MOVED = 2.0  # MSE of the simulator as given over that of the retuned one, from which numbers were off ...
_LOWERED = 1.2  # ... and the same where the retuned one leaves more than its form error had been
# Width of the loop with the effects, over the given one, from which an increased friction may cause the effects
# themselves, such as slack of a tendon that only pulls.
WIDTH_GROWN = 1.35
_ANEW = 0.75  # share of the structural error that a core with other weights, or another core, explains as the cause
_UNREPEATABLE = 0.5  # share of the retuned error in which repeats of one motion differ, from which it is no form error


@dataclass(frozen=True)
class FinalFacts:
    """Errors on the final trials.

    Attributes:
        residual_ratio: RMSE with all causes over noise and model-form error; 1 if that is unknown.
        unproven: whether effects were selected, but none of them significantly lowers the error.
        at_floor: whether the error of the retuned simulator is at most the noise.
        moved: mean square error of the simulator as given over that of the retuned one.
        everywhere: closed share of all trials, the development trials as held out (`closed_everywhere`).
    """

    closed_share: float
    residual_ratio: float
    unproven: bool = False
    at_floor: bool = False
    moved: float = math.inf
    everywhere: float = 0.0


@dataclass(frozen=True)
class VerdictFacts:
    """Errors and findings on which the verdict depends.

    Attributes:
        retuned_mse, chosen_mse: held-out errors without and with the selected effects [deg^2].
        retuned_fit_mse: error of the retuned simulator on the trials of its fit [deg^2].
        floor_mse: error below which there is no evidence [deg^2].
        form_mse: model-form error, or `floor_mse` if unknown [deg^2].
        structure_left: whether the selected effect alone leaves structure that contradicts it (`structure_left`).
        ambiguity: for each effect the others that explain the development trials equally well.
        sensor: whether the sensor's faults are a good part of the error that the effects leave.
        sensor_gap: whether the sensor's faults alone would be a gap.
        excess_mse: energy of the sensor's noise beyond that at identification [deg^2].
        new_step: whether the readings have steps absent in the simulator's device, and not negligible in the error.
        too_little, unrelated: whether the trials are too short, or no angle follows its command.
        width_grown: width of the loop with the selected effects, over the given one.
        final: errors on the final trials with the selected causes; None before their evaluation.
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
    excess_mse: float = 0.0
    new_step: bool = False
    jumps: bool = False
    too_little: bool = False
    unrelated: bool = False
    retuning: Retuning = field(default_factory=Retuning)
    width_grown: float = 1.0
    final: FinalFacts | None = None

    @property
    def least_retuned_mse(self) -> float:
        """Smaller of held-out and fitted retuned error [deg^2], since unlike motions must not add a structural gap."""
        return min(self.retuned_mse, self.retuned_fit_mse)

    @property
    def closed(self) -> float:
        """Share of the structural error of the development trials closed by the selected effects."""
        return (self.retuned_mse - self.chosen_mse) / max(self.retuned_mse - self.floor_mse, 1e-12)

    @property
    def form_like(self) -> frozenset[str]:
        """Effect beside others that an asymmetry and a third effect would replace as well; empty if there is none.

        Three shapes of a loop that explain an error equally well are its form: no cause is all of them.
        """
        several = len(self.effects) > 1
        sets = [names for names in self.ambiguity if several and len(names) > 2 and "asymmetry" in names]
        return frozenset(sets[0][:1]) if sets else frozenset()

    def closed_everywhere(self, final_mse: tuple[float, float], part: float) -> float:
        """Share of the structural error of all trials closed by the selected effects, held out.

        Args:
            final_mse: errors of the final trials without and with the effects [deg^2].
            part: of all samples that is of the final trials.
        """
        before, after = (
            (1 - part) * one + part * other
            for one, other in zip((self.retuned_mse, self.chosen_mse), final_mse, strict=True)
        )
        return (before - after) / max(before - self.floor_mse, 1e-12)

    def with_only(self, effects: frozenset[str], chosen_mse: float, width_grown: float) -> VerdictFacts:
        """Facts after removal of all effects but the given ones."""
        ambiguity = tuple(names for names in self.ambiguity if names[0] in effects)
        return replace(self, effects=effects, chosen_mse=chosen_mse, ambiguity=ambiguity, width_grown=width_grown)


def residual_ratio(mse: float, form_mse: float, noise_mse: float) -> float:
    """RMSE with all causes over noise and model-form error; 1 if the model-form error is unknown (zero)."""
    return math.sqrt(mse / max(form_mse, noise_mse, _LEAST_MSE)) if form_mse > 0 else 1.0


@dataclass(frozen=True)
class VerdictDecision:
    """Verdict of the decision table, and its consequences.

    Attributes:
        ambiguity: sets of effects that these trials cannot distinguish; empty unless the verdict is `one_of`.
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


def decide_verdict(facts: VerdictFacts) -> VerdictDecision:
    """Decide the verdict by the first applicable row of a table, then apply the facts that override it.

    Other effects, mostly several at once, can imitate an effect missing in the library and close part of the gap:
    therefore several effects must close more on the final trials than a single one.
    """
    none_selected, form, retuned = not facts.effects, facts.form_mse, facts.least_retuned_mse
    left_open = facts.closed < _LEAST_CLOSED and facts.chosen_mse > STILL_OPEN * facts.floor_mse
    repeats = facts.retuning.unrepeatable < _UNREPEATABLE
    no_gap = retuned - (facts.excess_mse if facts.sensor else 0.0) < NO_GAP * form
    rows: tuple[tuple[str, bool], ...] = (
        ("too_little", facts.too_little),
        ("unrelated", facts.unrelated),
        ("sensor_alone", no_gap and facts.sensor and facts.sensor_gap),
        ("no_gap", no_gap),
        ("sensor_alone", none_selected and facts.sensor),
        ("small_gap", (none_selected or left_open) and repeats and retuned < _NO_CAUSE * form),
        ("no_effect", none_selected),
        ("left_open", left_open),
        ("structure_left", facts.structure_left),
        ("unproven", facts.final is not None and facts.final.unproven),
        ("not_confirmed", not (facts.sensor or facts.jumps or _confirmed(facts))),
        ("ambiguous", bool(facts.ambiguity)),
        ("explained", True),
    )
    case = next(name for name, applies in rows if applies)
    usable = case not in _UNUSABLE
    if usable and facts.jumps and VERDICTS[case] in ("none", "unknown"):
        case = "jumps"
    if usable and facts.sensor and VERDICTS[case] == "unknown" and facts.final is not None:
        case = "sensor_beside_unknown" if facts.final.closed_share >= _LEAST_CLOSED else case
    if usable and VERDICTS[case] == "unknown" and facts.final is not None and facts.final.at_floor:
        case = "at_floor"
    case = _retuned_case(case, facts) if usable else case
    if usable and facts.new_step and VERDICTS[case] == "none":
        case = "sensor_alone"
    sensor = usable and (facts.sensor or case == "sensor_alone") and VERDICTS[case] not in ("none", "retuned")
    return VerdictDecision(case, facts.ambiguity if case == "ambiguous" else (), sensor)


def _retuned_case(case: str, facts: VerdictFacts) -> str:
    """`moved` or `reshaped` if retuning lowered the error and leaves model-form error; otherwise the given case."""
    verdict, moved = VERDICTS[case], min(facts.retuning.moved, facts.final.moved if facts.final else math.inf)
    if verdict == "none":
        return "moved" if moved >= _MOVED else case
    outside_core = facts.sensor or facts.jumps
    replaced = verdict == "unknown" or (verdict in ("named", "one_of") and not outside_core)
    lowered = moved >= _LOWERED and facts.retuning.unrepeatable < _UNREPEATABLE
    return "reshaped" if replaced and lowered and _reshaped(case, facts) else case


def _reshaped(case: str, facts: VerdictFacts) -> bool:
    """Whether the error after retuning indicates a reshaped hysteresis core; one row of the table suffices.

    | the error is                                                | in place of                                      |
    |-------------------------------------------------------------|--------------------------------------------------|
    | form error of a loop that is so much higher                 | unknown; asymmetry, curved gain, shifts          |
    | such that plays of other weights and widths follow it       | the same; effects that explain less of it        |
    | such that a core identified anew follows it, and the loop   | anything                                         |
    | is far wider than it was, with the effects in place         |                                                  |
    """
    retuning = facts.retuning
    replaceable = {names[0] for names in facts.ambiguity if _MENDS_FORM & set(names)}
    vague = VERDICTS[case] == "unknown" or (bool(facts.effects) and facts.effects <= _MENDS_FORM | replaceable)
    higher = facts.least_retuned_mse < NO_GAP * retuning.grown_form_mse
    if case in ("no_effect", "left_open"):
        grown = min(retuning.grown_form_mse, _NO_CAUSE * facts.form_mse)
        higher = higher or facts.least_retuned_mse < _NO_CAUSE * grown
    spread = retuning.friction_share >= _ANEW
    better = bool(facts.effects) and retuning.friction_share >= facts.closed
    wider = facts.width_grown >= WIDTH_GROWN and retuning.reidentified_share >= _ANEW
    return (vague and (higher or spread)) or (better and spread) or wider


def _confirmed(facts: VerdictFacts) -> bool:
    """Whether the final trials confirm the selected effects; True before their evaluation."""
    if facts.final is None:
        return True
    enough = _CONFIRMED_SEVERAL if len(facts.effects) > 1 else _CONFIRMED_ALONE
    near = facts.final.residual_ratio <= _CONFIRMED_LEFT or facts.final.everywhere >= enough
    return facts.final.closed_share >= enough or (near and facts.final.closed_share >= _LEAST_CLOSED)
