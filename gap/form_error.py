"""What the nominal simulator left unexplained on its own device: what does not exceed it is no news."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from hystmpc.models.fit.trial_set import fingerprint
from hystmpc.models.simulator import Identification
from hystmpc.trials.errors import LogError
from hystmpc.trials.trial import Trial, resample


def form_error_mse(
    identification: Identification, trials: Sequence[Trial], motions: Sequence[str], dt_s: float
) -> float:
    """Mean square error that model form alone explains [deg^2], zero where the simulator's file does not say.

    The residuals that a simulator's file stores come from a device without the gap, if they come from other trials.
    Where it was identified on one of these very trials, known by their fingerprints, they hold the gap itself and say
    nothing.

    Args:
        identification: of the simulator.
        trials: to be diagnosed, as recorded.
        motions: motion type of each.
        dt_s: sample time of the simulator, to which logs were brought before it was identified on them [s].
    """
    stored = identification.residuals
    if not stored or _has_seen(identification, trials, dt_s):
        return 0.0
    held = ["holds" if motion in ("holds", "steps", "point_to_point", "ramps") else "continuous" for motion in motions]
    everything = [r.rmse_deg**2 for r in stored]
    own = [[r.rmse_deg**2 for r in stored if r.motion == kind] or everything for kind in held]
    return float(np.mean([np.mean(values) for values in own]))


def _has_seen(identification: Identification, trials: Sequence[Trial], dt_s: float) -> bool:
    """Whether it was identified on one of these trials, or on all of them, at whatever rate."""
    known = {r.fingerprint for r in identification.residuals if r.fingerprint}
    # A file's sample time is rounded: 0.03333333333 s stand for 30 Hz, but 0.03 s for 1 / 0.03 Hz.
    for taken in (trials, *(_at(trials, rate) for rate in {1 / dt_s, round(1 / dt_s, 4)})):
        if identification.training_data_hash == fingerprint(taken):
            return True
        if any(fingerprint([trial]) in known for trial in taken):
            return True
    return False


def _at(trials: Sequence[Trial], rate_hz: float) -> list[Trial]:
    """The trials as an identification at that rate would have taken them; those that it could not take are left out."""
    taken = []
    for trial in trials:
        with suppress(LogError):
            taken.append(resample(trial, rate_hz))
    return taken


def nominal_noise_deg(identification: Identification) -> float | None:
    """White noise of the sensor when the simulator was identified [deg], from above; None where its file does not say.

    A residual with lag-one correlation c has at most the share 1 - c of its energy in white noise.
    """
    if not identification.residuals:
        return None
    return float(np.median([r.rmse_deg * np.sqrt(max(1 - r.lag_one, 0.0)) for r in identification.residuals]))
