"""Identification methods of the papers, and global searches, as trainings of `hystmpc fit`."""

from __future__ import annotations

from functools import partial

from hystmpc.models.identify.chain_fit import IdentificationMethod

from .adam import AdamSettings, fit_by_adam
from .global_search import GlobalSettings, adapt, evolve, fit_globally
from .iterated import IteratedSettings, fit_by_iteration

_SEARCHED = ("backlash", "pi", "bouc_wen", "maxwell_slip", "maxwell_slip_rate", "oscillator")

ADAM = IdentificationMethod(
    "adam",
    AdamSettings,
    fit_by_adam,
    dict.fromkeys(("backlash", "pi", "bouc_wen", "oscillator"), "paper"),
    "Adam on windows of 50 samples, as S2",
)
ITERATED = IdentificationMethod(
    "iterated",
    IteratedSettings,
    fit_by_iteration,
    {"backlash": "iterated"},
    "iterated regression of the two lines, as S2",
    ("backlash",),
)
GLOBAL = IdentificationMethod(
    "global",
    GlobalSettings,
    partial(fit_globally, "global", evolve),
    {**dict.fromkeys(_SEARCHED, "global"), "drdpi": "paper"},  # a search in place of S1's GA
    "differential evolution, in place of S1's GA",
)
CMAES = IdentificationMethod(
    "cmaes",
    GlobalSettings,
    partial(fit_globally, "cmaes", adapt),
    dict.fromkeys((*_SEARCHED, "drdpi"), "cmaes"),
    "covariance matrix adaptation (CMA-ES)",
)
