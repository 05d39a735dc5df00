"""The first motions of an investigation, chosen before any angle is seen: from commands and the simulator alone."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hystmpc.ctrl.command import CommandLimits
from hystmpc.gap.logs.preparation import nominal_noise_deg
from hystmpc.gap.next.motion_design import (
    EvaluatedMotion,
    Noise,
    OpenHypothesis,
    evaluate_motion,
    expected_probability,
    information_bits,
)
from hystmpc.gap.next.motions import MotionFamily
from hystmpc.gap.next.open_hypotheses import NOTHING, free_run
from hystmpc.models.contract.metadata import Range
from hystmpc.models.effects.catalogue import candidates
from hystmpc.models.effects.effect import Candidate, Scale
from hystmpc.models.identify.baseline import Baseline, baseline_of
from hystmpc.models.identify.problem import Problem
from hystmpc.models.simulator import Simulator
from hystmpc.trials.errors import FitError
from hystmpc.trials.types import Vec

_LEAST_NOISE_DEG, _FORM_SHARE = 0.02, 0.01  # where the simulator's file says nothing; of the angle's range
_SLOWER = (1.0, 0.5, 0.25, 0.1)  # of the speeds of a start
_NUDGE = 0.3  # of the unknowns' typical changes


@dataclass(frozen=True, eq=False)
class FirstMotions:
    """First motions of an investigation, in the order of recording.

    Attributes:
        options: each with its expected result, by the name of its recording.
        numbers: of each in the family (22,).
        explanations: names of the hypotheses that they are to discriminate.
        probability: expected one of the right name, chance being one over their number.
    """

    options: Mapping[str, EvaluatedMotion]
    numbers: Mapping[str, Vec]
    explanations: tuple[str, ...]
    probability: float


def first_motions(
    simulator: Simulator,
    family: MotionFamily,
    count: int,
    allowed: Callable[[EvaluatedMotion], bool],
    overhead_s: float,
) -> FirstMotions:
    """Starts of the family with most expected information per second about which effect the simulator lacks.

    Every effect of the library is added to the simulator at a typical size. The first motion is the one with the most
    expected information per second, each further one that which adds most to those before it; the distances of two
    motions add up in squares. The last motion repeats the first, since the floor and what differs between trials show
    in a repeat alone.

    Args:
        count: of motions, two or more.
        allowed: whether a motion may be played, judged by the angles that the explanations expect.
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

    The error of an explanation's form is the same in each repeat of a motion. Only another kind of motion shows it in
    another way.

    Args:
        recorded: names of the starts that were recorded already.
        number: of the recording that it becomes.
        allowed: whether a motion may be played, judged by the angles that the explanations expect.
        overhead_s: device time of a run without its motion [s].
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
    """Names of the hypotheses, and each allowed start of the family with its numbers, by name."""
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
    """The start of that name, as fast as allowed, with its numbers; None where no speed is allowed."""
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
    """Hypotheses: the simulator as it is, and with each effect of the library at a typical size."""
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
        sizes[:] = np.where(sizes == 0.0, 1.0, sizes)  # a size of none is one typical change
    q = np.clip(q, problem.lower, problem.upper)
    nudged = [np.clip(q + _NUDGE * row, problem.lower, problem.upper) for row in np.eye(problem.size)]
    runs = [free_run(problem.fitted_chain(p), rest_deg) for p in (q, *nudged)]
    return OpenHypothesis(name, runs[0], runs[1:])


def prior_noise(simulator: Simulator) -> Noise:
    """Noise and model error as stated in the simulator's file, with small lower bounds."""
    identification = simulator.identification
    noise = nominal_noise_deg(identification) or 0.0
    sizes = [residual.rmse_deg for residual in identification.residuals]
    span = simulator.trained_angle_deg.upper - simulator.trained_angle_deg.lower
    form = float(np.sqrt(np.mean(np.square(sizes)))) if sizes else _FORM_SHARE * span
    return Noise(max(noise, _LEAST_NOISE_DEG), white=1.0, form_deg=form)
