"""Which causes could stand in the place of those that were chosen."""

from __future__ import annotations

from hystmpc.models.identify.cross_validation import CrossValidation, HeldOutErrors, gain, mean_square_difference
from hystmpc.models.identify.selection import Selection

from .verdict_settings import VerdictSettings
from .within_trials import drift_is_significant


def ambiguity_of(
    selection: Selection, validation: CrossValidation, settings: VerdictSettings
) -> tuple[tuple[str, ...], ...]:
    """For each chosen effect the others that could stand in its place; sets of fewer than two are left out.

    A drift and shifts from trial to trial are told apart by what happens within the trials: the drift goes on.
    """
    chosen, found = selection.chosen, []
    names = chosen.hypothesis.effects
    for effect in sorted(names):
        rest = names - {effect}
        others = []
        for tried, judged in selection.tried.items():
            exchanged = len(tried) == len(names) and rest < tried and tried != names
            if not exchanged or _told_apart(chosen, judged, settings):
                continue
            (other,) = tried - rest
            if (effect, other) != ("drift", "trial_shift") or not drift_is_significant(
                validation, chosen.hypothesis, settings.significant_drift
            ):
                others.append(other)
        if others:
            found.append((effect, *others))
    return tuple(found)


def _told_apart(chosen: HeldOutErrors, other: HeldOutErrors, settings: VerdictSettings) -> bool:
    """Whether held-out trials lie nearer to the chosen explanation than to another, by more than chance.

    With a and b what the two say of these trials and y what was seen,

        (|y - b|^2 - |y - a|^2) / |a - b|^2  =  1 - 2 (y - a) . (b - a) / |a - b|^2

    is 1 where a is true, -1 where b is, and 0 where the truth lies half way, as it does when it is neither. However
    small the difference of the errors is beside the gap, it decides if a and b differ by no more.
    """
    fall, error = gain(other, chosen)
    return fall > settings.nearer * mean_square_difference(chosen, other) and fall > settings.nearer_errors * error
