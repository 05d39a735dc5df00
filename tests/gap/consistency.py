"""Whether a diagnosis contradicts itself: in its numbers, and in the sentences of its page."""

from __future__ import annotations

from collections.abc import Iterator

from hystmpc.gap.diagnosis import Diagnosis
from hystmpc.gap.report.report_data import ReportData
from hystmpc.gap.report.words import (
    certainty,
    closed_sentence,
    headline,
    in_words,
    next_actions,
    tracking_sentence,
    verdict_facts,
)

_ROUNDED = 1e-9


def contradictions(data: ReportData) -> list[str]:
    """Everything in a diagnosis and its page that cannot stand beside something else in it."""
    return [*_in_probabilities(data.diagnosis), *_in_sizes(data.diagnosis), *_in_replay(data), *_in_words(data)]


def _in_probabilities(d: Diagnosis) -> Iterator[str]:
    chance = dict(d.ranking)
    found = [effect.probability for effect in d.effects]
    if found != sorted(found, reverse=True):
        yield f"effects are not in the order of their probability: {found}"
    if d.effects and d.ranking and d.ranking[0][1] > found[0] + _ROUNDED:
        yield f"{d.ranking[0]} is likelier than what was found, {d.effects[0].name} with {found[0]:.2f}"
    for effect in d.effects:
        if effect.probability > 0.5 * (1 + effect.inclusion) + _ROUNDED:
            yield f"{effect.name}: probability {effect.probability:.2f}, inclusion {effect.inclusion:.2f}"
        if effect.name in chance and chance[effect.name] != effect.probability:
            yield f"{effect.name} has two probabilities"
    if d.verdict in ("none", "retuned") and any(p >= 0.5 for p in chance.values()):
        yield f"nothing is missing, and {d.ranking[0]} is likelier than not"


def _in_sizes(d: Diagnosis) -> Iterator[str]:
    gap = d.gap
    if gap.retuned_rmse_deg > gap.nominal_rmse_deg * (1 + _ROUNDED):
        yield f"retuned is worse than as given: {gap.retuned_rmse_deg} > {gap.nominal_rmse_deg}"
    if d.effects and gap.with_effects_rmse_deg > gap.retuned_rmse_deg * (1 + _ROUNDED):
        yield f"effects raise the error: {gap.with_effects_rmse_deg} > {gap.retuned_rmse_deg}"
    if gap.floor_rmse_deg > gap.retuned_rmse_deg * (1 + _ROUNDED):
        yield f"the floor is above the error: {gap.floor_rmse_deg} > {gap.retuned_rmse_deg}"
    if d.relies_on_its_split and d.tracking is not None and not d.tracking.why_not:
        yield "a fall of the tracking error is foretold with effects that are not to be relied on"


def _in_replay(data: ReportData) -> Iterator[str]:
    d, said = data.diagnosis, " ".join(next_actions(data))
    if (d.simulator == "stand_in") != (d.stand_in_rmse_deg is not None):
        yield f"the simulator is {d.simulator}, and its stand-in's error is {d.stand_in_rmse_deg}"
    if d.confirmed and d.confirmed_rmse_deg is None:
        yield "shares are confirmed without a replay"
    if strange := set(d.confirmed) - {effect.name for effect in d.effects}:
        yield f"confirmed, and not named: {sorted(strange)}"
    for name, one in d.confirmed.items():
        refuted = in_words(name) in said.partition("does not confirm")[2].partition(".")[0]
        if refuted != (one.ci90[0] <= 0) and not d.relies_on_its_split:
            yield f"{name} closes {one.ci90[0]:.2f} or more in the user's simulator, and the advice is: {said}"


def _in_words(data: ReportData) -> Iterator[str]:
    d = data.diagnosis
    page = [headline(d), d.reason, closed_sentence(d), tracking_sentence(d)]
    page += [*verdict_facts(d), *next_actions(data), *certainty(d)]
    text = " ".join(page)
    if d.effects and d.verdict in ("named", "one_of"):
        led = max(d.effects, key=lambda effect: effect.probability)
        if not headline(d).lower().startswith(in_words(led.name)):
            yield f"the headline does not begin with {led.name}: {headline(d)}"
    distrusted = "Do not rely" in text or "Do not take" in text or "Do not use" in text
    for trust in ("is expected to fall", "is expected to rise", "Use sim.fixed.yaml", "into your simulator"):
        if distrusted and trust in text:
            yield f"do not rely on it, and '{trust}'"
    if "Keep the simulator as given" in text and "Use sim.fixed.yaml" in text:
        yield "keep the simulator, and use the corrected one"
    if d.gap.unrepeatable and ("a structural gap" in text or "explains the gap" in text):
        yield "a structural gap of what repeats of a motion differ by"
    apart = any((e.probability >= 0.5) != (e.inclusion >= 0.5) for e in d.effects)
    if apart and d.verdict != "too_little" and "In the best explanation of resampled trials" not in text:
        yield "probability and inclusion differ, and the page does not say why"
    if d.kept_as_given and "kept as given" not in text:
        yield "retuning was not taken, and the page does not say so"
