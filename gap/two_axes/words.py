"""Sentences of a diagnosis of two axes: one headline for what joins them, one for each axis."""

from __future__ import annotations

from ..report.words import headline, in_words, listed, percent
from .diagnosis import JoinEffect, KnownJoins, TwoAxisDiagnosis

_ACTIONS = {
    "misalignment": "Turn the tendons back, or use `sim.fixed.yaml`, which has their directions.",
    "cross_coupling": "Look for a turned sensor, or for tendons that are turned behind their own friction. "
    "`sim.fixed.yaml` has what each angle shows.",
    "shared_friction": "A motion along one axis frees or stiffens the other one: use `sim.fixed.yaml`, which has that.",
}


def headlines(diagnosis: TwoAxisDiagnosis) -> tuple[str, str, str]:
    """A sentence on what joins the axes, and one on each axis."""
    return (
        f"between the axes: {join_headline(diagnosis.joins)}",
        f"axis x: {headline(diagnosis.x)}",
        f"axis y: {headline(diagnosis.y)}",
    )


def join_headline(joins: KnownJoins) -> str:
    """What joins the axes otherwise than in the simulator, in one sentence without a full stop."""
    if not joins.effects:
        return "Both axes are joined as in the simulator"
    names = listed([in_words(effect.name) for effect in joins.effects], "and")
    closed = percent(sum(effect.closed_share for effect in joins.effects))
    verb = "explains" if len(joins.effects) == 1 else "explain"
    doubt = ": these trials cannot tell which" if joins.ambiguity else ""
    named = listed([listed([in_words(n) for n in names], "or") for names in joins.ambiguity], "and") if doubt else names
    return f"{named[0].upper()}{named[1:]} {verb} {closed} of the gap that neither axis explains alone{doubt}"


def effect_sentence(effect: JoinEffect) -> str:
    """What an effect between the axes is, with its numbers."""
    said = {key: f"{value:.3g} ({low:.3g} to {high:.3g})" for key, value, (low, high) in _rows(effect)}
    if effect.name == "misalignment":
        return (
            f"The tendons pull turned by {said['turn_deg']} deg from where the simulator has them. "
            f"That of x is turned by {said['skew_deg']} deg more than that of y."
        )
    if effect.name == "cross_coupling":
        return (
            f"Angle x shows {said['x_by_y']} deg more for each degree along y than in the simulator, "
            f"and angle y {said['y_by_x']} deg for each along x. Both have a turn of {said['turn_deg']} deg in common."
        )
    return (
        "A motion along one axis frees or stiffens the other one, otherwise than in the simulator. "
        f"This changes x by {said['x_deg']} deg and y by {said['y_deg']} deg RMS."
    )


def join_actions(diagnosis: TwoAxisDiagnosis) -> tuple[str, ...]:
    """What to do about each effect between the axes."""
    sets = [
        f"Record motions that turn back at many places along each axis: {listed([in_words(n) for n in names], 'and')} "
        "differ by the plays of the axes alone."
        for names in diagnosis.joins.ambiguity
    ]
    return (*(_ACTIONS[effect.name] for effect in diagnosis.joins.effects), *sets)


def _rows(effect: JoinEffect) -> list[tuple[str, float, tuple[float, float]]]:
    return [(key, value, effect.ci90[key]) for key, value in effect.parameters.items()]
