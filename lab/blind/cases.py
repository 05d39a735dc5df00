"""Cases of the blind check: devices with effects of a wanted size, negative controls, effects injected into logs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import DeviceLimits, Range
from hystmpc.models.effects.effect import Scale
from hystmpc.models.identify.chain_fit import OperatorFitSettings, fit_chain
from hystmpc.models.identify.chain_kinds import backlash_starts, prandtl_ishlinskii_starts
from hystmpc.models.identify.parts import core_forms
from hystmpc.models.identify.runs import runs_of
from hystmpc.models.identify.simulators import identify, simulator_of
from hystmpc.models.simulator import Simulator
from hystmpc.tasks.fit import fit
from hystmpc.trials.errors import ConfigError, FitError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..devices.cores import RATE_HZ, Core, JointsCore, Mounting, MuscleCore
from ..library import laboratory
from .device import BlindDevice
from .generators import CONFIGURATION, Withheld, generators_of
from .plan import Plan, draw_plan
from .retuning import GapRuler, retune, rms
from .sealed import Answer, Case, EffectAnswer, Suite, densities

_STROKES_PER_S = 20 / 3
_TRIES = 5
_PLAYS = 3
_TOLERANCE = 0.055
_SIZE_TRIES = 9
_STEP = 6.0  # greatest change of size at once
_AIM = 1.06  # a search that ends within its tolerance then ends above the wanted ratio
CONTROLS = ("shuffled_residual", "simulator_and_noise", "mis_set")


@dataclass(frozen=True, eq=False)
class Bench:
    """Device, simulator and recording plan from which a case is made; `nominal` is what the simulator was made from."""

    core: Core
    nominal: BlindDevice
    mounting: Mounting
    device: BlindDevice
    simulator: Simulator
    baseline: str
    plan: Plan
    ruler: GapRuler
    random: np.random.Generator

    @property
    def floor_deg(self) -> float:
        """Noise and model-form error combined [deg]."""
        return float(np.hypot(self.device.noise_deg, self.ruler.base.rmse_deg))

    def angles(self, effects: Sequence[Withheld]) -> list[Vec]:
        """Angles (T,) without common noise, by trial [deg]."""
        return self.device.with_effects(effects).true_angles(self.plan.commands)

    def facts(self) -> dict[str, object]:
        """Fields of an answer that are known before the choice of an effect."""
        return {
            "plan": self.plan.name,
            "motions": self.plan.types,
            "floor_deg": self.floor_deg,
            "noise_deg": self.device.noise_deg,
            "form_deg": self.ruler.base.rmse_deg,
            "resolution_deg": self.device.resolution_deg,
            "device": self.core.numbers(),
            "unaffected": self.nominal.core.numbers(),
            "mounting": asdict(self.mounting),
            "seed": self.device.seed,
            "baseline": self.baseline,
        }


def set_up(
    seed: Sequence[int],
    kind: type[Core],
    spread: float = 1.0,
    plan: str | None = None,
    moved: Callable[[Core], Core] | None = None,
) -> Bench:
    """Draw a device, identify its simulator, and draw its parameter deviations and the recording plan.

    Args:
        spread: of the mounting; 0 keeps the device as it was identified.
        plan: of the recording; drawn where left out.
        moved: what became of the device since it was identified; its friction is then mounted as it is.

    Raises:
        FitError: if no drawn device can be identified.
    """
    for attempt in range(_TRIES):
        random = np.random.default_rng([*seed, attempt])
        try:
            return _bench(random, kind, spread, plan, moved)
        except FitError:
            continue
    raise FitError(f"blind case {list(seed)}: no simulator could be identified on {_TRIES} drawn devices")


def _bench(
    random: np.random.Generator,
    kind: type[Core],
    spread: float,
    plan: str | None,
    moved: Callable[[Core], Core] | None,
) -> Bench:
    core = kind.draw(random)
    core = core.with_stribeck(random) if isinstance(core, JointsCore) else core
    drawn = str(random.choice(["backlash", "pi", "auto"]))
    # The angle of a muscle saturates: either would miss it by a tenth of the range.
    baseline = "curved" if isinstance(core, MuscleCore) and drawn != "auto" else drawn
    noise, resolution = float(random.choice([0.03, 0.06, 0.12])), 0.01
    nominal = BlindDevice(core, noise, resolution, int(random.integers(2**31)))
    recorded = nominal.record(draw_plan(random, "short", core.travel).commands)
    named = [replace(trial, source=f"fit_{k + 1:02d}.csv") for k, trial in enumerate(recorded)]
    simulator = _identified(baseline, named, core.travel)
    core = moved(core) if moved else core
    mounting = Mounting(
        gain=float(1 + spread * random.uniform(-0.12, 0.12)),
        friction=float(1 + (0 if moved else spread) * random.uniform(-0.25, 0.25)),
        offset_deg=float(spread * random.uniform(-2, 2)),
    )
    device = replace(nominal, core=core.mounted(mounting), seed=int(random.integers(2**31)))
    recording = draw_plan(random, plan, core.travel)
    ruler = GapRuler.of(simulator, recording.commands, device.true_angles(recording.commands))
    return Bench(core, nominal, mounting, device, simulator, baseline, recording, ruler, random)


def _identified(baseline: str, trials: Sequence[Trial], travel: float) -> Simulator:
    """Identify the simulator as `hystmpc fit`, but from one start instead of several, except for `auto`."""
    if baseline == "auto":
        return fit("auto", trials, rate_hz=RATE_HZ).simulator
    start = _start(baseline, trials)
    chain = fit_chain([start], trials, OperatorFitSettings(restarts=0, evaluations=30, tolerance=1e-5)).chain
    limits = DeviceLimits(Range(lower=0.0, upper=travel), _STROKES_PER_S * travel)
    return simulator_of(chain, trials, limits, "least_squares, preset best", seed=1)


def _start(baseline: str, trials: Sequence[Trial]) -> Chain:
    if baseline == "backlash":
        return backlash_starts(trials)[0]
    if baseline == "pi":
        return prandtl_ishlinskii_starts(trials, _PLAYS)[1]
    forms = core_forms(trials, Scale.of(runs_of(trials)))
    return next(form.starts[0] for form in forms if form.label.startswith("curved_plays"))


def sized(effect: Withheld, wanted_deg: float, gap: Callable[[Withheld], float]) -> tuple[Withheld, float]:
    """Search the size at which `gap` is `wanted_deg`, by secants in the logarithms of size and gap.

    Args:
        wanted_deg: gap to reach [deg].
        gap: of an effect [deg]; about rising with the size.

    Returns:
        The best effect found, at most of its greatest size, and its gap [deg].
    """
    size, power = min(effect.size, effect.generator.greatest), 1.0
    best: tuple[float, Withheld, float] | None = None
    before: tuple[float, float] | None = None
    for _ in range(_SIZE_TRIES):
        found = max(gap(effect.resized(size)), 1e-9)
        miss = abs(found / wanted_deg - 1)
        if best is None or miss < best[0]:
            best = miss, effect.resized(size), found
        if miss < _TOLERANCE or (found < wanted_deg and size >= effect.generator.greatest):
            break
        power = _power(before, (size, found), power)
        before = size, found
        step = min(max((wanted_deg / found) ** (1 / power), 1 / _STEP), _STEP)
        size = min(size * step, effect.generator.greatest)
    assert best is not None  # the loop runs at least once
    return best[1], best[2]


def _power(before: tuple[float, float] | None, now: tuple[float, float], power: float) -> float:
    """Exponent of the gap over the size between two tries, limited to that of smooth effects."""
    if before is None or abs(math.log(now[0] / before[0])) < 1e-3:
        return power
    return min(max(math.log(now[1] / before[1]) / math.log(now[0] / before[0]), 0.4), 4.0)


@dataclass(frozen=True)
class Wish:
    """Requested effect of a case.

    Attributes:
        label: of the effect; one of its generators is drawn.
        ratio: gap after retuning, in floors.
        pick: which of the label's generators, counted round; drawn where left out.
        shape: numbers of the generator; drawn where left out.
    """

    label: str
    ratio: float
    main: bool = True
    pick: int | None = None
    shape: Mapping[str, float] | None = None


def affected_case(
    bench: Bench, suite: Suite, wishes: Sequence[Wish], without: tuple[str, ...] = (), variant: str = ""
) -> Case:
    """Case with these effects; without any, the device only deviates from its nominal parameters."""
    made = [_effect(bench, wish) for wish in wishes]
    for _ in range(_SIZE_TRIES):
        if all(np.ptp(angle) > 0 for angle in bench.angles([effect for effect, _ in made])):
            break
        made = [_finer(bench, *one) for one in made]
    effects, answers = [effect for effect, _ in made], [answer for _, answer in made]
    trials = bench.device.with_effects(effects).record(bench.plan.commands)
    gap = _gap(bench, effects) if effects else {}
    answer = Answer.model_validate(
        {
            **bench.facts(),
            "suite": suite,
            "variant": variant,
            "effects": answers,
            "without": without,
            "second": _second(effects, len(trials)),
            "separable": all(bench.plan.separates(wish.label) for wish in wishes),
            **gap,
        }
    )
    return Case(tuple(trials), bench.simulator, answer)


def _second(effects: Sequence[Withheld], trials: int) -> tuple[int, ...]:
    """Numbers of the trials, from 1, in the second configuration."""
    bits = [int(e.shape["second"]) for e in effects if e.generator.label == CONFIGURATION]
    return tuple(k + 1 for k in range(trials) if bits and bits[0] >> k & 1)


def _finer(bench: Bench, effect: Withheld, answer: EffectAnswer) -> tuple[Withheld, EffectAnswer]:
    """Half the step of a coarse sensor, which showed nothing of a whole trial; another effect as it is."""
    if answer.label != "sensor":
        return effect, answer
    finer = effect.resized(0.5 * effect.size)
    gap = bench.ruler.gap(bench.angles([finer]))
    return finer, answer.model_copy(update={"size": finer.size, "ratio": gap / bench.floor_deg, "gap_deg": gap})


def _effect(bench: Bench, wish: Wish) -> tuple[Withheld, EffectAnswer]:
    choices = generators_of(wish.label)
    drawn = int(bench.random.integers(len(choices)))
    generator = choices[(drawn if wish.pick is None else wish.pick) % len(choices)]
    shape = generator.draw(bench.random) if wish.shape is None else dict(wish.shape)
    start = Withheld(generator, generator.typical, shape)
    effect, gap = sized(start, _AIM * wish.ratio * bench.floor_deg, lambda e: bench.ruler.gap(bench.angles([e])))
    answer = EffectAnswer(
        label=wish.label,
        generator=generator.name,
        size=effect.size,
        shape=dict(effect.shape),
        ratio=gap / bench.floor_deg,
        gap_deg=gap,
        main=wish.main,
    )
    return effect, answer


def _gap(bench: Bench, effects: Sequence[Withheld]) -> dict[str, Any]:
    """Error after a refit of the baseline, without noise; share of the effects in it; its density by region."""
    angles = bench.angles(effects)
    tuned = retune(bench.simulator, bench.plan.commands, angles)
    form, whole = bench.ruler.base.rmse_deg**2, tuned.rmse_deg**2
    trials = bench.device.with_effects(effects).record(bench.plan.commands)
    errors = [run - angle for run, angle in zip(tuned.angles, angles, strict=True)]
    return {
        "retuned_deg": tuned.rmse_deg,
        "true_closed": float(np.clip(1 - form / max(whole, 1e-12), 0, 1)),
        "retuned_by_trial": tuple(rms([error]) for error in errors),
        "form_by_trial": tuple(
            rms([run - plain]) for run, plain in zip(bench.ruler.base.angles, bench.ruler.plain, strict=True)
        ),
        "where": densities(trials, errors),
    }


def control_case(bench: Bench, variant: str) -> Case:
    """Case of one of the `CONTROLS`.

    Shuffled residual: the residual of the retuned simulator on the real logs, in random order, added to that
    simulator: its size is kept and its structure destroyed. Simulator and noise: the retuned simulator itself. Mis-set:
    the device with deviating parameters, and nothing else.
    """
    trials = bench.device.record(bench.plan.commands)
    if variant != "mis_set":
        tuned = retune(bench.simulator, bench.plan.commands, [trial.angle for trial in trials])
        noise = _noise(bench, variant, [t.angle - run for t, run in zip(trials, tuned.angles, strict=True)])
        step = bench.device.resolution_deg
        trials = [
            replace(trial, angle=np.round((run + part) / step) * step)
            for trial, run, part in zip(trials, tuned.angles, noise, strict=True)
        ]
    answer = Answer.model_validate({**bench.facts(), "suite": "controls", "variant": variant})
    return Case(tuple(trials), bench.simulator, answer)


def _noise(bench: Bench, variant: str, residuals: list[Vec]) -> list[Vec]:
    whole = np.concatenate(residuals)
    if variant == "shuffled_residual":
        mixed = bench.random.permutation(whole)
    else:
        mixed = bench.device.noise_deg * bench.random.standard_normal(whole.size)
    return np.split(mixed, np.cumsum([part.size for part in residuals])[:-1])


_FINE = 20
_RATIOS = (3.0, 2.2, 1.5)


@dataclass(frozen=True)
class Injection:
    """Change of measured angles by one effect.

    Attributes:
        typical, greatest: size to begin with, and the largest that a log in use could have.
        change: angle (T,) [deg], its times [s] and the session's clock [s], size and draws to the changed angle.
    """

    name: str
    label: str
    typical: float
    greatest: float
    change: Callable[[Vec, Vec, float, float, np.random.Generator], Vec]


def _delayed(angle: Vec, t: Vec, clock: float, size: float, random: np.random.Generator) -> Vec:
    del clock, random
    return np.interp(t - size, t, angle)


def _low_pass(angle: Vec, t: Vec, clock: float, size: float, random: np.random.Generator) -> Vec:
    """Critically damped second order whose lag on a ramp is `size` [s]."""
    del clock, random
    fine = np.interp(np.linspace(t[0], t[-1], (t.size - 1) * _FINE + 1), t, angle)
    out = np.empty(fine.size)
    laboratory().second_order(fine, fine.size, (t[1] - t[0]) / _FINE, 2 / size, 1.0, out)
    return out[::_FINE]


def _quantised(angle: Vec, t: Vec, clock: float, size: float, random: np.random.Generator) -> Vec:
    del t, clock, random
    return np.round(angle / size) * size


def _drifting(angle: Vec, t: Vec, clock: float, size: float, random: np.random.Generator) -> Vec:
    """Drift of `size` [deg/min] over the session, with a random walk."""
    walk = np.cumsum(random.standard_normal(t.size)) * np.sqrt((t[1] - t[0]) / 60)
    return angle + size * ((clock + t) / 60 + 0.15 * walk)


INJECTIONS = (
    Injection("delayed", "delay", 0.1, 0.4, _delayed),
    Injection("low_pass", "lag", 0.1, 0.8, _low_pass),
    Injection("quantised", "sensor", 2.0, 10.0, _quantised),
    Injection("drifting", "drift", 1.0, 15.0, _drifting),
)


def injection_case(logs: Sequence[Trial], number: int, random: np.random.Generator) -> Case:
    """Logs with one effect added to their angles, and a backlash identified on the unchanged logs.

    The gap of these logs without the injection is that of the real device, the unit of the ratio. If the greatest
    size is reached first, the ratio is smaller than requested.

    Raises:
        ConfigError: if there are fewer than two logs.
    """
    if len(logs) < 2:
        raise ConfigError(f"injection: got {len(logs)} logs, expected at least 2 of one device")
    injection, ratio = INJECTIONS[number % len(INJECTIONS)], _RATIOS[number // len(INJECTIONS) % len(_RATIOS)]
    named = [replace(trial, channels={}, source=f"fit_{k + 1:02d}.csv") for k, trial in enumerate(logs)]
    simulator, fit = identify("backlash", named, OperatorFitSettings(restarts=0))
    seed = int(random.integers(2**31))
    size = injection.typical
    for _ in range(5):  # the gap of delay, lag and drift is about in proportion to the size
        changed = _changed(logs, injection, size, seed)
        gap = _injected_gap(simulator, logs, changed)
        factor = float(np.clip(ratio * fit.rmse_deg / max(gap, 1e-9), 0.25, 4.0))
        size = min(size * factor, injection.greatest)
    changed = _changed(logs, injection, size, seed)
    gap = _injected_gap(simulator, logs, changed)
    effect = EffectAnswer(
        label=injection.label, generator=injection.name, size=size, ratio=gap / fit.rmse_deg, gap_deg=gap
    )
    answer = Answer(
        suite="injection",
        variant=Path(logs[0].source).parent.name,
        effects=(effect,),
        separable=False,  # these motions were not planned for separation
        plan="recorded",
        motions=tuple("recorded" for _ in logs),
        floor_deg=fit.rmse_deg,
        form_deg=fit.rmse_deg,
        baseline="backlash",
        seed=seed,
    )
    return Case(tuple(changed), simulator, answer)


def _changed(logs: Sequence[Trial], injection: Injection, size: float, seed: int) -> list[Trial]:
    random, clock, trials = np.random.default_rng(seed), 0.0, []
    for k, trial in enumerate(logs):
        angle = injection.change(trial.angle, trial.t - trial.t[0], clock, size, random)
        trials.append(Trial(trial.t - trial.t[0], trial.command, angle, {}, trial.units, f"trial_{k + 1:02d}.csv"))
        clock += trial.duration_s
    return trials


def _injected_gap(simulator: Simulator, logs: Sequence[Trial], changed: Sequence[Trial]) -> float:
    """RMSE of the change after a refit, with the change added to the simulator's free runs [deg]."""
    commands = [trial.command for trial in logs]
    base = retune(simulator, commands, [trial.angle for trial in logs])
    target = [run + (b.angle - a.angle) for run, a, b in zip(base.angles, logs, changed, strict=True)]
    return retune(base.simulator, commands, target).rmse_deg
