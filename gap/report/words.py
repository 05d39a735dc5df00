"""Texts of a diagnosis: headline, reason of the verdict, and a sentence for each of its results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from hystmpc.models.effects.catalogue import effect_of
from hystmpc.models.identify.simulators import EFFECTS_FILE
from hystmpc.models.identify.uncertainty import BASELINE_UNITS, Interval
from hystmpc.models.simulator import Simulator
from hystmpc.trials.trial import Units

from ..diagnosis import (
    FIXED_FILE,
    Detectable,
    DetectableSizes,
    Diagnosis,
    Gap,
    IdentifiedEffect,
    InputDependence,
    RetunedParameter,
)

if TYPE_CHECKING:
    from ..decide.verdict import VerdictDecision
    from ..next.motion_design import MotionProposal
    from .report_data import ReportData

_UNREPEATABLE = "what is left differs between repeats of a motion, and no effect of the library explains that"


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in one sentence, without a full stop."""
    causes, stability = _causes(diagnosis), diagnosis.stability
    verb = "explain" if len(causes) > 1 else "explains"
    names, closed = listed(causes, "and") or "no effect", diagnosis.gap.closed_share
    much = f"{percent(closed)} of the gap" if math.isfinite(closed) and closed > 0 else "the gap"
    moved = listed([in_words(row.name) for row in diagnosis.moved], "and") or "numbers"
    moved += " have moved" if len(diagnosis.moved) != 1 else " has moved"
    said = {
        "named": f"{names} {verb} {much}",
        "one_of": f"{names} {verb} {much}: these trials cannot tell which",
        "unknown": _UNREPEATABLE if diagnosis.gap.unrepeatable else "no effect of the library explains the gap",
        "retuned": f"the simulator needs other numbers: {moved}",
        "none": "the simulator has no structural gap",
        "too_little": "these logs are too little for a diagnosis",
    }[diagnosis.verdict]
    said = f"{said[0].upper()}{said[1:]}"
    if stability is None or not stability.flips:
        return said
    return f"{said}. This verdict flips: it comes out in {percent(stability.share)} of the resampled splits"


def reason_for(
    decision: VerdictDecision,
    effects: Sequence[IdentifiedEffect],
    gap: Gap,
    too_little: str,
    unrelated: str,
    moved: Sequence[RetunedParameter] = (),
    unit: str = "deg",
) -> str:
    """The verdict in one sentence, with its numbers; `too_little` and `unrelated` say why trials are unusable."""
    sizes = f"retuned {gap.retuned_rmse_deg:#.3g} {unit}, floor {gap.floor_rmse_deg:#.3g} {unit}"
    names = ", ".join(effect.words for effect in effects)
    closed = f"{percent(gap.closed_share)} of the structural gap closed on trials kept for the end"
    sets = "; ".join(listed([in_words(name) for name in names], "or") for names in decision.ambiguity)
    unexplained = "a structural gap that no effect of the library explains"
    if gap.unrepeatable:
        differ = f"repeats of a motion differ by {gap.repeats_rmse_deg:#.3g} {unit}"
        unexplained = (
            f"{differ}, and retuning leaves no more: what is left does not depend on the command alone, and no effect "
            "of the library explains it"
        )
    return {
        "named": f"{names}: {closed}, {percent(gap.unexplained_share)} unexplained ({sizes})",
        "one_of": f"one of {sets}: these trials cannot tell them apart; {closed} ({sizes})",
        "unknown": f"{unrelated or unexplained} ({sizes})",
        "retuned": f"{_retuned_words(decision, gap, moved, unit)} ({sizes})",
        "none": f"no structural gap: retuning leaves no more than noise and the simulator's own form error ({sizes})",
        "too_little": f"too little: {too_little} ({sizes})",
    }[decision.verdict]


def dependence_note(follows: Sequence[InputDependence], unit: str) -> str:
    """Sentence on the measured input that differences between trials follow, and what to do."""
    name, units = follows[0].input, {"offset_deg": f" {unit}", "width_deg": f" {unit}", "gain_share": ""}
    slopes = listed(
        [f"{one.parameter.rsplit('_', 1)[0]} {one.slope:+.3g}{units[one.parameter]}" for one in follows], "and"
    )
    return (
        f"What differs between trials follows the measured input {name}: {listed(slopes, 'and')} for each unit of it. "
        f"This explains {percent(follows[0].share)} of the differences on trials left out. "
        f"`hystmpc fit auto LOGS --input {name}` makes a simulator that depends on it."
    )


def one_sample_note(late_s: float, dt_s: float) -> str:
    """Sentence on a lag or delay that is shorter than a sample."""
    return (
        f"A lag and a delay of {late_s:.2g} s end within one sample ({dt_s:.2g} s) and give nearly the same angles: no "
        "motion at this rate tells them apart, and either corrects the simulator. A higher rate may."
    )


def _retuned_words(decision: VerdictDecision, gap: Gap, moved: Sequence[RetunedParameter], unit: str) -> str:
    each = [
        f"{in_words(row.name)} {row.given:.3g} to {row.value:.3g}{'' if row.unit == '1' else f' {row.unit}'} "
        f"(90 % interval {row.ci90[0]:.3g} to {row.ci90[1]:.3g})"
        for row in moved
    ]
    numbers = ", ".join(each) or "numbers of the core, none of them for sure"
    fall = f"the RMSE falls from {gap.nominal_rmse_deg:#.3g} to {gap.retuned_rmse_deg:#.3g} {unit}"
    said = f"numbers of the same structure have moved, nothing is missing in it: {numbers}; {fall}"
    if decision.case == "moved":
        return said
    return f"{said}; the rest is the form error of this simulator with the friction as it is now: identify it anew"


def _causes(diagnosis: Diagnosis) -> list[str]:
    """Identified effects by probability, each with its possible alternatives, as `lag or delay`."""
    sets = {
        name: words
        for names, words in zip(diagnosis.ambiguity, ambiguous_sets(diagnosis), strict=True)
        for name in names
    }
    effects = sorted(diagnosis.effects, key=lambda effect: -effect.probability)
    causes = dict.fromkeys(sets.get(effect.name, effect.words) for effect in effects)
    return list(causes) or ambiguous_sets(diagnosis)


def ambiguous_sets(diagnosis: Diagnosis) -> list[str]:
    """Sets of effects that these trials cannot distinguish, the most probable first, as `lag or delay`."""
    chance = diagnosis.probabilities
    sets = (sorted(names, key=lambda name: -chance.get(name, 0.0)) for names in diagnosis.ambiguity)
    return [listed([in_words(name) for name in names], "or") for names in sets]


def closed_sentence(diagnosis: Diagnosis) -> str:
    """Sentence on the gap before and after, and the floor; without final trials over all trials."""
    gap, chosen, unit = diagnosis.gap, bool(diagnosis.effects), diagnosis.unit
    count = len(gap.final_trials)
    trials = f"{count} trial{'' if count == 1 else 's'} that nothing was chosen on" if count else "all trials together"
    sizes = [f"{_size(gap.nominal_rmse_deg, unit)} with the simulator as given"]
    sizes += [f"{_size(gap.retuned_rmse_deg, unit)} retuned"]
    sizes += [f"{_size(gap.with_effects_rmse_deg, unit)} with effects"] if chosen else []
    text = f"On {trials}, the RMSE is {listed(sizes, 'and')}; the floor is {_size(gap.floor_rmse_deg, unit)}."
    if diagnosis.kept_as_given:
        text += " Retuning does not lower it there, so that the simulator's numbers are kept as given."
    if any(effect.name == "sensor" for effect in diagnosis.effects):
        text += " From the last two the sensor's own noise is taken off, which counts as a cause."
    if not (chosen and math.isfinite(gap.closed_share)):
        return text
    low, high = gap.closed_ci90
    interval = f" (90 % interval {percent(low)} to {percent(high)})" if math.isfinite(low + high) else ""
    if gap.closed_share <= 0:
        return f"{text} On these trials the effects close nothing: {percent(gap.closed_share)}{interval}."
    return (
        f"{text} The effects close {percent(gap.closed_share)}{interval} of what retuning leaves above the floor; "
        f"{percent(gap.unexplained_share)} stays unexplained."
    )


def stability_sentence(diagnosis: Diagnosis) -> str:
    """Share of resampled splits with the same verdict; empty if the trials allow no choice."""
    stability = diagnosis.stability
    if stability is None:
        return ""
    same = round(stability.share * stability.resamples)
    text = f"The same verdict and names come out in {same} of {stability.resamples} resampled splits of these trials"
    others = [f"{_plain(result)} in {percent(share)}" for result, share in stability.otherwise]
    return f"{text}; else {listed(others, 'and')}." if others else f"{text}."


def _plain(result: str) -> str:
    """Result of another split in words: `named: lag, creep` as `lag, creep named`."""
    verdict, _, names = result.partition(": ")
    return f"{in_words(verdict)} ({in_words(names)})" if names else in_words(verdict)


def ceiling_sentence(diagnosis: Diagnosis) -> str:
    """Sentence on the share that a flexible model explains, a bound for the effects; otherwise empty."""
    share, closed = diagnosis.explainable_share, diagnosis.gap.closed_share
    if share is None:
        return ""
    text = f"A flexible model of no particular cause explains {percent(share)} of the structural gap on trials left out"
    if diagnosis.effects and closed > share:
        return (
            f"{text}, less than the {percent(closed)} that the effects close on the final trials. It knows nothing "
            "but the past of the command within a trial, so that it is no bound here."
        )
    return f"{text}: about what an effect that depends on the command can reach."


def order_sentences(diagnosis: Diagnosis) -> list[str]:
    """Sentences on the consequences of an unknown recording order; none if it is known."""
    if diagnosis.order == "known":
        return []
    first = (
        "The order in which the trials were recorded is unknown: their time stamps do not tell it, no manifest lists "
        "them, and --ordered was not given. The result does not depend on the order of the files."
    )
    return [first, *(untestable.why for untestable in diagnosis.untestable)]


def parameter_words(effect: IdentifiedEffect) -> str:
    """Identified values with their units; empty if the logs do not determine them."""
    return ", ".join(
        f"{name} not determined"
        if name in effect.undetermined
        else f"{name} {value:.3g} [{effect.units.get(name, '1')}]"
        for name, value in effect.parameters.items()
    )


def tracking_sentence(diagnosis: Diagnosis) -> str:
    """Sentence on the closed-loop tracking error now and with the corrected simulator; otherwise empty."""
    tracking = diagnosis.tracking
    if tracking is None:
        return ""
    if tracking.why_not or diagnosis.doubt:
        return f"How far the closed-loop tracking error falls cannot be said: {tracking.why_not or diagnosis.doubt}."
    before = _size_of(tracking.before_deg, tracking.before_range_deg, diagnosis.unit)
    after = _size_of(tracking.after_deg, tracking.after_range_deg, diagnosis.unit)
    floor = diagnosis.gap.floor_rmse_deg
    if not tracking.changes(floor):
        return (
            f"No fall of the closed-loop tracking error is expected: {before} RMS with the simulator as given, {after} "
            f"with the corrected one; the floor is {_size(floor, diagnosis.unit)}."
        )
    change = "fall" if tracking.fall_deg > 0 else "rise"
    return (
        f"The closed-loop tracking error is expected to {change} by {percent(abs(tracking.fall_share))}, "
        f"from {before} RMS to {after}, where the predictive controller, without learning, gets the corrected "
        "simulator as its model."
    )


def _size_of(value: float, ends: Interval, unit: str) -> str:
    size = _size(value, unit)
    return f"{size} ({ends[0]:.3g} to {ends[1]:.3g})" if ends[1] > ends[0] else size


def floor_words(gap: Gap, unit: str = "deg") -> str:
    """Text on the origin of the noise floor, and its consequence for the shares."""
    if gap.floor_kind == "repeats":
        return "The floor comes from repeats of a motion: what differs between them no simulator can follow."
    if gap.unrepeatable:
        return (
            f"Repeats of a motion differ by {_size(gap.repeats_rmse_deg, unit)}, and retuning leaves no more: "
            "that does not depend on the command alone. The floor is the noise in the upper band of the residual."
        )
    return (
        "No motion was repeated: the floor is the noise in the upper band of the residual, or the rounding of the "
        "readings where that is more: a lower bound, to which every share is relative."
    )


_ORDER_HIDES = " What is marked `order unknown` needs the order in which the trials were recorded."
_MIS_SET = 2.0  # mean square error as given over the retuned one, as for the verdict `retuned`
DETECTABLE_COLUMNS = ("effect", "least size", "hidden", "remark")


def baseline_units(diagnosis: Diagnosis) -> dict[str, str]:
    """Unit of each quantity that retuning changes."""
    units = Units(diagnosis.command_unit, diagnosis.unit)
    return {name: units.named(unit) for name, unit in BASELINE_UNITS.items()}


def retuning_sentence(diagnosis: Diagnosis) -> str:
    """Sentence on the quantities visibly changed by retuning; otherwise empty."""
    units = baseline_units(diagnosis)
    each = [
        f"{in_words(name)} from {given:.3g} to {retuned:.3g} {units.get(name, '')}"
        for name, (given, retuned) in diagnosis.retuned.items()
        if f"{given:.3g}" != f"{retuned:.3g}"
    ]
    return f"Retuning moves {listed(each, 'and')}." if each else ""


def mis_set_sentence(diagnosis: Diagnosis) -> str:
    """Sentence on retuned quantities that were half of the mean square error, if another cause is named."""
    gap = diagnosis.gap
    mis_set = gap.nominal_rmse_deg**2 > _MIS_SET * gap.retuned_rmse_deg**2
    return retuning_sentence(diagnosis) if mis_set and diagnosis.verdict in ("named", "one_of", "unknown") else ""


def detectable_rows(sizes: DetectableSizes) -> list[tuple[str, ...]]:
    """Table rows of the effects, in the columns of `DETECTABLE_COLUMNS`."""
    return [
        (
            in_words(one.effect),
            _least(one),
            percent(one.hidden) if math.isfinite(one.hidden) else "",
            "order unknown" if one.untestable else "jumps need more" if one.effect == "stick_slip" else "",
        )
        for one in sizes.effects
    ]


def _least(one: Detectable) -> str:
    if not math.isfinite(one.size):
        return "none shows"
    return f"{one.parameter} {one.size:.2g}" + (f" {one.unit}" if one.unit != "1" else "")


def detectable_sentence(sizes: DetectableSizes) -> str:
    """Meaning of the smallest detectable sizes, or the reason why there are none."""
    return sizes.why_not or (
        f"An effect has to leave {_size(sizes.needed_rmse_deg, sizes.unit)} RMS after retuning: less passes for the "
        "simulator's own model-form error. Each size is that of one effect alone in a free run over these commands; "
        "no measured angle was looked at, but for the first of each trial. Hidden: share of the effect's energy that "
        "retuning takes up. Stick-slip is seen by its jumps, which needs about 2.5 times its size."
        + (_ORDER_HIDES if any(one.untestable for one in sizes.effects) else "")
    )


# Blind checks of seeds 8814 and 9917: 9 of 40 (docs/results/gap_blind.md).
_SETTLED_SO_FAR = "on simulated devices of another physics, one such recording in four did"


def next_sentence(proposal: MotionProposal) -> str:
    """Sentence on the proposed motion and its reason."""
    chosen = proposal.chosen
    names = listed([in_words(name) for name in proposal.names], "from")
    return (
        f"To tell {names}, record {in_words(chosen.motion.name)} ({chosen.motion.duration_s:.0f} s) twice: "
        f"{chosen.motion.purpose}. If the device followed one of these equations exactly, the right one would be named "
        f"with a probability of {percent(chosen.probability)}. It need not settle the question: {_SETTLED_SO_FAR}."
    )


def listed(words: Sequence[str], joint: str) -> str:
    """Enumeration with commas and a conjunction before the last word."""
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} {joint} {words[-1]}"


def percent(share: float) -> str:
    """A share as a whole percentage."""
    return f"{100 * share:.0f} %" if math.isfinite(share) else "an unknown share"


def _size(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}" if math.isfinite(value) else "unknown"


def in_words(name: str) -> str:
    """A public name in words: `rate_dependence` as `rate dependence`."""
    return name.replace("_", " ")


_NEVER_HELD = ("trial_shift", "sensor", "configuration_change")  # of the trials or the sensor, not of the simulator
_BY_JUMPS = ("stick_slip",)  # detected by its jumps; part of the simulator only if a fit contains it
_LIKELY = 0.5  # probability, and share of the resamples, from which an effect counts as likely
_DENSE, _MOST = 1.5, 0.3  # density and share of the error, above which a part of the motion is mentioned


def verdict_facts(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Facts behind the verdict, each with its number."""
    if diagnosis.verdict in ("named", "one_of"):
        each = [f"{in_words(e.name)}: {parameter_words(e)}" for e in diagnosis.effects if e.parameters]
        values = f"The identified values are, of {'; of '.join(each)}.".replace(" [1]", "") if each else ""
        said = (closed_sentence(diagnosis), values, mis_set_sentence(diagnosis))
    else:
        unknown, none = diagnosis.verdict == "unknown", diagnosis.verdict == "none"
        more = _densest(diagnosis) if unknown else retuning_sentence(diagnosis) if none else ""
        said = (_sentence(diagnosis.reason), more, mis_set_sentence(diagnosis))
    return tuple(filter(None, said))


def next_actions(data: ReportData) -> tuple[str, ...]:
    """Advice on the use of the corrected simulator, its expected benefit, and the next recording."""
    diagnosis, motion = data.diagnosis, data.diagnosis.next_motion
    said = [_corrected(data)]
    tracking = diagnosis.tracking
    if tracking is not None and not tracking.why_not and not diagnosis.doubt:
        said.append(tracking_sentence(diagnosis))
    if diagnosis.replay and diagnosis.confirmed_rmse_deg is None:
        said.append(
            "Let your simulator play the commands of the folder replay, and diagnose again with --confirm and the "
            "folder of its output: that says how far the gap shrinks in your simulator."
        )
    if motion is not None:
        names = listed([in_words(name) for name in motion.separates], "and")
        said += [
            f"Record {motion.file} ({motion.duration_s:.0f} s) and diagnose all logs together again, to tell {names} "
            f"apart ({_SETTLED_SO_FAR}).",
            "Look at its command below before the device plays it.",
        ]
        if diagnosis.simulator == "stand_in":
            said.append("Let your simulator play what was recorded, too: every log needs its output.")
    elif diagnosis.verdict == "too_little":
        said.append("Record more motion of this device and diagnose all logs together.")
    elif diagnosis.verdict in ("one_of", "unknown") and not _unrelated(data):
        said.append("No motion of the safe menu is expected to settle what is open.")
    return tuple(filter(None, said))


def stand_in_sentence(diagnosis: Diagnosis) -> str:
    """Sentence on the user's own simulator and its stand-in; empty where the simulator itself was run."""
    if diagnosis.stand_in_rmse_deg is None:
        return ""
    error = _size(diagnosis.stand_in_rmse_deg, diagnosis.unit)
    return (
        "The simulator is your own: its recorded output counts, and a stand-in says how an effect would change it. "
        f"The stand-in differs from that output by {error} RMS, which is taken off."
    )


def confirmed_sentence(diagnosis: Diagnosis) -> str:
    """Sentence on what a replay in the user's own simulator confirmed; empty before a replay."""
    if diagnosis.confirmed_rmse_deg is None:
        return ""
    said = {effect.name: effect.closed_share for effect in diagnosis.effects}
    each = [
        f"{in_words(name)} closes {percent(one.closed_share)} of the gap in it ({percent(one.ci90[0])} to "
        f"{percent(one.ci90[1])}), {percent(said[name])} were said"
        for name, one in diagnosis.confirmed.items()
    ]
    rmse = _size(diagnosis.confirmed_rmse_deg, diagnosis.unit)
    untried = [in_words(name) for name in said if name not in diagnosis.confirmed]
    more = f" A replay cannot test {listed(untried, 'and')}: that acts behind the command." if untried else ""
    return f"Your simulator has played the commands behind the effects: {'; '.join(each)}; the RMSE is {rmse}.{more}"


def certainty(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Texts on probability, stability over splits, interval, floor, and untestable effects."""
    untested = ""
    if diagnosis.untestable:
        names = listed([in_words(each.name) for each in diagnosis.untestable], "and")
        untested = f"The order of recording is unknown, so that these cannot be tested: {names}."
    if diagnosis.verdict == "too_little":
        return tuple(filter(None, ("Nothing is named, and no share is worth reading.", untested)))
    floor = floor_words(diagnosis.gap, diagnosis.unit) if diagnosis.gap.floor_kind == "noise" else ""
    chance = _probability(diagnosis), _disagreement(diagnosis)
    said = (
        stand_in_sentence(diagnosis),
        confirmed_sentence(diagnosis),
        *chance,
        stability_sentence(diagnosis),
        _intervals(diagnosis),
        floor,
        untested,
    )
    return tuple(filter(None, said))


def _intervals(diagnosis: Diagnosis) -> str:
    each = [
        f"{in_words(e.name)} closes {percent(e.closed_ci90[0])} to {percent(e.closed_ci90[1])} of the gap"
        for e in diagnosis.effects
        if all(map(math.isfinite, e.closed_ci90))
    ]
    return f"By the 90 % interval{'s' if len(each) > 1 else ''}, {listed(each, 'and')}." if each else ""


def _densest(diagnosis: Diagnosis) -> str:
    places = {name: at for name, at in diagnosis.where.items() if at.density > _DENSE and at.share > _MOST}
    if not places:
        return ""
    name, place = max(places.items(), key=lambda item: item[1].share)
    share, time = percent(place.share), percent(place.share / place.density)
    return f"The error is densest in the part called {in_words(name)}: {share} of it in {time} of the time."


def _unrelated(data: ReportData) -> bool:
    return data.nominal is not None and data.fixed is None


def _corrected(data: ReportData) -> str:
    diagnosis = data.diagnosis
    if _unrelated(data):
        return "Look for a wrong file or column, a loose sensor, or a tendon or line that is broken."
    names = listed([in_words(effect.name) for effect in diagnosis.effects], "and")
    if diagnosis.relies_on_its_split:
        return f"Do not rely on {names}: the verdict flips. Record more trials and diagnose all logs together."
    if diagnosis.refuted:
        refuted = listed([in_words(name) for name in diagnosis.refuted], "and")
        return f"Do not rely on {names}: the replay does not confirm {refuted}. Record more trials and diagnose anew."
    if data.fixed is None:
        return f"Use {EFFECTS_FILE} beside the network." if EFFECTS_FILE in data.files else ""
    if diagnosis.verdict in ("named", "one_of"):
        return _with_effects(data, data.fixed)
    if diagnosis.verdict == "unknown":
        return f"Do not take {FIXED_FILE} for a cure: it is retuned, and the cause is not in it."
    if diagnosis.verdict == "too_little":
        return f"Do not use {FIXED_FILE}: these logs are too little to retune on."
    given, retuned = diagnosis.gap.nominal_rmse_deg, diagnosis.gap.retuned_rmse_deg
    if retuned < given:
        fall = f"from {given:.3g} to {retuned:.3g} {diagnosis.unit}"
        if diagnosis.simulator == "stand_in":
            return f"Retune your simulator: other numbers lower the RMSE on the {data.measured_on} {fall}."
        return f"Use {FIXED_FILE}: its retuned numbers lower the RMSE on the {data.measured_on} {fall}."
    return f"Keep the simulator as given: retuning does not lower the RMSE on the {data.measured_on}."


def _with_effects(data: ReportData, fixed: Simulator) -> str:
    diagnosis, chain = data.diagnosis, fixed.chain
    built_in = {effect_of(operator.name) for operator in (*chain.before, *chain.after)}
    names = [effect.name for effect in diagnosis.effects]
    left_out = [n for n in names if n in _NEVER_HELD or (n in _BY_JUMPS and n not in built_in)]
    held, lacking = (
        listed([in_words(name) for name in names if (name in left_out) == out], "and") for out in (False, True)
    )
    if not held:
        return f"The file {FIXED_FILE} is retuned only: it does not hold {lacking}." if lacking else ""
    if diagnosis.simulator == "stand_in":
        build = f"Build {held} into your simulator" if diagnosis.verdict == "named" else f"{held} lowers the error"
        said = f"{_sentence(build)} {FIXED_FILE} is its stand-in with {held}, and no more than that."
    elif diagnosis.verdict == "named":
        said = f"Use {FIXED_FILE}: it is the simulator with {held}."
    else:
        said = f"The corrected simulator, {FIXED_FILE}, holds {held}: it lowers the error, but proves no cause."
    return f"{said} It does not hold {lacking}." if lacking else said


def _probability(diagnosis: Diagnosis) -> str:
    """Probabilities of the identified effects and of their alternatives; otherwise of the most likely effect."""
    chance = diagnosis.probabilities
    effects = [effect.name for effect in diagnosis.effects]
    shown = list(dict.fromkeys([*effects, *(name for names in diagnosis.ambiguity for name in names)]))
    if not shown:
        if not diagnosis.ranking or diagnosis.verdict != "unknown":
            return ""
        name, p = diagnosis.ranking[0]
        return f"The most likely effect of the library, {in_words(name)}, has a probability of {percent(p)}."
    each = [f"{in_words(name)} with {percent(chance[name])}" for name in shown if name in chance]
    return _sentence(f"{listed(each, 'and')} probability".replace(" with", " is present with", 1)) if each else ""


def _disagreement(diagnosis: Diagnosis) -> str:
    """Explanation of a disagreement between probability and inclusion of an effect; otherwise empty."""
    apart = [e for e in diagnosis.effects if (e.probability >= _LIKELY) != (e.inclusion >= _LIKELY)]
    if not apart:
        return ""
    each = listed([f"{in_words(e.name)} in {percent(e.inclusion)}" for e in apart], "and")
    return (
        f"In the best explanation of resampled trials, where every further effect has a price, is {each} of the cases; "
        "the probability also weighs how much it closes and whether another effect could stand for it."
    )


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}" if text else ""
