"""Thresholds of the verdict."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class VerdictSettings:
    """Thresholds of the verdict; chosen on development cases and frozen.

    Attributes:
        no_gap: retuned mean square error over the floor below which there is no gap.
        no_cause: the same where nothing in the library lowers the error, or not enough to explain it: a simulator whose
            form is off by more than it was on its own device, as when friction has grown, is likelier than a cause
            without a name.
        least_closed: share of the structural error that the causes have to close, or they do not explain it.
        still_open: mean square error that is left, by the floor, below which it counts as explained all the same.
        curve_left, curve_size: a curved gain alone is no explanation where two free curves of the angle explain more
            than the first share of the structural error it leaves, and that is more than the second of all of it.
        wander: slow change within trials, by what shifts between them explain, above which a shift is no explanation.
        nearer: how much nearer than to another explanation the truth has to lie to the chosen one, -1 to 1, for the
            two to be told apart ...
        nearer_errors: ... and by how many standard errors.
        significant_drift: standard errors by which a drift has to show within trials to be told apart from shifts
            between them.
        confirmed_alone, confirmed_several, confirmed_left: one cause, or several, have to close this share of the gap
            on the final trials, or to leave no more than so many times what noise and form leave.
        noise_share: share of the error that is left, from which noise and resolution of the sensor are named.
        mended_share: the same for outliers and dropouts.
        simplicity: share of the structural error that a resample has to gain by one more cause.
    """

    no_gap: float = 2.2
    no_cause: float = 7.0
    least_closed: float = 0.4
    still_open: float = 1.5
    curve_left: float = 0.7
    curve_size: float = 0.012
    wander: float = 0.7
    nearer: float = 0.2
    nearer_errors: float = 1.5
    significant_drift: float = 3.0
    confirmed_alone: float = 0.55
    confirmed_several: float = 0.8
    confirmed_left: float = 2.4
    noise_share: float = 0.3
    mended_share: float = 0.1
    simplicity: float = 0.04
