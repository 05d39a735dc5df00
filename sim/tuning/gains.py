"""PID gains by global search on the study's plant and motions: the best PID for comparison."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import OptimizeResult, differential_evolution

from hystmpc.ctrl.config import AnyControllerSettings
from hystmpc.ctrl.feedback import InversePidControllerSettings, PidControllerSettings
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Progress, Vec, parts

from ..two_axes.study import AnyStudy

PidLike = PidControllerSettings | InversePidControllerSettings
_PER_PARAMETER = 3
_KP_KI = ((1e-4, 1.0), (1e-2, 10.0))  # [cmd/deg], [cmd/(deg s)], searched by their logarithms
_KD = (0.0, 0.05)  # [cmd s/deg]
_DEAD_ZONE_DEG = (0.0, 0.5)


@dataclass(frozen=True)
class PidTuning:
    """Result of a search: settings, RMS true error [deg] with them and at the start, number of runs."""

    settings: PidLike
    rmse_deg: float
    start_rmse_deg: float
    evaluations: int


def tuned_gains(study: AnyStudy, settings: PidLike, progress: Progress | None = None) -> PidTuning:
    """Search the gains that track all motions of a study best, by seeded differential evolution.

    J = mean over motions of mean_k |theta_k - r_k|^2 with the true angle theta, so the result is the strongest
    competitor of a model-based controller, not a prediction for another device. The noise has the study's deviation but
    is another realisation, so that the comparison is not biased towards these gains. The given gains belong to the
    first population, so that the result is never worse.

    Args:
        settings: the controller whose `kp`, `ki`, `kd` and dead zone are searched; everything else stays.

    Raises:
        ConfigError: if the study has no `tune_pid`.
        KeyboardInterrupt: if the user ends the search; nothing is kept.
    """
    search = study.config.tune_pid
    if search is None:
        raise ConfigError("tune_pid: got none, expected settings of the search")
    changes: dict[str, Any] = {"plant": study.plant.reseeded(study.config.seed + 1)}
    other = replace(study, **changes)
    return searched_gains(
        settings, lambda tried: mean_square_of(other, tried), search.evaluations, study.config.seed, progress
    )


def searched_gains(
    settings: PidLike,
    mean_square: Callable[[PidLike], float],
    evaluations: int,
    seed: int,
    progress: Progress | None = None,
) -> PidTuning:
    """Search the gains of least mean square error by seeded differential evolution, never worse than the given ones.

    Args:
        settings: start of the search; everything but `kp`, `ki`, `kd` and dead zone stays.
        mean_square: of a controller over all its motions [deg^2].
        evaluations: number of calls of `mean_square`, about.

    Raises:
        KeyboardInterrupt: if the user ends the search; nothing is kept.
    """
    bounds = np.array([*np.log(_KP_KI), _KD, _DEAD_ZONE_DEG])
    population = _PER_PARAMETER * len(bounds)
    # scipy counts generations after the first population
    generations = max(1, evaluations // population - 1)
    total, done = population * (generations + 1), 0

    def cost(x: Vec) -> float:
        nonlocal done
        done += 1
        if progress is not None:
            progress(min(done, total), total)
        return mean_square(with_gains(settings, x))

    optimum: OptimizeResult = differential_evolution(
        cost,
        bounds,
        x0=np.clip(_point(settings), *bounds.T),
        popsize=_PER_PARAMETER,
        maxiter=generations,
        polish=False,
        tol=1e-4,
        rng=np.random.default_rng(seed),
    )
    rmse_deg, start_deg = (float(np.sqrt(square)) for square in (optimum.fun, mean_square(settings)))
    return PidTuning(with_gains(settings, optimum.x), rmse_deg, start_deg, int(optimum.nfev))


def tuned_study(study: AnyStudy, progress: Progress | None = None) -> AnyStudy:
    """Return the study with tuned gains of every `pid` and `inverse_pid`; the result contains no further search."""
    if study.config.tune_pid is None:
        return study
    chosen = {name: s for name, s in study.config.controllers.items() if isinstance(s, PidLike)}
    searches = zip(chosen.items(), parts(progress, [1.0] * len(chosen)), strict=True)
    tuned = {name: tuned_gains(study, settings, part).settings for (name, settings), part in searches}
    controllers = {**study.config.controllers, **tuned}
    resulting = {"controllers": controllers, "tune_pid": None, "tuned": tuple(tuned)}
    changes: dict[str, Any] = {"config": study.config.model_copy(update=resulting)}
    return replace(study, **changes)


def with_gains(settings: PidLike, x: Vec) -> PidLike:
    """Return the controller at a point of the search: log kp, log ki, kd, dead zone."""
    kp, ki = np.exp(x[:2])
    gains = {"kp_per_deg": kp, "ki_per_deg_s": ki, "kd_s_per_deg": x[2], "dead_zone_deg": x[3]}
    # Rounded to four digits, so that the reported values are those that ran.
    rounded = {name: float(f"{value:.4g}") for name, value in gains.items()}
    return settings.model_copy(update={"gains": settings.gains.model_copy(update=rounded)})


def _point(settings: PidLike) -> Vec:
    gains = settings.gains
    least = [low for low, _ in _KP_KI]
    kp_ki = np.log(np.maximum([gains.kp_per_deg, gains.ki_per_deg_s], least))
    return np.array([*kp_ki, gains.kd_s_per_deg, gains.dead_zone_deg])


def mean_square_of(study: AnyStudy, settings: AnyControllerSettings) -> float:
    """Compute the mean over motions of the mean square true error of a controller [deg^2]; of two axes the distance."""
    errors = [study.run(settings, motion).counted_deg for motion in study.motions]
    return float(np.mean([np.mean(e**2) * (e.shape[1] if e.ndim > 1 else 1) for e in errors]))
