"""Rounds of an investigation of two axes: motions of each axis alone and of both, verdicts on each and what joins them.

A motion of one axis moves the command that pulls most by it, while the other command rests:

    w_i = M_ik u_k + M_ij u_j,    u_j at the safe command

It is planned for the simulator of that axis, whose command is w_i.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.gap.report.words import in_words
from hystmpc.gap.two_axes.diagnose import diagnose_two_axes
from hystmpc.gap.two_axes.diagnosis import KnownJoins
from hystmpc.gap.two_axes.joins import AS_GIVEN
from hystmpc.gap.two_axes.words import join_headline
from hystmpc.models.two_axes.model import AXES, TwoAxisModel, load_two_axes
from hystmpc.rig.axes import NAMES, each, trial_columns
from hystmpc.rig.config import BenchSettings
from hystmpc.rig.transports.transport import WireUnits
from hystmpc.sim.two_axes.config import TwoAxisPlantSettings
from hystmpc.sim.two_axes.plant import TwoAxisPlant
from hystmpc.trials.axes import both_axes
from hystmpc.trials.csv_files import format_table, read_csv
from hystmpc.trials.errors import FitError, ModelError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.read import at_rate, read_trials
from hystmpc.trials.recording import SEPARATION_COLUMN, recorded_trials
from hystmpc.trials.trial import parts_at_gaps
from hystmpc.trials.types import Progress, Vec

from .config import CommissionBlock, InvestigateSettings
from .motions import prepare_seconds, recordings_of_both, run_seconds, shake_seconds
from .round_plan import LEAST_MOTION_S, PlanePlan, RoundPlan, RoundPlanner, first_longest_s
from .rounds import Ending, JoinVerdict, PlaneVerdict, judged_next, round_verdict
from .stages import DIAGNOSIS

KINDS_OF_BOTH = ("reversals_xy", "circles", "rows_x", "rows_y")
"""Motions of both axes, in the order in which they are recorded: turns at many places tell joins apart."""

_SMALLER, _LEAST_SIZE = 0.1, 0.3  # steps in which a motion is made smaller, and the smallest one, of the whole
_WORTH = 0.2  # of the error as given: what an effect that is not sure lowers it by, if the joins are open
_SURE = 2  # rounds in a row with the same joins
_FIRST_SHARE = 0.6  # of the device time that the first motions may take, see `first_longest_s`


@dataclass(frozen=True, eq=False)
class AxisView:
    """One axis of a bench of two axes as a bench of one: the command there is the travel of that axis.

    Attributes:
        number: of the command that moves.
        gain: travel of the axis by that command.
        bench: limits and safe command are those of the travel.
    """

    number: int
    gain: float
    bench: InvestigateSettings

    @classmethod
    def of(cls, settings: InvestigateSettings, model: TwoAxisModel, axis: int) -> AxisView:
        """View of an axis of a model."""
        limits, safe = settings.axes_limits, np.array(each(settings.safe_command))
        spans = [one.upper - one.lower for one in limits]
        number = int(np.argmax(np.abs(model.matrix[axis]) * spans))
        gain, one = float(model.matrix[axis, number]), limits[number]
        rest = float(model.matrix[axis] @ safe)
        ends = sorted(rest + gain * (end - float(safe[number])) for end in (one.lower, one.upper))
        rate, watch = abs(gain) * one.rate, settings.plausibility
        travel = None if watch.travel is None else abs(gain) * watch.travel
        ramps = {"velocity_per_s": min(settings.ramps.velocity_per_s, rate), "brake_per_s2": None}
        plain: dict[str, Any] = {name: getattr(settings, name) for name in BenchSettings.model_fields}
        plain |= {
            "limits": {"lower": ends[0], "upper": ends[1], "rate_per_s": rate},
            "safe_command": rest,
            "start_command": None,
            "stop_overshoot": None,
            "ramps": settings.ramps.model_copy(update=ramps),
            "plausibility": watch.model_copy(update={"travel": travel}),
            "wire": WireUnits(),
            "prepare": (),
            "commission": CommissionBlock(angle_limits_deg=settings.commission.angle_limits_deg),
            "investigate": settings.investigate,
        }
        return cls(number, gain, InvestigateSettings.parse(plain, f"axis {NAMES[axis]}"))

    def commands(self, settings: InvestigateSettings, travels: Vec) -> Vec:
        """Commands (N, 2) of the device of two axes, within its limits, for travels (N,)."""
        safe = each(settings.safe_command)
        made = np.tile(np.array(safe), (travels.size, 1))
        moved = safe[self.number] + (travels - self.bench.safe_command) / self.gain
        made[:, self.number] = settings.axes_limits[self.number].clip_plans(moved, safe[self.number], settings.dt_s)
        return made


@dataclass(frozen=True, eq=False)
class PlanePlanner:
    """Planner of one round's motions within the remaining device time [s]; it writes them into `folder`."""

    settings: InvestigateSettings
    model: TwoAxisModel
    left_s: float
    folder: Path

    @cached_property
    def _around_s(self) -> float:
        return run_seconds(self.settings, 0)

    @cached_property
    def least_s(self) -> float:
        """Device time of the shortest round [s]."""
        return prepare_seconds(self.settings) + run_seconds(
            self.settings, math.ceil(LEAST_MOTION_S / self.settings.dt_s)
        )

    def axis(self, axis: int, left_s: float) -> RoundPlanner:
        """Planner of the motions of one axis alone within that device time [s], in travels."""
        view = AxisView.of(self.settings, self.model, axis)
        room_s = left_s - prepare_seconds(self.settings) - shake_seconds(self.settings)
        return RoundPlanner(view.bench, self.model.axes[axis], room_s, self.folder / NAMES[axis])

    def first(self) -> PlanePlan:
        """Plan of the first round: first motions of each axis, and one of both.

        Raises:
            ConfigError: if the device time is too short for them.
            FitError: if no motion of an axis stays within the angle limits by the simulator.
        """
        block = self.settings.investigate
        first_longest_s(self.settings, self.left_s)  # says what is too little of the whole
        both_s = self._seconds([self._of_both()[KINDS_OF_BOTH[0]]])
        shakes_s = (block.first_motions - 1) * shake_seconds(self.settings) / _FIRST_SHARE
        x, y = (self.axis(i, 0.5 * (self.left_s - both_s) - shakes_s).first() for i in range(AXES))
        return self.assembled((x, y), f"1-{KINDS_OF_BOTH[0]}")

    def assembled(self, plans: Sequence[RoundPlan | None], both: str) -> PlanePlan:
        """Plan of a round from those of the axes, and the name of a motion of both; its commands are written.

        Raises:
            FitError: if a motion does not stay within the angle limits by the simulator.
        """
        runs: dict[str, Vec] = {}
        alone = [[] if plan is None else [(i, name) for name in plan.motions] for i, plan in enumerate(plans)]
        for axis, name in filter(None, chain.from_iterable(zip_longest(*alone))):
            runs[f"{name}_{NAMES[axis]}"] = self._of_axis(axis, name)
        if both:
            commands = self._of_both()[both.partition("-")[2]]
            runs[both] = self._written(both, commands, np.zeros(len(commands)))
        x, y = plans
        return PlanePlan(x, y, (both,) if both else (), tuple(runs), self._seconds(list(runs.values())))

    def _of_axis(self, axis: int, name: str) -> Vec:
        """Write a motion that was planned for one axis as commands (N, 2) of both; returns them."""
        planned = read_csv(self.folder / NAMES[axis] / f"{name}.csv")
        commands = AxisView.of(self.settings, self.model, axis).commands(self.settings, planned.command)
        return self._written(f"{name}_{NAMES[axis]}", commands, planned.channels[SEPARATION_COLUMN])

    def _of_both(self) -> dict[str, Vec]:
        block = self.settings.investigate
        return recordings_of_both(self.settings, block.longest_motion_s, block.seed)

    def _written(self, name: str, commands: Vec, separation_deg: Vec) -> Vec:
        """Write commands (N, 2) with the angles that the simulator expects, made smaller until these are allowed."""
        (low, high), size = self.settings.angle_limits, 1.0
        safe = np.array(each(self.settings.safe_command))
        while True:
            smaller = safe + size * (commands - safe)
            expected = self.model.run(np.vstack([safe, smaller]), self._rest_deg)[1:]
            if low <= expected.min() and expected.max() <= high:
                break
            size -= _SMALLER
            if size < _LEAST_SIZE:
                raise FitError(
                    f"investigate: by the simulator {name} leaves the angle limits {low:g} to {high:g} deg, expected "
                    "limits of the commands that keep both angles within"
                )
        t, unit = self.settings.dt_s * np.arange(len(smaller), dtype=np.float64), self.settings.command_unit
        columns = trial_columns(t, smaller, expected, unit)
        write_atomically(self.folder / f"{name}.csv", format_table({**columns, SEPARATION_COLUMN: separation_deg}))
        return planned_commands_of_both(self.folder, name)

    @cached_property
    def _rest_deg(self) -> Vec:
        """Angles (2,) at which the simulator rests [deg]."""
        return np.asarray(TwoAxisPlant(self.model, TwoAxisPlantSettings(simulator="")).true_angle)

    def _seconds(self, runs: Sequence[Vec]) -> float:
        return prepare_seconds(self.settings) + sum(run_seconds(self.settings, len(commands)) for commands in runs)


def planned_commands_of_both(folder: Path, name: str) -> Vec:
    """Read the commands (N, 2) of a planned motion from its file."""
    (trial,) = both_axes(read_trials(folder / f"{name}.csv")) or []
    return trial.commands


def judge_plane(
    settings: InvestigateSettings,
    model: Path,
    files: Sequence[Path],
    before: Sequence[PlaneVerdict],
    left_s: float,
    folder: Path,
    progress: Progress | None = None,
) -> PlaneVerdict:
    """Diagnose all trials of two axes, write the diagnosis, and plan the next round where one follows.

    Args:
        left_s: device time left [s].

    Raises:
        GapError: if the recordings cannot be compared with the simulator.
        KeyboardInterrupt: if the user ended it; nothing of this stage is kept.
    """
    known, kinds = load_two_axes(model), [file.stem.partition("-")[2] for file in files]
    recorded = recorded_trials(files, most_axes=AXES)
    trials = both_axes(at_rate(recorded, 1 / known.dt_s)) or []
    # Later motions are of the axis alone that is open: they would tell more of one axis than of the other.
    tells = [f.parents[2] == files[0].parents[2] or kind in KINDS_OF_BOTH for f, kind in zip(files, kinds, strict=True)]
    of_parts = np.repeat(tells, [len(parts_at_gaps(trial)) for trial in recorded])
    done = diagnose_two_axes(
        trials,
        known,
        out=folder / DIAGNOSIS,
        called={"sim": str(model)},
        model=model,
        seed=settings.investigate.seed,
        of_joins=[trial for trial, tell in zip(trials, of_parts, strict=True) if tell],
        progress=progress,
    )
    planner, number = PlanePlanner(settings, known, left_s, folder), len(files) + 1
    axes, spent = [], 0.0
    for i, name in enumerate(NAMES):
        alone = {kind.removesuffix(f"_{name}") for kind in kinds if kind not in KINDS_OF_BOTH}
        judged = round_verdict(done.axes[i].diagnosis, len(files))
        earlier = [one.axes[i] for one in before]
        if earlier and earlier[-1].ended and judged.result == earlier[-1].result:
            axes.append(replace(judged, ended=earlier[-1].ended, why=earlier[-1].why))
            continue
        one, findings, rest_s = planner.axis(i, left_s - spent), done.axes[i].findings, max(left_s - spent, 0.0)
        axes.append(judged_next(one, findings, judged, earlier, number + i, alone, rest_s, planner.least_s))
        spent += 0.0 if (plan := axes[-1].next) is None else plan.seconds + run_seconds(settings, 0)
    earlier_joins, in_time = [one.joins for one in before], left_s - spent >= planner.least_s
    joins = joins_verdict(done.diagnosis.joins, earlier_joins, number + AXES, kinds, in_time)
    return _with_plan(PlaneVerdict(joins, axes[0], axes[1], len(files)), planner)


def joins_verdict(
    joins: KnownJoins, before: Sequence[JoinVerdict], number: int, recorded: Collection[str], in_time: bool
) -> JoinVerdict:
    """Verdict on what joins the axes, and its consequence: an end, or another motion of both axes.

    It ends where two rounds in a row agree. Effects that cannot be told apart, and one that lowers the error without
    being sure, leave it open.

    Args:
        before: verdicts of the rounds before.
        number: of the recording of the next motion.
        recorded: kinds of motion that were recorded.
        in_time: whether the device time left suffices for another one.
    """
    names = tuple(effect.name for effect in joins.effects)
    made = JoinVerdict(names, joins.ambiguity, join_headline(joins))
    best = min(joins.held_out, key=joins.held_out.__getitem__)
    unclear = not names and joins.held_out[best] < (1 - _WORTH) * joins.held_out[AS_GIVEN]
    if unclear:
        words = f"What joins the axes is open: {in_words(best)} lowers the error, but not surely"
        made = replace(made, headline=words, unclear=True)
    if before and before[-1].ended and before[-1].result == made.result:
        return replace(made, ended=before[-1].ended, why=before[-1].why)
    sure = (
        not (unclear or made.ambiguity)
        and len(before) >= _SURE - 1
        and all(b.result == made.result for b in before[1 - _SURE :])
    )
    left = [kind for kind in KINDS_OF_BOTH if kind not in recorded]
    ended: Ending
    if sure:
        ended, why = ("named" if names else "no_gap"), f"the same in {_SURE} rounds in a row"
    elif not in_time:
        ended, why = "budget", "too little device time is left for another motion of both axes"
    elif not left:
        ended, why = "nothing_gained", "every motion of both axes was recorded"
    else:
        return replace(made, next=f"{number}-{left[0]}")
    return replace(made, ended=ended, why=why)


def _with_plan(judged: PlaneVerdict, planner: PlanePlanner) -> PlaneVerdict:
    """Add the motions of the next round, or the end: the most open of the three reasons, and all of them in words."""
    plans = [one.next for one in judged.axes]
    if any(plans) or judged.joins.next:
        return replace(judged, next=planner.assembled(plans, judged.joins.next))
    endings: list[Ending] = [judged.joins.ended, judged.x.ended, judged.y.ended]
    order: tuple[Ending, ...] = ("budget", "nothing_gained", "named", "no_gap")
    why = f"between the axes: {judged.joins.why}; x: {judged.x.why}; y: {judged.y.why}"
    return replace(judged, ended=min(endings, key=order.index), why=why)


def require_plane_model(path: Path, command_unit: str) -> TwoAxisModel:
    """Read the simulator of two axes that is judged.

    Raises:
        ModelError: if it cannot be used, or takes commands in another unit.
    """
    model = load_two_axes(path)
    if (n := len(model.command_limits)) != AXES:
        raise ModelError(f"{path}: a model of {n} tendons, expected one of two: save `in_travels()` of it")
    if (unit := model.axes[0].command_unit) != command_unit:
        raise ModelError(f"{path}: takes commands in {unit}, expected the bench's {command_unit}")
    return model
