"""Identification of chains by any method, and the simulator made of what was identified."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from hystmpc.trials.errors import FitError, did_you_mean
from hystmpc.trials.from_outside import installed_objects
from hystmpc.trials.segments import Motion, segment
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..chain import Chain
from ..contract.metadata import DeviceLimits, NoiseModel, Range
from ..decades import Decades
from ..evaluate import evaluate
from ..model import FitProgress
from ..operators.hysteresis import Backlash
from ..simulator import ChainModel, Identification, Residual, Simulator
from ..start import trial_start
from .chain_fit import ChainFit, IdentificationMethod, in_log_units, told_in_log_units
from .chain_kinds import CHAIN_KINDS, Structure, backlash_starts, chain_task, prandtl_ishlinskii_starts
from .estimation_noise import estimation_noise
from .least_squares import OperatorFitSettings, fit_by_least_squares, fit_chain, one_blas_thread
from .runs import angle_range, check_trial_set, command_range, fastest_command, fingerprint

HOLDS_SHARE = 0.2
OPERATOR_KINDS = ("backlash", "pi")


def identify_chain(
    kind: str,
    trials: Sequence[Trial],
    method: str = "least_squares",
    settings: Any = None,
    plays: int = 4,
    progress: FitProgress | None = None,
    structure: Structure | None = None,
) -> tuple[Chain, ChainFit]:
    """Identify a chain by one of `METHODS`.

    Args:
        kind: a name of `CHAIN_KINDS`; for trials whose command and angle have changed places
            (`Trial.swapped`) `inverse_backlash`, `inverse_pi` or `inverse_drdpi`, whose numbers are their own.
        trials: uniformly sampled at one rate, in one pair of units.
        method: name of the method.
        settings: of the method; None for its defaults.
        plays: number of plays of a `pi` or `drdpi`; `structure` has the other sizes, and this one too if given.
        progress: called with the iteration (for least squares: the free runs over all trials) and the best error so
            far; KeyboardInterrupt ends the fit and keeps the best so far.
        structure: see `Structure`.

    Returns:
        The chain, and the result of which it is part.

    Raises:
        FitError: on an unknown kind or method, settings of another method, a kind that the method cannot identify,
            unusable trials, a missing extra, or no finite error.
    """
    if method not in METHODS:
        raise FitError(f"no identification method {method!r}, {did_you_mean(method, METHODS)}")
    chosen = METHODS[method]
    settings = settings or chosen.settings()
    if not isinstance(settings, chosen.settings):
        raise FitError(f"{method}: got {type(settings).__name__}, expected {chosen.settings.__name__}")
    decades = Decades.of(trials)
    structure, output = structure or Structure(plays=plays), decades.output(trials)
    task = chain_task(kind, decades.trials(trials), structure.in_working_units(decades.angle))
    if chosen.kinds is not None and kind not in chosen.kinds:
        raise FitError(f"{method} cannot identify {kind!r}, {did_you_mean(kind, chosen.kinds)}")
    fit = in_log_units(chosen.fit(task, settings, told_in_log_units(progress, output)), decades, output)
    return fit.chain, fit


@one_blas_thread
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
    noise: NoiseModel | None = None,
) -> Simulator:
    """An identified chain with the facts of its trials; the residuals are found by running it.

    Args:
        chain: what was identified.
        trials: from which.
        limits: what the device may be sent.
        method: how, in words.
        seed: of what was drawn at random.
        skip_first_flexure: whether each trial counted from the first reversal of its command on.
        noise: of trials that the fit did not see; where left out, that of these trials.

    Raises:
        FitError: on unusable trials, or a backlash whose lines cross within the trained range.
    """
    _check_lines(chain, command_range(trials))
    dt_s, box = check_trial_set(trials), limits.command or command_range(trials)

    def build(residuals: tuple[Residual, ...], noise: NoiseModel | None) -> Simulator:
        return Simulator(
            chain=chain,
            dt_s=dt_s,
            command_unit=trials[0].units.command,
            angle_unit=trials[0].units.angle,
            inverse=trials[0].inverted,
            rest_command=_rest_command(trials, box),
            command_limits=box,
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
                noise=noise,
            ),
        ).at_sample_time(dt_s)

    model = ChainModel(build((), None))
    runs = [(trial, evaluate(model, trial, skip_first_flexure)) for trial in trials]
    if noise is None and not model.metadata.inverted:
        errors = [(trial.angle - run.theta)[run.start :] for trial, run in runs]
        noise = estimation_noise(trials, errors, chain.values.size)
    return build(tuple(residual(trial, trial, run.theta, run.start) for trial, run in runs), noise)


def _rest_command(trials: Sequence[Trial], limits: Range) -> float | None:
    """Where the device rests before its trials, None for the lower end of what it may be sent.

    Of trials that all begin in motion it is not known: then where they begin.
    """
    if trials[0].inverted:
        return None
    starts = [trial_start(trial.command, trial.angle, trial.dt) for trial in trials]
    rests = [start.command for start in starts if start.at_rest] or [float(trial.command[0]) for trial in trials]
    rest = float(np.median(rests))
    return rest if rest > limits.lower + _FROM_BELOW * (limits.upper - limits.lower) else None


_FROM_BELOW = 0.01  # of the command's range: trials that begin higher up begin elsewhere than at its lower end


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


GROUP = "hystmpc.methods"
"""Entry points by which installed packages add a method; the value is MODULE:NAME of an `IdentificationMethod`."""

LEAST_SQUARES = IdentificationMethod(
    "least_squares",
    OperatorFitSettings,
    fit_by_least_squares,
    dict.fromkeys(CHAIN_KINDS, "best"),
    "bounded least squares on free runs with exact sensitivities, from several starts",
)
METHODS: Mapping[str, IdentificationMethod] = MappingProxyType(
    {
        LEAST_SQUARES.name: LEAST_SQUARES,
        **installed_objects(GROUP, "identification method", IdentificationMethod, [LEAST_SQUARES.name]),
    }
)
"""Identification methods by name, those of installed packages last."""


def methods_by_training(kind: str) -> Mapping[str, IdentificationMethod]:
    """The methods that can identify a kind of chain, by the training under which it has them, the default first."""
    return {method.trainings[kind]: method for method in METHODS.values() if kind in method.trainings}
