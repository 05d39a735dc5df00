"""Check of trials against a simulator: units, sign, scale, excitation, and dependence of the angle on the command."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hystmpc.models.contract.metadata import ModelMetadata
from hystmpc.models.simulator import Simulator
from hystmpc.trials.command_noise import noise_text
from hystmpc.trials.errors import GapError
from hystmpc.trials.findings import gaps_text
from hystmpc.trials.recording import require_recorded
from hystmpc.trials.trial import Trial, parts_at_gaps
from hystmpc.trials.types import Mat, Vec

from .excitation import Excitation, excitation_of
from .motion_type import past_features
from .sensor import autocorrelation
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
        notes: faults and shortcomings of the trials, a sentence each.
        left_out: omitted trials and the reasons, a line each; also among the notes.
        unrelated: reason why the angles of all trials are unusable; empty if they follow their commands.
    """

    excitation: Excitation
    notes: tuple[str, ...]
    left_out: tuple[str, ...]
    unrelated: str


def check_trials(
    trials: Sequence[Trial], simulator: Simulator | ModelMetadata, seed: int = 0, ordered: bool = True
) -> CheckedTrials:
    """Compare units, sign and scale with the simulator's, and resample the trials to one rate.

    The rate is that of the simulator if it lies between 10 and 50 Hz and no trial's median rate is lower by a factor of
    1.5 or more; otherwise the lowest of 50 Hz and the trials' rates. A network, given by its metadata, always keeps its
    rate. A log with gaps is cut there. Too many trials are reduced (`affordable`), and those whose angle does not
    follow the command are left out (`follows_command`).

    Raises:
        GapError: if there is no trial, units differ, commands or angles never change, the angle falls as the command
            rises, or the size of command or angle indicates another unit or device.
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
    gaps = ((trial, gaps_text(trial, parts_at_gaps(trial))) for trial in trials)
    cut = [f"{Path(trial.source).name}: gaps in time; {said}." for trial, said in gaps if said]
    notes = (*left_out, *cut, *(n for trial in chosen.given for n in _log_notes(trial)), *_set_notes(excitation))
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
    """Compare the angle's range, too large ones without outliers, with the simulator's, scaled to the command's."""
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
        # While unloading, backlash also holds the angle; while loading, only a stop or the sensor does.
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
    if len(e.motions) == 1:
        yield "One trial only: what is held out comes from the same recording, and changes between trials cannot show."
    if not e.repeats:
        yield "No motion is repeated: the floor is the residual's noise, a lower bound, and every share is relative."
    if not e.has_holds:
        yield f"No hold of 3 s or more ({e.longest_hold_s:.3g} s at most): creep and lag cannot be told apart."
    if e.sine_only:
        yield "Single sines only: most effects look alike in them, and refitting hides most of a gap."


_DRAWS = 199  # of the null: the lowest level of significance is 1 in 200
_LEVEL = 0.01
_RIDGES = (1e-3, 1e-1, 1.0)  # of the mean eigenvalue of the features' Gram matrix
_SURELY = 0.25  # share of the energy (correlation 0.5) that needs no test
_EXPECTED = 0.25  # of the motion expected in all trials, below which a trial cannot be tested
_SCATTER = 2.0  # standard deviations by which one trial may follow less than the others, where all follow little
_PER_LAG = 8  # means that are kept of the time over which changes are taken
_LEAST_BLOCKS = 8  # of a trial
_PARTS = 4  # that a single trial is cut into


@dataclass(frozen=True, eq=False)
class _TrialSums:
    """Sums over a trial: features (F, F), features and changes by order (F, 1 + D), squared changes (1 + D,)."""

    gram: Mat
    products: Mat
    energy: Vec
    samples: float


def follows_command(trials: Sequence[Trial], seed: int = 0) -> tuple[bool, ...]:
    """Test whether each trial's angle depends on the past of its command, or at least does not contradict this.

    Changes y of the angle are regressed on those of features of the command's past (levels, speeds, lags, low-passes,
    plays) by ridge regression over all trials but one, and predicted in that one:

        share = 1 - sum_trials |y - expected|^2 / sum_trials |y|^2,   r = y . expected / (|y| |expected|)

    Changes are taken over the time in which the command loses half of its variance. The null distribution comes from
    block permutations of the changes of each trial.

    All trials together depend on their commands if share and, in half of the trials, r are large (a quarter, 0.5) or
    above the 99 % quantile of the null. Then a trial follows if its r passes this test, is below that of the median
    trial only by chance, or little motion is expected. Otherwise the trials of significant r follow if they are at
    least half of all and depend on their commands without the others.

    Sources: Granger, Newbold, Spurious regressions in econometrics, J. Econometrics 2 (1974); Theiler et al., Testing
    for nonlinearity in time series: the method of surrogate data, Physica D 58 (1992).
    """
    parts = _parts(trials, seed)
    if len(trials) == 1:
        return (_depends(*_held_out_share(parts)[:2]),)
    share, chance, expected = _held_out_share(parts)
    correlations = [_likeness(part, weights) for part, weights in zip(parts, expected, strict=True)]
    unseen = _little_motion(parts, expected)
    sure = [_is_significant(r) and not small for r, small in zip(correlations, unseen, strict=True)]
    majority = sum(sure) >= 0.5 * (len(trials) - sum(unseen))
    if majority and _depends(share, chance):
        usual = float(np.median([float(r[0]) for r, small in zip(correlations, unseen, strict=True) if not small]))
        follows = [
            small or significant or float(r[0]) > usual - _SCATTER * float(r[1:].std())
            for r, significant, small in zip(correlations, sure, unseen, strict=True)
        ]
    else:
        sure_parts = [part for part, kept in zip(parts, sure, strict=True) if kept]
        enough = len(sure_parts) >= max(len(trials) / 2, 2) and _depends(*_held_out_share(sure_parts)[:2])
        follows = sure if enough else [False] * len(trials)
    return tuple(follows)


def _depends(share: float, chance: float) -> bool:
    return share > _SURELY or share > max(chance, 0.0)


def _is_significant(correlations: Vec) -> bool:
    """Whether the correlation of a trial is large, or significant against its null distribution (1 + D,)."""
    recorded = float(correlations[0])
    return recorded > math.sqrt(_SURELY) or recorded > float(np.quantile(correlations[1:], 1 - _LEVEL, method="higher"))


def _little_motion(parts: Sequence[_TrialSums], expected: Sequence[Mat]) -> list[bool]:
    sizes = [float(w[:, 0] @ p.gram @ w[:, 0]) / p.samples for p, w in zip(parts, expected, strict=True)]
    return [size < _EXPECTED**2 * float(np.mean(sizes)) for size in sizes]


def _parts(trials: Sequence[Trial], seed: int) -> list[_TrialSums]:
    random = np.random.default_rng(seed)
    parts = []
    for trial, features in zip(trials, past_features(trials), strict=True):
        lag = _lag(trial.command)
        width = max(lag // _PER_LAG, 1)
        steps = max(round(lag / width), 1)
        x, y = (_changes(signal, width, steps) for signal in (features, trial.angle[:, None]))
        length = max(min(2 * steps, len(y) // _LEAST_BLOCKS), 1)
        shown = [y[:, 0], *(y[_reordered(len(y), length, random), 0] for _ in range(_DRAWS))]
        edges = np.linspace(0, len(y), _PARTS + 1 if len(trials) == 1 else 2).astype(np.intp).tolist()
        parts += [_part(x[a:b], [order[a:b] for order in shown], width) for a, b in itertools.pairwise(edges)]
    return parts


def _part(x: Mat, shown: Sequence[Vec], width: int) -> _TrialSums:
    products = np.stack([changes @ x for changes in shown], axis=1)
    return _TrialSums(
        width * x.T @ x, width * products, width * np.array([changes @ changes for changes in shown]), width * len(x)
    )


def _lag(command: Vec) -> int:
    """Samples after which the mean square change of a command reaches its variance, at most an eighth of it."""
    most = max(command.size // _LEAST_BLOCKS, 1)
    u = command - command.mean()
    together = autocorrelation(u, most + 1)[1:] / np.arange(u.size - 1, u.size - 1 - most, -1)
    reached = np.flatnonzero(2 * (float(np.mean(u**2)) - together) >= float(np.mean(u**2)))
    return int(reached[0]) + 1 if reached.size else most


def _changes(signal: Mat, width: int, steps: int) -> Mat:
    """Changes over `steps` of the means over `width` samples, about their mean."""
    count = len(signal) // width
    means = signal[: count * width].reshape(count, width, -1).mean(axis=1)
    changes = means[steps:] - means[:-steps]
    return np.asarray(changes - changes.mean(axis=0), dtype=np.float64)


def _reordered(size: int, length: int, random: np.random.Generator) -> NDArray[np.intp]:
    blocks = max(size // length, 1)
    block = np.roll(np.arange(size) * blocks // size, int(random.integers(size)))
    return np.argsort(random.permutation(blocks)[block], kind="stable")


def _held_out_share(parts: Sequence[_TrialSums]) -> tuple[float, float, list[Mat]]:
    """Explained share, its quantile by chance, and the weights (F, 1 + D) for each part, fitted to the others."""
    gram, products = np.sum([p.gram for p in parts], axis=0), np.sum([p.products for p in parts], axis=0)
    energy = np.maximum(np.sum([p.energy for p in parts], axis=0), 1e-300)
    best, kept = np.full(energy.size, -np.inf), list[Mat]()
    for ridge in _RIDGES:
        left, weights = np.zeros_like(energy), list[Mat]()
        for part in parts:
            rest = gram - part.gram
            damping = ridge * float(np.trace(rest)) / len(rest) + 1e-12
            coefficients = np.linalg.solve(rest + damping * np.eye(len(rest)), products - part.products)
            product, square = coefficients * part.products, coefficients * (part.gram @ coefficients)
            left += part.energy - 2 * np.sum(product, axis=0) + np.sum(square, axis=0)
            weights.append(coefficients)
        share = 1 - left / energy
        if share[0] > best[0]:
            kept = weights
        best = np.maximum(best, share)
    return float(best[0]), float(np.quantile(best[1:], 1 - _LEVEL, method="higher")), kept


def _likeness(part: _TrialSums, weights: Mat) -> Vec:
    """Correlation of a part's changes, recorded and permuted (1 + D,), with predicted ones; 0 if either is zero."""
    expected = weights[:, 0]
    size = np.sqrt(max(float(expected @ part.gram @ expected), 0.0) * np.maximum(part.energy, 0.0))
    return np.divide(expected @ part.products, size, out=np.zeros_like(size), where=size > 1e-12)
