"""Check of trials against a simulator: units, sign, scale, excitation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.simulator import Simulator
from hystmpc.trials.clock_findings import gaps_text
from hystmpc.trials.command_noise import noise_text
from hystmpc.trials.errors import GapError
from hystmpc.trials.recording import require_recorded
from hystmpc.trials.trial import Trial, parts_at_gaps

from .dependence import follows_command
from .excitation import Excitation, excitation_of
from .trial_choice import LEAST_S, ChosenTrials, choose_trials

_WRONG_SIGN = -0.3  # correlation; above it a lag of up to a third of a period may be the cause
_SURELY_WRONG = -0.7  # of a single trial, where all together have the right sign
_MIDDLE = (0.02, 0.98)  # quantiles of the angles that outliers leave alone
_WRONG_SCALE = 5.0
_SMALL_COMMAND = 1 / 50  # of the simulator's range: less is another unit, not a small motion
_LEAST_SPAN = 0.3  # of the simulator's trained command: in less, backlash may absorb the motion
_UNIT_FACTOR = 1.6  # an error text names a unit whose factor is that near
_COMMAND_UNITS = {
    "mm": {1e3: "um", 1e-3: "m", 0.1: "cm", 1 / 25.4: "inch"},
    "bar": {100.0: "kPa", 1e5: "Pa", 1e3: "mbar", 14.5: "psi", 0.1: "MPa"},
}
_ANGLE_UNITS = {1 / 57.3: "radians", 60.0: "minutes of arc", 1e3: "thousandths of a degree"}
_JITTER = 0.1
_UNRELATED = (
    "the angle of no trial follows its command: a model of the command's past explains no more of its changes than if "
    "they came in another order, so that these logs say nothing on a simulator"
)
_AT_EXTREME, _TRAVEL = 0.02, 0.05  # of the samples; of the command's range


@dataclass(frozen=True, eq=False)
class CheckedTrials(ChosenTrials):
    """Checked trials with their excitation and notes.

    Attributes:
        excitation: motions, speeds, holds and repeats of their commands.
        notes: faults and shortcomings of the trials, a sentence each.
        left_out: what is not diagnosed and why, a line each; also among the notes.
        unrelated: why the angles of all trials say nothing on a simulator; empty where they follow their commands.
    """

    excitation: Excitation
    notes: tuple[str, ...]
    left_out: tuple[str, ...]
    unrelated: str


def check_trials(
    trials: Sequence[Trial], simulator: Simulator | ModelMetadata, seed: int = 0, ordered: bool = True
) -> CheckedTrials:
    """Compare units, sign and scale with the simulator's, and bring the trials to one rate.

    The rate is the simulator's own, at which `evaluate` runs it, where it lies between 10 and 50 Hz and no trial's
    median rate is lower by a factor of 1.5 or more; else the lowest of 50 Hz and the trials' rates. A network, given by
    its metadata, always keeps its own rate. A log with gaps is cut there, as `fit` and `check` do it. Of more trials
    than can be afforded some are chosen (`affordable`), and those whose angle does not follow the command are left out
    (`follows_command`).

    Args:
        trials: of one device.
        simulator: chain of operators, or metadata of another model.
        seed: of the choice of trials and of the test.
        ordered: whether the trials stand in the order of recording.

    Raises:
        GapError: if there is no trial, units differ, commands or angles never change, the angle falls as the command
            rises, or command or angle are off by so much that the unit or the device is another.
        LogError: if a network's rate is above a log's, or time seems to be in milliseconds.
    """
    facts = simulator.metadata() if isinstance(simulator, Simulator) else simulator
    if not trials:
        raise GapError("no trial given, expected one or more logs of the simulator's device")
    for trial in trials:
        require_recorded(trial)
        _require_units(trial, facts)
    _require_motion(trials)
    _require_commands(trials, facts)
    chosen = choose_trials(trials, facts, not isinstance(simulator, Simulator), seed, ordered)
    follows = follows_command(chosen.trials, seed)
    left_out, unrelated = [chosen.workload.note] if chosen.workload.note else [], ""
    if any(follows):
        left_out += [_left_out(t) for t, kept in zip(chosen.given, follows, strict=True) if not kept]
        chosen = chosen.only(follows)
        _require_sign(chosen.given)
        _require_angles(chosen.given, facts)
    else:
        unrelated = _UNRELATED
    excitation = excitation_of(chosen.trials, ordered)
    notes = (*left_out, *_gap_notes(trials), *(n for trial in chosen.given for n in _log_notes(trial)))
    notes = (*notes, *_set_notes(excitation))
    return CheckedTrials(
        **vars(chosen), excitation=excitation, notes=notes, left_out=tuple(left_out), unrelated=unrelated
    )


def _left_out(trial: Trial) -> str:
    return (
        f"{Path(trial.source).name}: left out, the angle does not follow the command (no more than if its changes "
        "came in another order), expected one that does; is it another trial's, or the sensor's noise?"
    )


def _require_units(trial: Trial, facts: ModelMetadata) -> None:
    got, wanted = (trial.units.command, trial.units.angle), (facts.command_unit, facts.angle_unit)
    if facts.inverted:
        raise GapError(f"the simulator maps {wanted[0]} to {wanted[1]} as an inverse, expected a forward model")
    if got != wanted:
        raise GapError(
            f"{trial.source}: command in {got[0]} and angle in {got[1]}, expected {wanted[0]} and {wanted[1]} as the "
            "simulator has them"
        )


def _require_motion(trials: Sequence[Trial]) -> None:
    names = ", ".join(Path(trial.source).name for trial in trials)
    if all(np.ptp(trial.command) == 0 for trial in trials):
        raise GapError(f"{names}: the command is constant in every trial, expected one that moves")
    for trial in trials:
        if np.ptp(trial.command) > 0 and np.ptp(trial.angle) == 0:
            raise GapError(
                f"{trial.source}: the angle is {trial.angle[0]:g} {trial.units.angle} throughout while the command "
                "moves, expected an angle that follows it"
            )
        if trial.duration_s < LEAST_S:
            raise GapError(f"{trial.source}: {trial.duration_s:.3g} s long, expected {LEAST_S:g} s or more")


def _require_sign(trials: Sequence[Trial]) -> None:
    pooled = _correlation(trials)
    for trial in trials:
        limit = _SURELY_WRONG if pooled >= _WRONG_SIGN else _WRONG_SIGN
        if np.ptp(trial.command) > 0 and (together := _correlation([trial])) < limit:
            raise GapError(
                f"{trial.source}: the angle falls as the command rises (correlation {together:.2f}), expected it to "
                "rise; flip the sign of one of them"
            )


def _correlation(trials: Sequence[Trial]) -> float:
    """Correlation of command and angle about each trial's means, over all trials."""
    u = np.concatenate([trial.command - trial.command.mean() for trial in trials])
    y = np.concatenate([trial.angle - trial.angle.mean() for trial in trials])
    return float(u @ y / math.sqrt(max((u @ u) * (y @ y), 1e-300)))


def _require_commands(trials: Sequence[Trial], facts: ModelMetadata) -> None:
    low, high = min(float(t.command.min()) for t in trials), max(float(t.command.max()) for t in trials)
    least = min(facts.command_limits.lower, facts.trained_command.lower)
    most = max(facts.command_limits.upper, facts.trained_command.upper)
    factor, unit = (high - low) / (most - least), facts.command_unit
    name, expected = _name(trials), f"expected within about {least:.4g} to {most:.4g} {unit}"
    text = f"{name}: command {low:.4g} to {high:.4g} {unit}, {expected}"
    if factor > _WRONG_SCALE or factor < _SMALL_COMMAND:
        raise GapError(f"{text} (factor {factor:.3g}{_unit_remark(factor, _COMMAND_UNITS.get(unit, {}))})")
    if low > most + (most - least) or high < least - (most - least):
        raise GapError(f"{text}: it lies outside by more than the whole range; another zero or device?")


def _require_angles(trials: Sequence[Trial], facts: ModelMetadata) -> None:
    """Compare the angle's range with that of the simulator, scaled to the command's range.

    A range that is too large is that of the middle 96 % of the samples: outliers of a faulty sensor have any size.
    """
    command = max(float(t.command.max()) for t in trials) - min(float(t.command.min()) for t in trials)
    trained = facts.trained_command.upper - facts.trained_command.lower
    if command < _LEAST_SPAN * trained:
        return
    angles = np.concatenate([t.angle for t in trials])
    expected = (facts.trained_angle.upper - facts.trained_angle.lower) * command / trained
    angle, middle = float(np.ptp(angles)), float(np.ptp(np.quantile(angles, _MIDDLE)))
    factor = angle / expected
    if factor < 1 / _WRONG_SCALE or min(angle, middle) > _WRONG_SCALE * expected:
        unit = facts.angle_unit
        remark = _unit_remark(factor, _ANGLE_UNITS if unit == "deg" else {}) or "; another unit or device?"
        raise GapError(
            f"{_name(trials)}: the angle ranges over {angle:.4g} {unit}, expected about {expected:.4g} {unit} from the "
            f"simulator (factor {factor:.3g}{remark})"
        )


def _name(trials: Sequence[Trial]) -> str:
    return Path(trials[0].source).name if len(trials) == 1 else f"{len(trials)} trials"


def _unit_remark(factor: float, units: dict[float, str]) -> str:
    near = sorted((abs(math.log(factor / known)), name) for known, name in units.items())
    return f": looks like {near[0][1]}" if near and near[0][0] < math.log(_UNIT_FACTOR) else ""


def _gap_notes(trials: Sequence[Trial]) -> Iterator[str]:
    for trial in trials:
        if said := gaps_text(trial, parts_at_gaps(trial)):
            yield f"{Path(trial.source).name}: gaps in time; {said}."


def _log_notes(trial: Trial) -> Iterator[str]:
    name, intervals, command = Path(trial.source).name, np.diff(trial.t), trial.command
    if said := noise_text(trial):
        yield f"{name}: {said}."
    jitter = float(np.std(intervals)) / trial.dt
    if jitter > _JITTER:
        yield f"{name}: sample intervals scatter by {jitter:.0%} of {1e3 * trial.dt:.3g} ms."
    if np.ptp(command) == 0:
        yield f"{name}: the command is constant; it shows noise and drift only."
        return
    onward = np.gradient(command)
    for end, at, way in (("greatest", trial.angle.max(), 1.0), ("least", trial.angle.min(), -1.0)):
        # On the way back backlash holds the angle as well; on the way there a stop or the sensor does.
        stuck = (trial.angle == at) & (way * onward > 0)
        travel = float(np.ptp(command[stuck])) / float(np.ptp(command)) if stuck.any() else 0.0
        if np.mean(stuck) > _AT_EXTREME and travel > _TRAVEL:
            yield (
                f"{name}: the angle sits at its {end} value, {at:.4g} {trial.units.angle}, for {np.mean(stuck):.0%} "
                f"of the samples while the command goes on by {travel:.0%} of its range: a saturated sensor, a stop, "
                "or slack."
            )
    if _correlation([trial]) < -_WRONG_SIGN:
        yield f"{name}: the angle hardly follows the command (correlation {_correlation([trial]):.2f})."


def _set_notes(e: Excitation) -> Iterator[str]:
    if e.trials == 1:
        yield "One trial only: what is held out comes from the same recording, and changes between trials cannot show."
    if not e.has_repeats:
        yield "No motion is repeated: the floor is the residual's noise, a lower bound, and every share is relative."
    if not e.has_holds:
        yield f"No hold of 3 s or more ({e.longest_hold_s:.3g} s at most): creep and lag cannot be told apart."
    if e.sine_only:
        yield "Single sines only: most effects look alike in them, and refitting hides most of a gap."
