"""Planning of the rounds of an investigation: motions within limits and device time."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hystmpc.ctrl.command import CommandLimits
from hystmpc.gap.logs.preparation import nominal_noise_deg
from hystmpc.gap.logs.trial_choice import MOST_HZ
from hystmpc.gap.next.motion_design import (
    EvaluatedMotion,
    MotionProposal,
    Noise,
    OpenHypothesis,
    SearchSettings,
    evaluate_motion,
    expected_probability,
    information_bits,
    search_motion,
    write_motion,
)
from hystmpc.gap.next.motions import MotionFamily, menu
from hystmpc.gap.next.open_hypotheses import NOTHING, DiscriminationTask, free_run
from hystmpc.models.contract.metadata import Range
from hystmpc.models.effects.catalogue import candidates
from hystmpc.models.effects.effect import Candidate, Scale
from hystmpc.models.identify.baseline import Baseline, baseline_of
from hystmpc.models.identify.problem import Problem
from hystmpc.models.simulator import Simulator
from hystmpc.rig.config import BenchSettings
from hystmpc.rig.safety.plausibility import MotionWatch
from hystmpc.trials.csv_files import read_csv
from hystmpc.trials.errors import ConfigError, FitError
from hystmpc.trials.types import Vec

from .config import InvestigateSettings
from .motions import prepare_seconds, run_seconds
from .stages import Figure

LEAST_MOTION_S = 8.0
"""Duration of the shortest motion that is planned [s]."""

LEAST_BITS = 0.1
"""Least expected information of a designed motion [bit]."""

_CAREFUL = 0.7  # share of the travel without motion that stops a run
_FURTHER = 2.0  # length of an unrecorded kind of motion, in longest first motions
_FIRST_SHARE = 0.6  # of the device time that the first motions may take


@dataclass(frozen=True)
class RoundPlan:
    """Plan of a round: its motions and their expected information."""

    motions: tuple[str, ...]  # names of their files, in the order of recording
    seconds: float  # greatest device time, approach and return included [s]
    separates: tuple[str, ...]  # hypotheses to discriminate
    probability: Figure  # expected for the right hypothesis
    bits: Figure  # the same as information
    confirms: bool = False  # whether the trials decide already, and the motion only tests their answer
    undirected: bool = False  # of a new kind, chosen as the first ones were, for want of a designed motion
    menu: str = ""  # best motion of the menu
    menu_gain: Figure = np.nan  # information per second of this motion relative to that one
    looked_at: int = 0  # number of motions compared


@dataclass(frozen=True)
class PlanePlan:
    """Plan of a round of two axes: the motions of each axis that is open, and those of both.

    Attributes:
        x, y: plans of the axes; None where nothing of an axis is open.
        both: names of the motions of both axes.
        motions: names of all recordings, in their order.
        seconds: greatest device time, approach and return included [s].
    """

    x: RoundPlan | None
    y: RoundPlan | None
    both: tuple[str, ...]
    motions: tuple[str, ...]
    seconds: float


def least_seconds(bench: BenchSettings) -> float:
    """Device time of the shortest round [s]."""
    return prepare_seconds(bench) + run_seconds(bench, math.ceil(LEAST_MOTION_S / bench.dt_s))


def first_count(settings: InvestigateSettings) -> int:
    """Number of first motions: those of one axis; of two axes those of each, and one of both."""
    count = settings.investigate.first_motions
    return count if len(settings.axes_limits) == 1 else 2 * count + 1


def first_longest_s(settings: InvestigateSettings, left_s: float) -> float:
    """Greatest duration of each first motion within the remaining device time [s].

    Raises:
        ConfigError: if the device time is too short for them.
    """
    count = first_count(settings)
    longest = (_FIRST_SHARE * left_s - prepare_seconds(settings)) / count - run_seconds(settings, 0)
    longest = min(longest, settings.investigate.longest_motion_s)
    if longest < LEAST_MOTION_S:
        raise ConfigError(
            f"investigate: got {left_s:.0f} s of device time for {count} first motions and what follows, expected "
            f"motions of {LEAST_MOTION_S:g} s or more; more minutes, or fewer first_motions"
        )
    return longest


def first_seconds(settings: InvestigateSettings, left_s: float) -> float:
    """Greatest device time of the first motions [s]."""
    count, longest = first_count(settings), first_longest_s(settings, left_s)
    return prepare_seconds(settings) + count * run_seconds(settings, math.ceil(longest / settings.dt_s))


@dataclass(frozen=True, eq=False)
class RoundPlanner:
    """Planner of one round's motions within the remaining device time [s]; it writes them into `folder`."""

    settings: InvestigateSettings
    simulator: Simulator
    left_s: float
    folder: Path

    def first(self) -> RoundPlan:
        """Plan of the first round."""
        longest = first_longest_s(self.settings, self.left_s)
        count, around = self.settings.investigate.first_motions, run_seconds(self.settings, 0)
        family = self._family(longest)
        return self._plan(first_motions(self.simulator, family, count, allowed(self.settings), around), longest)

    def designed(self, question: DiscriminationTask, number: int, longer: int) -> RoundPlan | None:
        """Plan of the designed motion with most expected information; None if no motion has enough.

        `number` is that of its recording; `longer` a factor on its duration, where shorter ones did not decide.
        """
        settings, longest = self.settings, self._longest_s(longer)
        if longest < LEAST_MOTION_S:
            return None
        family, least = self._family(longest), LEAST_MOTION_S if longer == 1 else 0.5 * longest
        seed, around = [settings.investigate.seed, number], run_seconds(settings, 0)
        searched = search_motion(
            question.hypotheses,
            family,
            question.noise,
            SearchSettings(seed, around, least, allowed=allowed(settings)),
            [motion for motion in menu(family.limits, family.dt) if motion.duration_s <= self.left_s],
        )
        if searched is None or searched.bits < LEAST_BITS:
            return None
        name = f"{number}-designed"
        return RoundPlan(
            motions=(name,),
            seconds=self._seconds([self._written(name, searched.chosen, searched.numbers, longest)]),
            separates=tuple(hypothesis.name for hypothesis in question.hypotheses),
            probability=searched.chosen.probability,
            bits=searched.bits,
            confirms=question.confirms,
            menu=searched.menu.motion.name if searched.menu else "",
            menu_gain=searched.gain,
            looked_at=searched.looked_at,
        )

    def further(self, question: DiscriminationTask | None, number: int, recorded: Collection[str]) -> RoundPlan | None:
        """Plan of a motion of an unrecorded kind, twice as long as the first ones; None if none is allowed.

        The fitted hypotheses of the question judge whether a motion is allowed; those of a typical size without it.
        """
        longest, hypotheses = self._longest_s(_FURTHER), question.hypotheses if question else ()
        if longest < LEAST_MOTION_S:
            return None
        around, is_allowed = run_seconds(self.settings, 0), allowed(self.settings)

        def fits(option: EvaluatedMotion) -> bool:
            motion = option.motion
            angles = np.array([fitted.simulate(motion.command, motion.dt) for fitted in hypotheses])
            return is_allowed(replace(option, angles=angles) if hypotheses else option)

        chosen = further_motion(self.simulator, self._family(longest), recorded, number, fits, around)
        return None if chosen is None else replace(self._plan(chosen, longest), undirected=True)

    def _longest_s(self, factor: float) -> float:
        """Longest motion in a separate round within the remaining device time [s]."""
        room_s = self.left_s - prepare_seconds(self.settings) - run_seconds(self.settings, 0)
        return min(room_s, factor * self.settings.investigate.longest_motion_s)

    def _seconds(self, runs: Iterable[Vec]) -> float:
        return prepare_seconds(self.settings) + sum(run_seconds(self.settings, commands.size) for commands in runs)

    def _family(self, longest_s: float, dt_s: float = 1 / MOST_HZ) -> MotionFamily:
        """Family of motions, by default at the sample rate of a diagnosis."""
        settings = self.settings
        return MotionFamily(settings.limits.build(), max(settings.dt_s, dt_s), settings.safe_command, longest_s)

    def _plan(self, chosen: FirstMotions, longest_s: float) -> RoundPlan:
        """Plan of motions chosen among the starts of the family."""
        numbers = chosen.numbers
        runs = [self._written(name, option, numbers[name], longest_s) for name, option in chosen.options.items()]
        return RoundPlan(
            motions=tuple(chosen.options),
            seconds=self._seconds(runs),
            separates=chosen.explanations,
            probability=chosen.probability,
            bits=information_bits(chosen.probability, len(chosen.explanations)),
            looked_at=len(chosen.options),
        )

    def _written(self, name: str, option: EvaluatedMotion, numbers: Vec, longest_s: float) -> Vec:
        """Write a motion at the rate of the bench with its expected angle and separation; returns its commands."""
        motion, then = self._family(longest_s, 0.0).motion(numbers, name), option.motion.t
        expected = np.interp(motion.t, then, option.angles.mean(axis=0))[None]
        apart = np.interp(motion.t, then, option.separation)
        resampled = replace(option, motion=motion, angles=expected, separation=apart)
        write_motion(self.folder / f"{name}.csv", MotionProposal((), resampled, ()), self.settings.command_unit)
        return planned_commands(self.folder, name)


def allowed(settings: InvestigateSettings) -> Callable[[EvaluatedMotion], bool]:
    """Test of a motion: expected angles within the limits, and no false alarm of a blocked tip.

    The angles of all hypotheses are tried with 0.7 of the travel that the bench's motion watch allows. The limits hold
    for the median angle, since no hypothesis of a typical size has been observed on the device.
    """
    low, high = settings.angle_limits
    limits, sensor, watch = settings.limits, settings.sensor, settings.plausibility
    span, range_deg = limits.upper - limits.lower, sensor.upper_deg - sensor.lower_deg
    careful = watch.model_copy(update={"travel": _CAREFUL * watch.travel_of(span, onward=True)})

    def is_allowed(option: EvaluatedMotion) -> bool:
        expected = np.median(option.angles, axis=0)
        if expected.min() < low or expected.max() > high:
            return False
        times = np.round(1e9 * option.motion.t).astype(np.int64).tolist()
        commands = option.motion.command.tolist()
        for angles in option.angles.tolist():
            blocked = MotionWatch(careful, span, range_deg)
            if any(blocked.judge(y, u, ns) for y, u, ns in zip(angles, commands, times, strict=True)):
                return False
        return True

    return is_allowed


def planned_commands(folder: Path, name: str) -> Vec:
    """Read the commands (N,) of a planned motion from its file."""
    return read_csv(folder / f"{name}.csv").command


_LEAST_NOISE_DEG, _FORM_SHARE = 0.02, 0.01  # where the simulator's file says nothing; of the angle's range
_SLOWER = (1.0, 0.5, 0.25, 0.1)  # of the speeds of a start
_NUDGE = 0.3  # of the unknowns' typical changes


@dataclass(frozen=True, eq=False)
class FirstMotions:
    """First motions of an investigation, in the order of recording, with their hypotheses."""

    options: Mapping[str, EvaluatedMotion]  # expected result of each, by the name of its recording
    numbers: Mapping[str, Vec]  # parameters of each in the family (22,)
    explanations: tuple[str, ...]  # hypotheses to discriminate
    probability: float  # expected probability of the right hypothesis; chance is one over their number


def first_motions(
    simulator: Simulator,
    family: MotionFamily,
    count: int,
    allowed: Callable[[EvaluatedMotion], bool],
    overhead_s: float,
) -> FirstMotions:
    """Starts of the family with most expected information per second about the effect that the simulator lacks.

    Every effect of the library is added to the simulator at a typical size. The first motion has the most expected
    information per second; each further one adds most to those before it. The distances of two motions add up in
    squares. The last motion repeats the first, since only a repeat shows the noise floor and differences between
    trials.

    Args:
        count: of motions, two or more.
        allowed: test of a motion by the angles that the hypotheses expect.
        overhead_s: device time of a run without its motion [s].

    Raises:
        FitError: if no motion is allowed.
    """
    names, options = _options(simulator, family, allowed)
    if not options:
        raise FitError(
            "investigate: by the simulator every first motion leaves the angle limits, or moves the command without "
            f"the tip, expected limits of the command ({family.limits}) that keep the tip within, and a travel "
            "(plausibility.travel) wider than the play"
        )
    chosen = _greedy([option for option, _ in options.values()], (), len(names), count - 1, overhead_s)
    chosen.append(chosen[0])
    squares = sum(option.distances**2 for option in chosen)
    named = {f"{k + 1}-{option.motion.name}": option for k, option in enumerate(chosen)}
    numbers = {name: options[option.motion.name][1] for name, option in named.items()}
    return FirstMotions(named, numbers, names, expected_probability(np.sqrt(squares)))


def further_motion(
    simulator: Simulator,
    family: MotionFamily,
    recorded: Collection[str],
    number: int,
    allowed: Callable[[EvaluatedMotion], bool],
    overhead_s: float,
) -> FirstMotions | None:
    """Unrecorded start of the family with most expected information per second; None where none is allowed.

    The form error of a hypothesis is equal in each repeat of a motion; only another kind of motion shows it
    differently. Arguments as of `first_motions`.
    """
    names, options = _options(simulator, family, allowed)
    known = [option for name, (option, _) in options.items() if name in recorded]
    left = [option for name, (option, _) in options.items() if name not in recorded]
    if not left:
        return None
    (chosen,) = _greedy(left, known, len(names), 1, overhead_s)
    name, numbers = f"{number}-{chosen.motion.name}", options[chosen.motion.name][1]
    return FirstMotions({name: chosen}, {name: numbers}, names, chosen.probability)


def _options(
    simulator: Simulator, family: MotionFamily, allowed: Callable[[EvaluatedMotion], bool]
) -> tuple[tuple[str, ...], dict[str, tuple[EvaluatedMotion, Vec]]]:
    """Names of the hypotheses, and each allowed start of the family with its parameters, by name."""
    everything, noise = explanations(simulator, family.limits, family.dt), prior_noise(simulator)
    fastest = [_fastest(family, name, everything, noise, allowed) for name in family.starts]
    options = {option.motion.name: (option, numbers) for option, numbers in filter(None, fastest)}
    return tuple(explanation.name for explanation in everything), options


def _fastest(
    family: MotionFamily,
    name: str,
    everything: Sequence[OpenHypothesis],
    noise: Noise,
    allowed: Callable[[EvaluatedMotion], bool],
) -> tuple[EvaluatedMotion, Vec] | None:
    """Start of that name at the highest allowed speed, with its parameters; None if no speed is allowed."""
    for factor in _SLOWER:
        numbers = family.slower(family.starts[name], factor)
        option = evaluate_motion(everything, family.motion(numbers, name), noise)
        if option is not None and allowed(option):
            return option, numbers
    return None


def _greedy(
    options: Sequence[EvaluatedMotion], known: Sequence[EvaluatedMotion], names: int, count: int, overhead_s: float
) -> list[EvaluatedMotion]:
    """At most `count` options, chosen one by one for most additional information per second."""
    chosen: list[EvaluatedMotion] = []
    squares = sum((option.distances**2 for option in known), np.zeros((names, names)))
    bits = information_bits(expected_probability(np.sqrt(squares)), names)
    for _ in range(min(count, len(options))):
        left = [option for option in options if option not in chosen]

        def gain(option: EvaluatedMotion, squares: np.ndarray = squares, bits: float = bits) -> float:
            more = information_bits(expected_probability(np.sqrt(squares + option.distances**2)), names) - bits
            return more / (option.motion.duration_s + overhead_s)

        best = max(left, key=gain)
        chosen.append(best)
        squares = squares + best.distances**2
        bits = information_bits(expected_probability(np.sqrt(squares)), names)
    return chosen


def explanations(simulator: Simulator, limits: CommandLimits, dt: float) -> tuple[OpenHypothesis, ...]:
    """Hypotheses: the simulator unchanged, and with each effect of the library at a typical size."""
    angles = simulator.trained_angle_deg
    scale = Scale(limits.lower, limits.upper, angles.lower, angles.upper, 20.0, 100.0, dt)
    baseline = baseline_of(simulator.at_sample_time(dt).chain, Range(lower=limits.lower, upper=limits.upper))
    hypotheses = {NOTHING: _explanation(NOTHING, baseline, None, angles.lower)}
    for candidate in candidates(scale, baseline.effects):
        if candidate.effect not in hypotheses and candidate.operators:
            hypotheses[candidate.effect] = _explanation(candidate.effect, baseline, candidate, angles.lower)
    return tuple(hypotheses.values())


def _explanation(name: str, baseline: Baseline, candidate: Candidate | None, rest_deg: float) -> OpenHypothesis:
    problem = Problem(baseline, () if candidate is None else (candidate,))
    q = problem.start(baseline.nominal, [] if candidate is None else [candidate.starts[-1]])
    if candidate is not None:
        sizes = q[problem.size - len(candidate.free) :]
        sizes[:] = np.where(sizes == 0.0, 1.0, sizes)  # size 0 is replaced by one typical change
    q = np.clip(q, problem.lower, problem.upper)
    nudged = [np.clip(q + _NUDGE * row, problem.lower, problem.upper) for row in np.eye(problem.size)]
    runs = [free_run(problem.fitted_chain(p), rest_deg) for p in (q, *nudged)]
    return OpenHypothesis(name, runs[0], runs[1:])


def prior_noise(simulator: Simulator) -> Noise:
    """Noise and model error stated in the simulator's file, with small lower bounds."""
    identification = simulator.identification
    noise = nominal_noise_deg(identification) or 0.0
    sizes = [residual.rmse_deg for residual in identification.residuals]
    span = simulator.trained_angle_deg.upper - simulator.trained_angle_deg.lower
    form = float(np.sqrt(np.mean(np.square(sizes)))) if sizes else _FORM_SHARE * span
    return Noise(max(noise, _LEAST_NOISE_DEG), white=1.0, form_deg=form)
