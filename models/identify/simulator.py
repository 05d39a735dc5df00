"""From trials to a simulator: which operator, fitted how, and what it leaves unexplained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hystmpc.trials.errors import FitError, did_you_mean
from hystmpc.trials.segments import Motion, segment
from hystmpc.trials.trial import Trial

from ..chain import Chain
from ..chain_model import ChainModel
from ..contract.metadata import Range
from ..evaluate import evaluate
from ..model import FitProgress
from ..operators.backlash import Backlash
from ..simulator import Identification, Residual, Simulator
from .chain_fit import ChainFit
from .chain_kinds import backlash_starts, prandtl_ishlinskii_starts
from .least_squares import OperatorFitSettings, fit_chain
from .trial_set import angle_range, check_trial_set, command_range, fastest_command, fingerprint

OPERATOR_KINDS = ("backlash", "pi")
HOLDS_SHARE = 0.2


@dataclass(frozen=True)
class DeviceLimits:
    """What the device may be sent; None takes what the trials show.

    Attributes:
        command: least and greatest command [mm or bar].
        rate_per_s: greatest change of the command [mm/s or bar/s].
    """

    command: Range | None = None
    rate_per_s: float | None = None


def identify(
    kind: str,
    trials: Sequence[Trial],
    settings: OperatorFitSettings | None = None,
    plays: int = 4,
    limits: DeviceLimits | None = None,
    progress: FitProgress | None = None,
) -> tuple[Simulator, ChainFit]:
    """Identify an operator and wrap it as a simulator.

    Args:
        kind: `backlash` (S2 eq. (1)-(2)) or `pi` (S2 eq. (4)).
        trials: uniformly sampled at one rate, in one unit.
        settings: of the least-squares fit.
        plays: number of plays of a `pi`.
        limits: what the device may be sent.
        progress: see `fit_chain`.

    Raises:
        FitError: on an unknown kind, unusable trials, or lines that cross within the trained range.
    """
    check_trial_set(trials)
    settings = settings or OperatorFitSettings()
    if kind not in OPERATOR_KINDS:
        raise FitError(f"no operator kind {kind!r}, {did_you_mean(kind, OPERATOR_KINDS)}")
    starts = backlash_starts(trials) if kind == "backlash" else prandtl_ishlinskii_starts(trials, plays)
    fit = fit_chain(starts, trials, settings, progress)
    method = "bounded least squares on free runs"
    return (
        simulator_of(fit.chain, trials, limits or DeviceLimits(), method, settings.seed, settings.skip_first_flexure),
        fit,
    )


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
    return build(tuple(_residual(model, trial, skip_first_flexure) for trial in trials))


def _residual(model: ChainModel, trial: Trial, skip_first_flexure: bool) -> Residual:
    result = evaluate(model, trial, skip_first_flexure)
    error = (result.theta - trial.angle)[result.start :]
    around = error - error.mean()
    power = float(np.sum(around**2))
    held = float(np.mean(segment(trial).labels == Motion.HOLD))
    return Residual(
        log=Path(trial.source).name,
        motion="holds" if held >= HOLDS_SHARE else "continuous",
        samples=error.size,
        rmse_deg=result.errors.rmse_deg,
        bias_deg=result.errors.bias_deg,
        lag_one=float(np.clip(np.sum(around[1:] * around[:-1]) / power, -1, 1)) if power > 0 else 0.0,
        fingerprint=fingerprint([trial]),
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
