"""From a selection to a verdict: named, one of several, unknown, none or too little; and how sure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .diagnosis import Verdict
from .hypothesis import Judged, apart, gain
from .lack_of_fit import curves_left
from .preparation import Prepared
from .recording import Run
from .select import Selection

_DRAWS = 300


@dataclass(frozen=True)
class VerdictSettings:
    """Thresholds of the verdict; chosen on development cases and frozen.

    Attributes:
        no_gap: retuned mean square error over the floor below which there is no gap.
        no_cause: the same where nothing in the library lowers the error: a simulator whose form is off by more than it
            was on its own device, as when friction has grown, is likelier than a cause without a name.
        least_closed: share of the structural error that the causes have to close, or they do not explain it.
        still_open: mean square error that is left, by the floor, below which it counts as explained all the same.
        curve_left, curve_size: a curved gain alone is no explanation where two free curves of the angle explain more
            than the first share of the structural error it leaves, and that is more than the second of all of it.
        nearer: how much nearer than to another explanation the truth has to lie to the chosen one, -1 to 1, for the
            two to be told apart ...
        nearer_errors: ... and by how many standard errors.
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
    nearer: float = 0.2
    nearer_errors: float = 1.5
    noise_share: float = 0.3
    mended_share: float = 0.1
    simplicity: float = 0.04


@dataclass(frozen=True)
class Ruling:
    """What the selection amounts to.

    Attributes:
        verdict: see `Diagnosis`.
        ambiguity: sets of effects that stand for one another.
        inclusion: share of resamples in which each effect is chosen.
    """

    verdict: Verdict
    ambiguity: tuple[tuple[str, ...], ...]
    inclusion: dict[str, float]


def sensor_matters(prepared: Prepared, selection: Selection, settings: VerdictSettings) -> bool:
    """Whether the sensor's signs are a good part of the error that the chosen causes leave."""
    signs, left = prepared.signs, selection.chosen.mse
    noise = signs.energy if signs.noisy or signs.coarse else 0.0
    mended = np.concatenate([raw - run.angle for raw, run in zip(prepared.raw, prepared.everything, strict=True)])
    return noise > settings.noise_share * left or float(np.mean(mended**2)) > settings.mended_share * left


def rule(
    selection: Selection,
    runs: Sequence[Run],
    floor_mse: float,
    form_mse: float,
    sensor: bool,
    settings: VerdictSettings,
    seed: int,
) -> Ruling:
    """Judge a selection.

    Args:
        selection: see `select`.
        runs: development runs.
        floor_mse: below which an error is no news [deg^2].
        form_mse: what the simulator left unexplained on its own device [deg^2]; zero where that is unknown.
        sensor: whether the sensor's signs matter.
        settings: thresholds.
        seed: of the resamples.
    """
    inclusion = _inclusion(selection, floor_mse, settings, seed)
    start, end = selection.baseline.mse, selection.chosen.mse
    # On the trials it was retuned on, too: what held-out trials add where the motion is new is no gap of structure.
    least, news = min(start, selection.baseline.hypothesis.mse), form_mse or floor_mse
    if least < settings.no_gap * news:
        return Ruling("none", (), inclusion)
    if not selection.chosen.hypothesis.effects:
        if sensor:
            return Ruling("named", (), inclusion)
        return Ruling("none" if least < settings.no_cause * news else "unknown", (), inclusion)
    closed = (start - end) / max(start - floor_mse, 1e-12)
    open_still = closed < settings.least_closed and end > settings.still_open * floor_mse
    if open_still or _bent_otherwise(selection, runs, floor_mse, settings):
        return Ruling("unknown", (), inclusion)
    ambiguity = _ambiguity(selection, settings)
    return Ruling("one_of" if ambiguity else "named", ambiguity, inclusion)


def _bent_otherwise(selection: Selection, runs: Sequence[Run], floor_mse: float, settings: VerdictSettings) -> bool:
    """Whether what is explained by a curved gain alone is another curve than that."""
    chosen, before = selection.chosen.hypothesis, selection.baseline.hypothesis.mse - floor_mse
    if chosen.effects != {"nonlinear_gain"} or before <= 0:
        return False
    left = curves_left(chosen, runs, floor_mse)
    return left > settings.curve_left and left * (chosen.mse - floor_mse) > settings.curve_size * before


def _ambiguity(selection: Selection, settings: VerdictSettings) -> tuple[tuple[str, ...], ...]:
    """For each chosen effect the others that could stand in its place."""
    chosen, found = selection.chosen, []
    names = chosen.hypothesis.effects
    for effect in sorted(names):
        rest = names - {effect}
        others = []
        for tried, judged in selection.tried.items():
            exchanged = len(tried) == len(names) and rest < tried and tried != names
            if exchanged and not _told_apart(chosen, judged, settings):
                others += sorted(tried - rest)
        if others:
            found.append((effect, *others))
    return tuple(found)


def _told_apart(chosen: Judged, other: Judged, settings: VerdictSettings) -> bool:
    """Whether held-out trials lie nearer to the chosen explanation than to another, by more than chance.

    With a and b what the two say of these trials and y what was seen,

        (|y - b|^2 - |y - a|^2) / |a - b|^2  =  1 - 2 (y - a) . (b - a) / |a - b|^2

    is 1 where a is true, -1 where b is, and 0 where the truth lies half way, as it does when it is neither. However
    small the difference of the errors is beside the gap, it decides if a and b differ by no more.
    """
    fall, error = gain(other, chosen)
    return fall > settings.nearer * apart(chosen, other) and fall > settings.nearer_errors * error


def _inclusion(selection: Selection, floor_mse: float, settings: VerdictSettings, seed: int) -> dict[str, float]:
    """How often each effect is in the best explanation of resampled blocks, more causes at a price."""
    rng = np.random.default_rng(seed)
    tried = list(selection.tried.values())
    energy = np.stack([judged.energy for judged in tried], axis=1)
    samples = tried[0].samples
    price = settings.simplicity * max(selection.baseline.mse - floor_mse, 0.0) + 0.05 * floor_mse
    sizes = np.array([len(judged.hypothesis.effects) for judged in tried])
    draws = rng.integers(0, samples.size, (_DRAWS, samples.size))
    counts = np.stack([np.bincount(draw, minlength=samples.size) for draw in draws])
    mse = (counts @ energy) / (counts @ samples)[:, None] + price * sizes
    best = np.argmin(mse, axis=1)
    names = sorted({name for judged in tried for name in judged.hypothesis.effects})
    return {name: float(np.mean([name in tried[k].hypothesis.effects for k in best])) for name in names}
