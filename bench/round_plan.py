"""Planning of a round: motions within the limits and the remaining device time, and the reason for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hystmpc.gap.logs.trial_choice import MOST_HZ
from hystmpc.gap.next.motion_design import (
    EvaluatedMotion,
    MotionProposal,
    SearchSettings,
    information_bits,
    search_motion,
    write_motion,
)
from hystmpc.gap.next.motions import MotionFamily, menu
from hystmpc.gap.next.open_hypotheses import DiscriminationTask
from hystmpc.models.simulator import Simulator
from hystmpc.rig.config import BenchSettings
from hystmpc.rig.safety.plausibility import MotionWatch
from hystmpc.trials.csv_files import read_csv
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.types import Vec

from .config import InvestigateSettings
from .first_motions import FirstMotions, first_motions, further_motion
from .motions import prepare_seconds, run_seconds
from .stages import Figure

LEAST_MOTION_S = 8.0
"""Duration of the shortest motion that is planned [s]."""

LEAST_BITS = 0.1
"""Least expected information of a designed motion [bit]."""

_CAREFUL = 0.7  # of the travel without motion that stops a run
_FURTHER = 2.0  # of the longest first motion: a kind of motion that was not recorded yet
_FIRST_SHARE = 0.6  # of the device time that the first motions may take


@dataclass(frozen=True)
class RoundPlan:
    """Plan of a round: its motions and their expected information.

    Attributes:
        motions: names of their files, in the order of recording.
        seconds: device time that they take at most, the runs around them included [s].
        separates: hypotheses that they are to discriminate.
        probability: expected one of the right explanation; `bits` the same as information.
        confirms: whether the trials so far decide already, so that the motion only puts their answer to the test.
        undirected: whether a designed motion did not decide, or none is known that could: a kind of motion that was not
            recorded yet, chosen as the first ones were.
        menu: the menu's best motion, empty where none fits the device time; `menu_gain` by how much more information
            per second is expected of this one.
        looked_at: motions that were compared.
    """

    motions: tuple[str, ...]
    seconds: float
    separates: tuple[str, ...]
    probability: Figure
    bits: Figure
    confirms: bool = False
    undirected: bool = False
    menu: str = ""
    menu_gain: Figure = np.nan
    looked_at: int = 0


def round_seconds(bench: BenchSettings, runs: Mapping[str, Vec]) -> float:
    """Device time of a round, preparation included [s]."""
    return prepare_seconds(bench) + sum(run_seconds(bench, commands.size) for commands in runs.values())


def least_seconds(bench: BenchSettings) -> float:
    """Device time of the shortest round [s]."""
    return prepare_seconds(bench) + run_seconds(bench, math.ceil(LEAST_MOTION_S / bench.dt_s))


def plan_first(settings: InvestigateSettings, simulator: Simulator, left_s: float, folder: Path) -> RoundPlan:
    """Plan the first round and write its motions.

    Raises:
        ConfigError: if the device time is too short for them.
        FitError: if no motion stays within the angle limits by the simulator.
    """
    count, around = settings.investigate.first_motions, run_seconds(settings, 0)
    longest = _first_longest_s(settings, left_s)
    chosen = first_motions(simulator, _family(settings, longest), count, allowed(settings), around)
    return _plan_of(chosen, settings, longest, folder)


def first_seconds(settings: InvestigateSettings, left_s: float) -> float:
    """Device time that the first motions take at most [s].

    Raises:
        ConfigError: if the device time is too short for them.
    """
    count, longest = settings.investigate.first_motions, _first_longest_s(settings, left_s)
    return prepare_seconds(settings) + count * run_seconds(settings, math.ceil(longest / settings.dt_s))


def _room_s(settings: InvestigateSettings, left_s: float) -> float:
    """Longest motion that the device time left permits in a round of its own [s]."""
    return left_s - prepare_seconds(settings) - run_seconds(settings, 0)


def _first_longest_s(settings: InvestigateSettings, left_s: float) -> float:
    count = settings.investigate.first_motions
    longest = (_FIRST_SHARE * left_s - prepare_seconds(settings)) / count - run_seconds(settings, 0)
    longest = min(longest, settings.investigate.longest_motion_s)
    if longest < LEAST_MOTION_S:
        raise ConfigError(
            f"investigate: got {left_s:.0f} s of device time for {count} first motions and what follows, expected "
            f"motions of {LEAST_MOTION_S:g} s or more; more minutes, or fewer first_motions"
        )
    return longest


def plan_next(
    settings: InvestigateSettings, question: DiscriminationTask, left_s: float, number: int, longer: int, folder: Path
) -> RoundPlan | None:
    """Plan a designed motion with most expected information and write it; None where none has enough.

    Args:
        left_s: device time that is left [s].
        number: of the recording that it becomes.
        longer: factor on the motion's duration, where shorter ones did not decide.
    """
    longest = min(_room_s(settings, left_s), longer * settings.investigate.longest_motion_s)
    least = LEAST_MOTION_S if longer == 1 else 0.5 * longest
    if longest < LEAST_MOTION_S:
        return None
    family, wanted = _family(settings, longest), settings.investigate.seed
    searched = search_motion(
        question.hypotheses,
        family,
        question.noise,
        SearchSettings([wanted, number], run_seconds(settings, 0), least, allowed=allowed(settings)),
        [motion for motion in menu(family.limits, family.dt) if motion.duration_s <= left_s],
    )
    if searched is None or searched.bits < LEAST_BITS:
        return None
    name = f"{number}-designed"
    commands = _written(folder, name, searched.chosen, searched.numbers, settings, longest)
    return RoundPlan(
        motions=(name,),
        seconds=round_seconds(settings, {name: commands}),
        separates=tuple(hypothesis.name for hypothesis in question.hypotheses),
        probability=searched.chosen.probability,
        bits=searched.bits,
        confirms=question.confirms,
        menu=searched.menu.motion.name if searched.menu else "",
        menu_gain=searched.gain,
        looked_at=searched.looked_at,
    )


def plan_more(
    settings: InvestigateSettings,
    simulator: Simulator,
    left_s: float,
    number: int,
    recorded: Collection[str],
    question: DiscriminationTask | None,
    folder: Path,
) -> RoundPlan | None:
    """Plan a motion of a kind that was not recorded yet, twice as long as the first ones.

    None where the device time is too short, or no kind is left that is allowed.

    Args:
        left_s: device time that is left [s].
        number: of the recording that it becomes.
        recorded: kinds of motion that were recorded.
        question: its explanations, fitted to what was recorded, judge what is allowed; those of a typical size do where
            there is none.
    """
    longest = min(_room_s(settings, left_s), _FURTHER * settings.investigate.longest_motion_s)
    if longest < LEAST_MOTION_S:
        return None
    around = run_seconds(settings, 0)
    is_allowed, hypotheses = allowed(settings), question.hypotheses if question else ()

    def fits(option: EvaluatedMotion) -> bool:
        motion = option.motion
        angles = np.array([fitted.simulate(motion.command, motion.dt) for fitted in hypotheses])
        return is_allowed(replace(option, angles=angles) if hypotheses else option)

    chosen = further_motion(simulator, _family(settings, longest), recorded, number, fits, around)
    if chosen is None:
        return None
    return replace(_plan_of(chosen, settings, longest, folder), undirected=True)


def _plan_of(chosen: FirstMotions, settings: InvestigateSettings, longest_s: float, folder: Path) -> RoundPlan:
    """Plan of motions that were chosen among the starts of the family; writes them."""
    runs = {
        name: _written(folder, name, option, chosen.numbers[name], settings, longest_s)
        for name, option in chosen.options.items()
    }
    return RoundPlan(
        motions=tuple(runs),
        seconds=round_seconds(settings, runs),
        separates=chosen.explanations,
        probability=chosen.probability,
        bits=information_bits(chosen.probability, len(chosen.explanations)),
        looked_at=len(chosen.options),
    )


def allowed(settings: InvestigateSettings) -> Callable[[EvaluatedMotion], bool]:
    """Test of a motion: expected angles within the limits, and no false alarm of a blocked tip.

    The angles of all explanations are tried, with 0.7 of the travel that the bench's own watch on motion allows. The
    limits count for the median angle, since no explanation of a typical size has been seen on the device.
    """
    low, high = settings.angle_limits
    span, range_deg = (
        settings.limits.upper - settings.limits.lower,
        settings.sensor.upper_deg - settings.sensor.lower_deg,
    )
    watch = settings.plausibility
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
    """Read the commands (N,) of a planned motion.

    Raises:
        LogError: if the file is missing or no motion.
    """
    return read_csv(folder / f"{name}.csv").command


def _family(settings: InvestigateSettings, longest_s: float) -> MotionFamily:
    """Family of motions at the rate at which a diagnosis simulates."""
    dt = max(settings.dt_s, 1 / MOST_HZ)
    return MotionFamily(settings.limits.build(), dt, settings.safe_command, longest_s)


def _written(
    folder: Path, name: str, option: EvaluatedMotion, numbers: Vec, settings: InvestigateSettings, longest_s: float
) -> Vec:
    """Write a motion at the rate of the bench with its expected angle and separation; returns its commands."""
    family = MotionFamily(settings.limits.build(), settings.dt_s, settings.safe_command, longest_s)
    motion, then = family.motion(numbers, name), option.motion.t
    expected = np.interp(motion.t, then, option.angles.mean(axis=0))[None]
    resampled = replace(option, motion=motion, angles=expected, separation=np.interp(motion.t, then, option.separation))
    write_motion(folder / f"{name}.csv", MotionProposal((), resampled, ()), settings.command_unit)
    return planned_commands(folder, name)
