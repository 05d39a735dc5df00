"""The kinds of model that are operators: identification methods as presets, into a simulator and its bundle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, final

from hystmpc.trials.trial import Trial

from ..contract.metadata import DeviceLimits
from ..identify.chain_kinds import Structure
from ..identify.methods import METHODS, identify_chain, simulator_of
from ..model import FitProgress
from ..simulator import simulator_bundle
from .kind import FitRequest, Identified, ModelKind


class OperatorKind(ModelKind):
    """A kind that is an operator; its inverse form is identified from swapped trials.

    Attributes:
        methods: identification method (`METHODS`) by preset, the default first.
        plays: number of plays where the request leaves it open.
    """

    methods: ClassVar[Mapping[str, str]]
    readable: ClassVar[bool] = True
    plays: ClassVar[int] = 4

    def fit(self, trials: Sequence[Trial], request: FitRequest, progress: FitProgress | None = None) -> Identified:
        self.check(trials, request)
        inverted = bool(trials) and trials[0].inverted
        kind = f"inverse_{self.name}" if inverted else self.name
        method = METHODS[self.methods[request.preset]]
        settings = method.settings_for(request.steps, request.seed, request.skip_first_flexure)
        structure = Structure(plays=self.plays if request.plays is None else request.plays)
        chain, fit = identify_chain(kind, trials, method.name, settings, progress=progress, structure=structure)
        # The limits of the request are those of the device's command, which an inverse map gives and does not take.
        limits = DeviceLimits() if inverted else request.limits
        words = f"{method.name}, preset {request.preset}"
        simulator = simulator_of(chain, trials, limits, words, request.seed, request.skip_first_flexure)
        history = tuple((k + 1, loss**0.5) for k, loss in enumerate(fit.report.losses))
        report = f"{fit.report.line()}; {fit.rmse_deg:.4f} {trials[0].units.angle} free run"
        return Identified(simulator_bundle(simulator), simulator, history, report, fit.interrupted)

    def steps(self, request: FitRequest) -> int | None:
        del request
        return None


_PRESETS = {"best": "least_squares", "paper": "adam", "global": "global", "cmaes": "cmaes"}


@final
class BacklashKind(OperatorKind):
    """Backlash with two slopes, S2 eq. (1)-(3); see `Backlash` and `InverseBacklash`.

    Presets are methods: bounded least squares (`best`), Adam on windows as S2 has it (`paper`), Voros' iterated
    regression (`iterated`), differential evolution (`global`) and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "backlash"
    title: ClassVar[str] = "backlash"
    methods: ClassVar[Mapping[str, str]] = {
        "best": "least_squares", "paper": "adam", "iterated": "iterated", "global": "global", "cmaes": "cmaes",
    }  # fmt: skip
    presets: ClassVar[tuple[str, ...]] = tuple(methods)


@final
class PrandtlIshlinskiiKind(OperatorKind):
    """Rate-dependent plays, S2 eq. (4)-(5); see `PrandtlIshlinskii`; from swapped trials S2's fitted inverse.

    Presets are methods: bounded least squares (`best`), Adam on windows as S2 has it (`paper`), differential evolution
    (`global`) and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "pi"
    title: ClassVar[str] = "PI"
    methods: ClassVar[Mapping[str, str]] = _PRESETS
    presets: ClassVar[tuple[str, ...]] = tuple(methods)


@final
class BoucWenKind(OperatorKind):
    """Bouc-Wen hysteresis with the six parameters of S2's code; see `BoucWen`. It has no inverse map.

    Presets are those of `PrandtlIshlinskiiKind`.
    """

    name: ClassVar[str] = "bouc_wen"
    title: ClassVar[str] = "Bouc-Wen"
    methods: ClassVar[Mapping[str, str]] = _PRESETS
    presets: ClassVar[tuple[str, ...]] = tuple(methods)
    invertible: ClassVar[bool] = False


@final
class DrdpiKind(OperatorKind):
    """Dead zones after rate-dependent plays, S1 section II-B as reconstructed in `Drdpi`; inverse from swapped trials.

    Presets are methods: bounded least squares (`best`), a global search of 1,000 iterations in place of S1's genetic
    algorithm (`paper`), and CMA-ES (`cmaes`).
    """

    name: ClassVar[str] = "drdpi"
    title: ClassVar[str] = "DRDPI"
    methods: ClassVar[Mapping[str, str]] = {"best": "least_squares", "paper": "global", "cmaes": "cmaes"}
    presets: ClassVar[tuple[str, ...]] = tuple(methods)
    plays: ClassVar[int] = 10  # as S1 has them


OPERATOR_KINDS: tuple[OperatorKind, ...] = (BacklashKind(), PrandtlIshlinskiiKind(), DrdpiKind(), BoucWenKind())
