"""Which effects a set of motions can tell apart, before any of them is looked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .excitation import LONG_HOLD_S, Excitation


@dataclass(frozen=True)
class Confusable:
    """Effects that look alike in some motions.

    Attributes:
        effects: their public names; two names of one class where `one_class`.
        separable: whether these motions can tell them apart.
        separated_by: the motion that does.
        found: what these motions have of it.
        alike_in_sine, alike_in_hold: share of one effect's gap that the other reproduces on a single 0.2 Hz sine, and
            on a ramp with a hold of 8 s (study on a Prandtl-Ishlinskii model with three plays, 50 Hz).
        one_class: equal in command and angle by algebra, whatever the motion.
    """

    effects: tuple[str, ...]
    separable: bool
    separated_by: str
    found: str
    alike_in_sine: float
    alike_in_hold: float
    one_class: bool = False


def confusability(excitation: Excitation) -> tuple[Confusable, ...]:
    """The table of confusable pairs, judged for these motions."""
    return tuple(rule(excitation) for rule in _RULES)


def _fast(e: Excitation) -> Confusable:
    found = f"{e.steps} fast steps, {e.fast_small} small moves faster than 1.5 Hz"
    return Confusable(
        ("lag", "delay", "rate_dependence"), e.has_fast, "fast steps and small sines of 2 to 4 Hz", found, 1.0, 0.99
    )


def _holds(e: Excitation) -> Confusable:
    return Confusable(("lag", "creep"), e.has_holds, "holds of 3 s and more", _longest(e), 0.95, 0.3)


def _opening(e: Excitation) -> Confusable:
    found = "the opening motion comes again" if e.opening_repeated else "the opening motion does not come again"
    return Confusable(("creep", "first_flexure"), e.opening_repeated, "the opening motion repeated", found, 0.97, 0.3)


def _long(e: Excitation) -> Confusable:
    able = e.has_long_hold and e.has_repeats
    wanted = f"holds of {LONG_HOLD_S:g} s and more, and a repeat of a motion"
    return Confusable(("drift", "creep"), able, wanted, f"{_longest(e)}, {_repeats(e)}", 0.96, 0.78)


def _speeds(e: Excitation) -> Confusable:
    speeds = ", ".join(f"{speed:.3g}" for speed in e.ramp_speeds) or "none"
    found = f"ramps at distinct speeds: {speeds}"
    return Confusable(("stick_slip", "lag"), e.has_speeds, "ramps at three speeds", found, 0.83, 0.54)


def _one_class(_: Excitation) -> Confusable:
    return Confusable(
        ("gravity", "nonlinear stretch"),
        False,
        "another orientation or load; reported as one class, nonlinear_gain",
        "command and angle only",
        0.99,
        0.98,
        one_class=True,
    )


def _lag_places(_: Excitation) -> Confusable:
    found, wanted = "command and angle only", "nothing; reported as one class, lag"
    return Confusable(("actuator lag", "sensor lag"), False, wanted, found, 0.99, 1.0, one_class=True)


def _low(e: Excitation) -> Confusable:
    found = f"{e.low_s:.3g} s in {e.low_visits} visits to the lowest tenth of the command"
    wanted = "another pretension; slow moves near the lowest command, three times and more"
    return Confusable(("slack", "nonlinear_gain"), e.dwells_low and not e.sine_only, wanted, found, 0.63, 0.38)


def _ends(e: Excitation) -> Confusable:
    found = f"{e.top_levels} distinct upper turning points"
    wanted = "the end approached from three amplitudes and more"
    return Confusable(("contact", "nonlinear_gain"), e.top_levels >= 3, wanted, found, 0.71, 0.8)


def _longest(e: Excitation) -> str:
    return f"longest hold {e.longest_hold_s:.3g} s" if e.longest_hold_s else "no hold"


def _repeats(e: Excitation) -> str:
    return f"{len(e.repeats)} pairs of repeats" if e.repeats else "no repeat"


_RULES: tuple[Callable[[Excitation], Confusable], ...] = (
    _fast,
    _lag_places,
    _holds,
    _opening,
    _long,
    _speeds,
    _one_class,
    _low,
    _ends,
)
