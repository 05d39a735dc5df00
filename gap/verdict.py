"""From a selection to a verdict: named, one of several, unknown, none or too little; and how sure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.models.identify.cross_validation import CrossValidation
from hystmpc.models.identify.runs import Run
from hystmpc.models.identify.selection import Selection

from .ambiguity import ambiguity_of
from .diagnosis import Verdict
from .lack_of_fit import remaining_curvature
from .preparation import Prepared
from .verdict_settings import VerdictSettings
from .within_trials import slow_within

_DRAWS = 300


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
    validation: CrossValidation,
    floor_mse: float,
    form_mse: float,
    sensor: bool,
    settings: VerdictSettings,
    seed: int,
) -> Ruling:
    """Judge a selection.

    Args:
        selection: see `select`.
        court: what the hypotheses were judged on.
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
    elsewhere = _bent_otherwise(selection, validation.runs, floor_mse, settings) or _wanders(
        selection, validation.runs, floor_mse, settings
    )
    if open_still and least < settings.no_cause * news:
        return Ruling("none", (), inclusion)
    if open_still or elsewhere:
        return Ruling("unknown", (), inclusion)
    ambiguity = ambiguity_of(selection, validation, settings)
    return Ruling("one_of" if ambiguity else "named", ambiguity, inclusion)


def _bent_otherwise(selection: Selection, runs: Sequence[Run], floor_mse: float, settings: VerdictSettings) -> bool:
    """Whether what is explained by a curved gain alone is another curve than that."""
    chosen, before = selection.chosen.hypothesis, selection.baseline.hypothesis.mse - floor_mse
    if chosen.effects != {"nonlinear_gain"} or before <= 0 or chosen.mse < settings.still_open * floor_mse:
        return False
    left = remaining_curvature(chosen, runs, floor_mse)
    return left > settings.curve_left and left * (chosen.mse - floor_mse) > settings.curve_size * before


def _wanders(selection: Selection, runs: Sequence[Run], floor_mse: float, settings: VerdictSettings) -> bool:
    """Whether what is explained by shifts between trials alone goes on within them."""
    chosen = selection.chosen.hypothesis
    if chosen.effects != {"trial_shift"}:
        return False
    slow = slow_within(chosen, runs) - floor_mse  # the simulator's own form is slow, too
    return slow > settings.wander * (selection.baseline.hypothesis.mse - chosen.mse)


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
