"""The first page of a report in sentences: why the verdict, what to do next, how sure it is."""

from __future__ import annotations

import math

from hystmpc.models.effects.catalogue import effect_of
from hystmpc.models.identify.simulators import EFFECTS_FILE
from hystmpc.models.simulator import Simulator

from ..diagnosis import Diagnosis, NextMotion, ResidualShare
from .report_data import FIXED_FILE, ReportData
from .words import (
    closed_sentence,
    floor_words,
    in_words,
    listed,
    mis_set_sentence,
    parameter_words,
    percent,
    probabilities,
    retuning_sentence,
    stability_sentence,
    tracking_sentence,
)

_NEVER_HELD = ("trial_shift", "sensor", "configuration_change")  # of the trials or the sensor, not of the simulator
_BY_JUMPS = ("stick_slip",)  # found by its jumps, it is in the simulator only where a fit found it as well
_LIKELY = 0.5  # probability, and share of the resamples, from which an effect counts as likely
_DENSE, _MOST = 1.5, 0.3  # density and share of the error, above which a place is worth a sentence


def verdict_facts(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Facts behind the verdict, each with its number."""
    if diagnosis.verdict in ("named", "one_of"):
        said = (closed_sentence(diagnosis), _values(diagnosis), mis_set_sentence(diagnosis))
    else:
        unknown, none = diagnosis.verdict == "unknown", diagnosis.verdict == "none"
        more = _densest(diagnosis) if unknown else retuning_sentence(diagnosis) if none else ""
        said = (_sentence(diagnosis.reason), more, mis_set_sentence(diagnosis))
    return tuple(filter(None, said))


def next_actions(data: ReportData) -> tuple[str, ...]:
    """What to do with the corrected simulator, what that brings, and what to record."""
    diagnosis, motion = data.diagnosis, data.diagnosis.next_motion
    said = [_corrected(data)]
    tracking = diagnosis.tracking
    if tracking is not None and not tracking.why_not and not diagnosis.relies_on_its_split:
        said.append(tracking_sentence(diagnosis))
    if motion is not None:
        said += _recording(motion)
    elif diagnosis.verdict == "too_little":
        said.append("Record more motion of this device and diagnose all logs together.")
    elif diagnosis.verdict in ("one_of", "unknown") and not _unrelated(data):
        said.append("No motion of the safe menu is expected to settle what is open.")
    return tuple(filter(None, said))


def certainty(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Probability, stability over splits, interval, floor, and what could not be tested."""
    untested = ""
    if diagnosis.untestable:
        names = listed([in_words(each.name) for each in diagnosis.untestable], "and")
        untested = f"The order of recording is unknown, so that these cannot be tested: {names}."
    if diagnosis.verdict == "too_little":
        return tuple(filter(None, ("Nothing is named, and no share is worth reading.", untested)))
    floor = floor_words(diagnosis.gap, diagnosis.unit) if diagnosis.gap.floor_kind == "noise" else ""
    chance = _probability(diagnosis), _disagreement(diagnosis)
    said = (*chance, stability_sentence(diagnosis), _intervals(diagnosis), floor, untested)
    return tuple(filter(None, said))


def _intervals(diagnosis: Diagnosis) -> str:
    each = [
        f"{in_words(e.name)} closes {percent(e.closed_ci90[0])} to {percent(e.closed_ci90[1])} of the gap"
        for e in diagnosis.effects
        if all(map(math.isfinite, e.closed_ci90))
    ]
    return f"By the 90 % interval{'s' if len(each) > 1 else ''}, {listed(each, 'and')}." if each else ""


def _values(diagnosis: Diagnosis) -> str:
    values = [f"{in_words(e.name)}: {parameter_words(e)}" for e in diagnosis.effects if e.parameters]
    return f"The identified values are, of {'; of '.join(values)}.".replace(" [1]", "") if values else ""


def _densest(diagnosis: Diagnosis) -> str:
    """The part of the motion where the error is densest, if that stands out."""
    places: list[tuple[str, ResidualShare]] = [
        (name, place) for name, place in diagnosis.where.items() if place.density > _DENSE and place.share > _MOST
    ]
    if not places:
        return ""
    name, place = max(places, key=lambda item: item[1].share)
    share, time = percent(place.share), percent(place.share / place.density)
    return f"The error is densest in the part called {in_words(name)}: {share} of it in {time} of the time."


def _unrelated(data: ReportData) -> bool:
    """Whether no angle follows its command: no simulator is corrected then."""
    return data.nominal is not None and data.fixed is None


def _corrected(data: ReportData) -> str:
    """Advice on the use of the corrected simulator."""
    diagnosis = data.diagnosis
    if _unrelated(data):
        return "Look for a wrong file or column, a loose sensor, or a tendon or line that is broken."
    names = listed([in_words(effect.name) for effect in diagnosis.effects], "and")
    if diagnosis.relies_on_its_split:
        return f"Do not rely on {names}: the verdict flips. Record more trials and diagnose all logs together."
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
        return f"Use {FIXED_FILE}: its retuned numbers lower the RMSE on the {data.measured_on} {fall}."
    return f"Keep the simulator as given: retuning does not lower the RMSE on the {data.measured_on}."


def _with_effects(data: ReportData, fixed: Simulator) -> str:
    """What to do with a corrected simulator that holds all of the effects, some of them or none."""
    diagnosis, chain = data.diagnosis, fixed.chain
    built_in = {effect_of(operator.name) for operator in (*chain.before, *chain.after)}
    names = [effect.name for effect in diagnosis.effects]
    left_out = [n for n in names if n in _NEVER_HELD or (n in _BY_JUMPS and n not in built_in)]
    held, lacking = (
        listed([in_words(name) for name in names if (name in left_out) == out], "and") for out in (False, True)
    )
    if not held:
        return f"The file {FIXED_FILE} is retuned only: it does not hold {lacking}." if lacking else ""
    if diagnosis.verdict == "named":
        said = f"Use {FIXED_FILE}: it is the simulator with {held}."
    else:
        said = f"The corrected simulator, {FIXED_FILE}, holds {held}: it lowers the error, but proves no cause."
    return f"{said} It does not hold {lacking}." if lacking else said


def _recording(motion: NextMotion) -> list[str]:
    names = listed([in_words(name) for name in motion.separates], "and")
    return [
        f"Record {motion.file} ({motion.duration_s:.0f} s) and diagnose all logs together again: the right one of "
        f"{names} is then named with an expected probability of {percent(motion.expected_probability)}.",
        "Look at its command below before the device plays it.",
    ]


def _probability(diagnosis: Diagnosis) -> str:
    """Probabilities of the effects found and of those they may stand for; else of the most likely one."""
    chance = probabilities(diagnosis)
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
    """Explanation where probability and inclusion of an effect disagree; empty where they agree."""
    apart = [e for e in diagnosis.effects if (e.probability >= _LIKELY) != (e.inclusion >= _LIKELY)]
    if not apart:
        return ""
    each = listed([f"{in_words(e.name)} in {percent(e.inclusion)}" for e in apart], "and")
    return (
        f"In the best explanation of resampled trials, where every further effect has a price, is {each} of the cases; "
        "the probability also weighs how much it closes and whether another effect could stand for it."
    )


def _sentence(text: str) -> str:
    """A text with a capital letter and a full stop."""
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}" if text else ""
