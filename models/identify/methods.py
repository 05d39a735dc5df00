"""The identification methods of chains behind one call: least squares, Adam, iterated regression, global search."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from types import MappingProxyType
from typing import Any

from hystmpc.trials.errors import FitError, did_you_mean
from hystmpc.trials.trial import Trial

from ..chain import Chain
from ..model import FitProgress
from ..simulator import Simulator
from .adam import AdamSettings, fit_by_adam
from .chain_fit import ChainFit, ChainTask
from .chain_kinds import Structure, backlash_starts, chain_task, prandtl_ishlinskii_starts
from .global_search import GlobalSettings, adapt, evolve, fit_globally
from .iterated import IteratedSettings, fit_by_iteration
from .least_squares import OperatorFitSettings, fit_by_least_squares, fit_chain
from .simulator import simulator_of
from .trial_set import DeviceLimits, check_trial_set

MethodSettings = OperatorFitSettings | AdamSettings | IteratedSettings | GlobalSettings
Fit = Callable[[ChainTask, Any, FitProgress | None], ChainFit]


@dataclass(frozen=True)
class IdentificationMethod:
    """One way to identify a chain.

    Attributes:
        name: as it is asked for.
        settings: class of its settings, whose defaults are the papers' where they say so.
        fit: from task, settings and progress to the result.
        kinds: kinds of chain that it can identify; None for all.
        summary: one line for help texts.
    """

    name: str
    settings: type[MethodSettings]
    fit: Fit
    kinds: tuple[str, ...] | None
    summary: str

    def settings_for(self, steps: int | None, seed: int, skip_first_flexure: bool) -> MethodSettings:
        """Its settings with a greatest number of steps (free runs, epochs, iterations), None for the default."""
        known = {f.name for f in fields(self.settings)}
        count = next(name for name in ("evaluations", "epochs", "iterations") if name in known)
        chosen = {"seed": seed, "skip_first_flexure": skip_first_flexure} | ({count: steps} if steps else {})
        return self.settings(**{name: value for name, value in chosen.items() if name in known})  # type: ignore[arg-type]


def identify_chain(
    kind: str,
    trials: Sequence[Trial],
    method: str = "least_squares",
    settings: MethodSettings | None = None,
    plays: int = 4,
    progress: FitProgress | None = None,
    structure: Structure | None = None,
) -> tuple[Chain, ChainFit]:
    """Identify a chain by one of `METHODS`.

    Args:
        kind: `backlash`, `pi`, `drdpi` or `bouc_wen`; for trials whose command and angle have changed places
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
    task = chain_task(kind, trials, structure or Structure(plays=plays))
    if chosen.kinds is not None and kind not in chosen.kinds:
        raise FitError(f"{method} cannot identify {kind!r}, {did_you_mean(kind, chosen.kinds)}")
    found = chosen.fit(task, settings, progress)
    return found.chain, found


OPERATOR_KINDS = ("backlash", "pi")


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


METHODS: Mapping[str, IdentificationMethod] = MappingProxyType({
    method.name: method
    for method in (
        IdentificationMethod(
            "least_squares", OperatorFitSettings, fit_by_least_squares, None,
            "bounded least squares on free runs with exact sensitivities, from several starts",
        ),
        IdentificationMethod("adam", AdamSettings, fit_by_adam, None, "Adam on windows of 50 samples, as S2"),
        IdentificationMethod(
            "iterated", IteratedSettings, fit_by_iteration, ("backlash",), "iterated regression of the two lines, as S2"
        ),
        IdentificationMethod(
            "global", GlobalSettings, partial(fit_globally, "global", evolve), None,
            "differential evolution, in place of S1's GA",
        ),
        IdentificationMethod(
            "cmaes", GlobalSettings, partial(fit_globally, "cmaes", adapt), None,
            "covariance matrix adaptation (CMA-ES)",
        ),
    )
})  # fmt: skip
"""Identification methods by name."""
