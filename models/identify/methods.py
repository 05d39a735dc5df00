"""The identification methods of chains behind one call: least squares, Adam, iterated regression, global search."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from hystmpc.trials.errors import FitError, did_you_mean
from hystmpc.trials.trial import Trial

from ..chain import Chain
from ..model import FitProgress
from .adam import AdamSettings, fit_by_adam
from .chain_fit import ChainFit, ChainTask
from .chain_kinds import Structure, chain_task
from .global_search import GlobalSettings, evolve, fit_globally
from .iterated import IteratedSettings, fit_by_iteration
from .least_squares import OperatorFitSettings, fit_by_least_squares

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
    named = {candidate.name: candidate for candidate in METHODS}
    if method not in named:
        raise FitError(f"no identification method {method!r}, {did_you_mean(method, named)}")
    chosen = named[method]
    settings = settings or chosen.settings()
    if not isinstance(settings, chosen.settings):
        raise FitError(f"{method}: got {type(settings).__name__}, expected {chosen.settings.__name__}")
    task = chain_task(kind, trials, structure or Structure(plays=plays))
    if chosen.kinds is not None and kind not in chosen.kinds:
        raise FitError(f"{method} cannot identify {kind!r}, {did_you_mean(kind, chosen.kinds)}")
    found = chosen.fit(task, settings, progress)
    return found.chain, found


def _by_evolution(task: ChainTask, settings: GlobalSettings, progress: FitProgress | None) -> ChainFit:
    return fit_globally("global", evolve, task, settings, progress)


def _by_cmaes(task: ChainTask, settings: GlobalSettings, progress: FitProgress | None) -> ChainFit:
    try:
        from .cma_ import adapt
    except ImportError as error:
        raise FitError(f"cmaes needs {error.name}, expected it installed: pip install hystmpc[train]") from None
    return fit_globally("cmaes", adapt, task, settings, progress)


METHODS: tuple[IdentificationMethod, ...] = (
    IdentificationMethod(
        "least_squares", OperatorFitSettings, fit_by_least_squares, None,
        "bounded least squares on free runs with exact sensitivities, from several starts",
    ),
    IdentificationMethod("adam", AdamSettings, fit_by_adam, None, "Adam on windows of 50 samples, as S2"),
    IdentificationMethod(
        "iterated", IteratedSettings, fit_by_iteration, ("backlash",), "iterated regression of the two lines, as S2"
    ),
    IdentificationMethod("global", GlobalSettings, _by_evolution, None, "differential evolution, in place of S1's GA"),
    IdentificationMethod("cmaes", GlobalSettings, _by_cmaes, None, "covariance matrix adaptation (CMA-ES)"),
)  # fmt: skip
