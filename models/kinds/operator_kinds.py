"""The kinds of model that are operators: identification methods as presets, into a simulator and its bundle."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import ClassVar, final

from hystmpc.trials.trial import Trial

from ..export_simulator import simulator_bundle
from ..identify.adam import AdamSettings
from ..identify.chain_kinds import Structure
from ..identify.global_search import GlobalSettings
from ..identify.iterated import IteratedSettings
from ..identify.least_squares import OperatorFitSettings
from ..identify.methods import MethodSettings, identify_chain
from ..identify.simulator import DeviceLimits, simulator_of
from ..model import FitProgress
from .kind import FitRequest, Identified, ModelKind

Method = tuple[str, Callable[[FitRequest], MethodSettings]]

METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "least_squares": (
            "least_squares",
            lambda r: OperatorFitSettings(r.skip_first_flexure, evaluations=r.steps or 200, seed=r.seed),
        ),
        "adam": (
            "adam",
            lambda r: AdamSettings(r.steps or 300, skip_first_flexure=r.skip_first_flexure, seed=r.seed),
        ),
        "iterated": ("iterated", lambda r: IteratedSettings(r.steps or 20, skip_first_flexure=r.skip_first_flexure)),
        "global": (
            "global",
            lambda r: GlobalSettings(r.steps or 1000, skip_first_flexure=r.skip_first_flexure, seed=r.seed),
        ),
        "cmaes": (
            "cmaes",
            lambda r: GlobalSettings(r.steps or 1000, skip_first_flexure=r.skip_first_flexure, seed=r.seed),
        ),
    }
)
"""Identification methods by name, with their settings for a request."""


def identify_operator(
    kind: str,
    trials: Sequence[Trial],
    request: FitRequest,
    presets: Mapping[str, str],
    progress: FitProgress | None = None,
    structure: Structure | None = None,
) -> Identified:
    """Identify an operator by the method that the request's preset stands for.

    Args:
        kind: of chain, see `identify_chain`; its inverse form is taken for swapped trials.
        trials: uniformly sampled at one rate, in one pair of units.
        request: what is asked for.
        presets: methods by preset.
        progress: gets the iterations so far and the best error.
        structure: sizes of the chain; the request's plays, or the default's, where left out.

    Raises:
        FitError: as `identify_chain` and `simulator_of` do.
    """
    inverted = bool(trials) and trials[0].inverted
    method, settings = METHODS[presets[request.preset]]
    sizes = structure or (Structure() if request.plays is None else Structure(plays=request.plays))
    name = f"inverse_{kind}" if inverted else kind
    chain, fit = identify_chain(name, trials, method, settings(request), progress=progress, structure=sizes)
    # The limits of the request are those of the device's command, which an inverse map gives and does not take.
    limits = DeviceLimits() if inverted else request.limits
    words = f"{method}, preset {request.preset}"
    simulator = simulator_of(chain, trials, limits, words, request.seed, request.skip_first_flexure)
    history = tuple((k + 1, loss**0.5) for k, loss in enumerate(fit.report.losses))
    report = f"{fit.report.line()}; {fit.rmse_deg:.4f} {trials[0].units.angle} free run"
    return Identified(simulator_bundle(simulator), simulator, history, report, fit.interrupted)


class OperatorKind(ModelKind):
    """A kind that is an operator; its presets are identification methods.

    Attributes:
        methods: method by preset, the default first; see `METHODS`.
        plays: number of plays where the request leaves it open.
    """

    methods: ClassVar[Mapping[str, str]]
    readable: ClassVar[bool] = True
    plays: ClassVar[int] = 4

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None) -> Identified:
        self.check(trials, request)
        plays = self.plays if request.plays is None else request.plays
        return identify_operator(self.name, trials, replace(request, plays=plays), self.methods, progress)

    def steps(self, request: FitRequest) -> int | None:
        del request
        return None


_BACKLASH: Mapping[str, str] = MappingProxyType(
    {"best": "least_squares", "paper": "adam", "iterated": "iterated", "global": "global", "cmaes": "cmaes"}
)


@final
class BacklashKind(OperatorKind):
    """Backlash with two slopes, S2 eq. (1)-(3); see `Backlash` and `InverseBacklash`.

    Presets are methods: bounded least squares (`best`), Adam on windows as S2 has it (`paper`), Voros' iterated
    regression (`iterated`), differential evolution (`global`) and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "backlash"
    title: ClassVar[str] = "backlash"
    presets: ClassVar[tuple[str, ...]] = tuple(_BACKLASH)
    methods: ClassVar[Mapping[str, str]] = _BACKLASH


_PI: Mapping[str, str] = MappingProxyType(
    {"best": "least_squares", "paper": "adam", "global": "global", "cmaes": "cmaes"}
)


@final
class PrandtlIshlinskiiKind(OperatorKind):
    """Rate-dependent plays, S2 eq. (4)-(5); see `PrandtlIshlinskii`; from swapped trials S2's fitted inverse.

    Presets are methods: bounded least squares (`best`), Adam on windows as S2 has it (`paper`), differential evolution
    (`global`) and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "pi"
    title: ClassVar[str] = "PI"
    presets: ClassVar[tuple[str, ...]] = tuple(_PI)
    methods: ClassVar[Mapping[str, str]] = _PI


_BOUC_WEN: Mapping[str, str] = MappingProxyType(
    {"best": "least_squares", "paper": "adam", "global": "global", "cmaes": "cmaes"}
)


@final
class BoucWenKind(OperatorKind):
    """Bouc-Wen hysteresis with the six parameters of S2's code; see `BoucWen`. It has no inverse map.

    Presets are methods: bounded least squares (`best`), Adam on windows (`paper`), differential evolution (`global`)
    and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "bouc_wen"
    title: ClassVar[str] = "Bouc-Wen"
    presets: ClassVar[tuple[str, ...]] = tuple(_BOUC_WEN)
    methods: ClassVar[Mapping[str, str]] = _BOUC_WEN
    invertible: ClassVar[bool] = False


_DRDPI: Mapping[str, str] = MappingProxyType({"best": "least_squares", "paper": "global", "cmaes": "cmaes"})


@final
class DrdpiKind(OperatorKind):
    """Dead zones after rate-dependent plays, S1 section II-B as reconstructed in `Drdpi`; inverse from swapped trials.

    Presets are methods: bounded least squares (`best`), a global search of 1,000 iterations in place of S1's genetic
    algorithm (`paper`), and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "drdpi"
    title: ClassVar[str] = "DRDPI"
    presets: ClassVar[tuple[str, ...]] = tuple(_DRDPI)
    methods: ClassVar[Mapping[str, str]] = _DRDPI
    plays: ClassVar[int] = 10  # as S1 has them
