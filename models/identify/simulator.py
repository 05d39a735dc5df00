"""From trials to a simulator: which operator, fitted how, and what it leaves unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hystmpc.trials.errors import FitError
from hystmpc.trials.segments import Motion, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..chain import Chain
from ..chain_model import ChainModel
from ..contract.metadata import Range
from ..evaluate import evaluate
from ..operators.backlash import Backlash
from ..simulator import Identification, Residual, Simulator
from .trial_set import DeviceLimits, angle_range, check_trial_set, command_range, fastest_command, fingerprint

HOLDS_SHARE = 0.2


def simulator_of(
    chain: Chain,
    trials: Sequence[Trial],
    limits: DeviceLimits,
    method: str,
    seed: int = 0,
    skip_first_flexure: bool = False,
) -> Simulator:
    """An identified chain with the facts of its trials; the residuals are found by running it.

    Args:
        chain: what was identified.
        trials: from which.
        limits: what the device may be sent.
        method: how, in words.
        seed: of what was drawn at random.
        skip_first_flexure: whether each trial counted from the first reversal of its command on.

    Raises:
        FitError: on unusable trials, or a backlash whose lines cross within the trained range.
    """
    _check_lines(chain, command_range(trials))

    def build(residuals: tuple[Residual, ...]) -> Simulator:
        return Simulator(
            chain=chain,
            dt_s=check_trial_set(trials),
            command_unit=trials[0].units.command,
            angle_unit=trials[0].units.angle,
            command_limits=limits.command or command_range(trials),
            command_rate_per_s=limits.rate_per_s or fastest_command(trials),
            trained_command=command_range(trials),
            trained_angle_deg=angle_range(trials),
            trained_rate_per_s=fastest_command(trials),
            identification=Identification(
                method=method,
                seed=seed,
                skip_first_flexure=skip_first_flexure,
                training_data_hash=fingerprint(trials),
                residuals=residuals,
            ),
        )

    model = ChainModel(build(()))
    runs = [(trial, evaluate(model, trial, skip_first_flexure)) for trial in trials]
    return build(tuple(residual(trial, trial, run.theta, run.start) for trial, run in runs))


def residual(log: Trial, trial: Trial, theta: Vec, start: int) -> Residual:
    """What a simulator leaves unexplained on a trial.

    Args:
        log: as recorded, for its name and fingerprint.
        trial: at the simulator's rate.
        theta: the simulator's free run (T,) [deg].
        start: first sample that counts.
    """
    error = (theta - trial.angle)[start:]
    around = error - error.mean()
    power = float(np.sum(around**2))
    held = float(np.mean(segment(trial).labels == Motion.HOLD))
    return Residual(
        log=Path(log.source).name,
        motion="holds" if held >= HOLDS_SHARE else "continuous",
        samples=error.size,
        rmse_deg=float(np.sqrt(np.mean(error**2))),
        bias_deg=float(np.mean(error)),
        lag_one=float(np.clip(np.sum(around[1:] * around[:-1]) / power, -1, 1)) if power > 0 else 0.0,
        fingerprint=fingerprint([log]),
    )


def _check_lines(chain: Chain, trained: Range) -> None:
    """A backlash whose unloading line dips below its loading line has no inverse there."""
    if isinstance(chain.core, Backlash):
        for u in (trained.lower, trained.upper):
            if chain.core.gap(u) < 0:
                raise FitError(
                    f"the fitted lines cross: at command {u:.4g} unloading lies {-chain.core.gap(u):.3g} deg below "
                    "loading, expected above; is the sign of the command right?"
                )
