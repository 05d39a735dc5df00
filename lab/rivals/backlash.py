"""Backlash of a hybrid network: fitted to the training trials, and in scaled units."""

from __future__ import annotations

from collections.abc import Sequence

from hystmpc.models.chain import Chain
from hystmpc.models.decades import Decades
from hystmpc.models.identify.chain_fit import ChainFit, OperatorFitSettings, fit_chain
from hystmpc.models.identify.chain_kinds import backlash_starts
from hystmpc.models.networks.nodes import Scaling
from hystmpc.models.operators.hysteresis import Backlash, InverseBacklash
from hystmpc.models.operators.operator import Operator
from hystmpc.trials.trial import Trial

DEAD_ZONES_DEG = (0.027, 0.1, 0.3, 1.0)  # of a catheter; the first is that of the code of S2 (RA-L 2024)


def fitted_backlash(trials: Sequence[Trial], skip_first_flexure: bool, dead_zone: float | None = None) -> Operator:
    """Backlash by least squares; from swapped trials an inverse backlash of its own, S2 eq. (3).

    Args:
        trials: all forward or all swapped.
        skip_first_flexure: count each trial from its first reversal on.
        dead_zone: of the inverse [deg]; None for the one of `DEAD_ZONES_DEG` with the least error.

    Raises:
        FitError: as `fit_chain` does.
        KeyboardInterrupt: if the user stops a fit.
    """
    settings = OperatorFitSettings(skip_first_flexure, evaluations=60, restarts=2)
    if not trials[0].inverted:
        return _fitted(backlash_starts(trials), trials, settings).chain.core
    turned = [trial.swapped() for trial in trials]
    forward = _fitted(backlash_starts(turned), turned, settings).chain.core
    assert isinstance(forward, Backlash)  # the starts are backlashes
    unit = Decades.of(trials).angle
    zones = [zone * unit for zone in DEAD_ZONES_DEG] if dead_zone is None else [dead_zone]
    # One fit a dead zone: the error jumps where a sample crosses it, so that no slope leads from one to the next.
    fits = [_fitted([Chain(forward.inverse(zone))], trials, settings) for zone in zones]
    return min(fits, key=lambda fit: fit.rmse_deg).chain.core


def _fitted(starts: Sequence[Chain], trials: Sequence[Trial], settings: OperatorFitSettings) -> ChainFit:
    """Fit that raises an interruption by the user, so that the surrounding training ends as well."""
    fit = fit_chain(starts, trials, settings)
    if fit.interrupted:
        raise KeyboardInterrupt
    return fit


def scaled_operator(operator: Operator, scaling: Scaling) -> Operator:
    """Same operator between scaled input and scaled output.

    A line theta = m (u + c) reads y = m' (v + c') with m' = m u_scale / theta_scale and
    c' = (u_offset + c) / u_scale - theta_offset / (m u_scale); the inverse's line u = theta / m - c with
    m' = m theta_scale / u_scale and c' = (c + theta_offset - u_offset / m) / theta_scale, where u and theta stand for
    what goes in and out. A dead zone is one of the input.
    """
    s = scaling
    if isinstance(operator, InverseBacklash):
        lines = [
            (m * s.theta_scale / s.u_scale, (c + s.theta_offset - s.u_offset / m) / s.theta_scale)
            for m, c in ((operator.m_lo, operator.c_lo), (operator.m_up, operator.c_up))
        ]
        (m_lo, c_lo), (m_up, c_up) = lines
        return InverseBacklash(m_lo, m_up, c_lo, c_up, operator.dead_zone / s.u_scale)
    assert isinstance(operator, Backlash)  # there are these two
    lines = [
        (m * s.u_scale / s.theta_scale, (s.u_offset + c) / s.u_scale - s.theta_offset / (m * s.u_scale))
        for m, c in ((operator.m_lo, operator.c_lo), (operator.m_up, operator.c_up))
    ]
    (m_lo, c_lo), (m_up, c_up) = lines
    return Backlash(m_lo, m_up, c_lo, c_up)
