"""What the nominal simulator left unexplained on its own device: what does not exceed it is no news."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hystmpc.models.fit.trial_set import fingerprint
from hystmpc.models.simulator import Identification
from hystmpc.trials.resample import resample
from hystmpc.trials.trial import Trial


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
    known = {r.fingerprint for r in stored if r.fingerprint}
    if not stored or identification.training_data_hash in (fingerprint(trials), fingerprint(_at(trials, dt_s))):
        return 0.0
    if any(fingerprint([trial]) in known for trial in (*trials, *_at(trials, dt_s))):
        return 0.0
    held = ["holds" if motion in ("holds", "steps", "point_to_point", "ramps") else "continuous" for motion in motions]
    everything = [r.rmse_deg**2 for r in stored]
    own = [[r.rmse_deg**2 for r in stored if r.motion == kind] or everything for kind in held]
    return float(np.mean([np.mean(values) for values in own]))


def _at(trials: Sequence[Trial], dt_s: float) -> list[Trial]:
    """The trials as an identification at that sample time would have taken them; slower logs are left out."""
    return [resample(trial, 1 / dt_s) for trial in trials if trial.dt <= dt_s * (1 + 1e-6)]


def nominal_noise_deg(identification: Identification) -> float | None:
    """White noise of the sensor when the simulator was identified [deg], from above; None where its file does not say.

    A residual with lag-one correlation c has at most the share 1 - c of its energy in white noise.
    """
    if not identification.residuals:
        return None
    return float(np.median([r.rmse_deg * np.sqrt(max(1 - r.lag_one, 0.0)) for r in identification.residuals]))
