"""Design of the next motion, from a menu or by a search, so that it best separates the open hypotheses."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import differential_evolution
from scipy.special import ndtr

from hystmpc.trials.csv_files import format_table
from hystmpc.trials.errors import FitError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.layouts import OUTPUT_COLUMN, command_column
from hystmpc.trials.recording import SEPARATION_COLUMN
from hystmpc.trials.types import Vec

from ..diagnosis import MOTION_FILE, NextMotion
from .motions import SIZE, MotionFamily, SampledMotion

Simulate = Callable[[Vec, float], Vec]

_EQUAL_FACTOR, _EQUAL_ERRORS = 1.05, 0.005  # equal probabilities: error up to this factor, plus this, of the least
_FORM_SPREAD = 2.0  # root of the number of directions that a model-form error may take
_SHIFT, _SCALE = 0.01, 0.01  # of the command's range, and of the command


@dataclass(frozen=True)
class OpenHypothesis:
    """Hypothesis that the logs do not reject, as a fitted simulator.

    Attributes:
        simulate: command (T,) [mm or bar] and sample time [s] to angle (T,) [deg], from rest.
        retunings: simulators with a small change of one parameter each, whose differences do not count as separation;
            if empty, the angle one sample later replaces them.
    """

    name: str
    simulate: Simulate
    retunings: Sequence[Simulate] = ()


@dataclass(frozen=True)
class Noise:
    """Noise model, AR(1) plus white, and model-form error, as the unit of separations.

    Noise averages out over a motion. The model-form error between device and equations is the same in every recording,
    and may point from one candidate to another.

    Attributes:
        rmse_deg: standard deviation of the noise [deg].
        ar: correlation of its slow part from one sample to the next.
        white: share of its variance without memory.
        form_deg: root mean square of the model-form error [deg].
    """

    rmse_deg: float
    ar: float = 0.95
    white: float = 0.3
    form_deg: float = 0.0

    def whiten(self, signals: Vec) -> Vec:
        """Whiten signals (..., T): divide each frequency by the root of the noise's spectrum."""
        samples = signals.shape[-1]
        unit = np.exp(-2j * np.pi * np.fft.rfftfreq(samples))
        spectrum = (1 - self.white) * (1 - self.ar**2) / np.abs(1 - self.ar * unit) ** 2 + self.white
        whitened = np.fft.rfft(signals) / (self.rmse_deg * np.sqrt(spectrum))
        return np.asarray(np.fft.irfft(whitened, samples))


@dataclass(frozen=True, eq=False)
class EvaluatedMotion:
    """One motion of the menu and its expected result.

    Attributes:
        probability: expected probability of naming the right candidate.
        angles: of every candidate on it [deg], (K, T).
        separation: greatest difference of a pair after retuning at each sample [deg], (T,).
        distances: of candidate i from candidate j retuned to it, in units of the noise, (K, K).
    """

    motion: SampledMotion
    probability: float
    angles: Vec
    separation: Vec
    distances: Vec


@dataclass(frozen=True, eq=False)
class MotionProposal:
    """Proposed motion of the next recording.

    Attributes:
        options: every motion that could be simulated, in the order of the menu.
    """

    names: tuple[str, ...]
    chosen: EvaluatedMotion
    options: tuple[EvaluatedMotion, ...] = field(repr=False)

    def summary(self) -> NextMotion:
        """Summary of the proposal for the diagnosis."""
        motion = self.chosen.motion
        return NextMotion(MOTION_FILE, self.names, self.chosen.probability, motion.duration_s)


def propose(candidates: Sequence[OpenHypothesis], motions: Sequence[SampledMotion], noise: Noise) -> MotionProposal:
    """Choose the motion that most probably names the right candidate; at about equal probability the shortest.

    With candidate i true and j retuned to it, the remaining difference r_ij favours i with probability P_ij = Phi(d_ij
    / 2), the hit rate for two known signals in Gaussian noise, with

        1 / d_ij^2 = 1 / |r_ij|^2 + (form / (2 rms r_ij))^2,

    |r_ij| whitened, in units of the noise, and a form error that lies in any of four directions. Pairs are combined by
    P_i = 1 / (sum_{j != i} 1 / P_ij - (K - 2)) (Price, Knerr, Personnaz, Dreyfus, NIPS 1994); all candidates are
    equally likely. Retuning is linear least squares on offset, gain, command shift, command scale and the candidate's
    own parameters.

    Raises:
        FitError: if there is no motion on which all candidates give finite angles.
    """
    options = tuple(option for motion in motions if (option := evaluate_motion(candidates, motion, noise)))
    if not options:
        raise FitError(f"next motion: none of {len(motions)} motions gives finite angles with all candidates")
    fewest = min(1 - option.probability for option in options)
    close = [option for option in options if 1 - option.probability <= _EQUAL_FACTOR * fewest + _EQUAL_ERRORS]
    chosen = min(close, key=lambda option: (option.motion.duration_s, -option.probability))
    return MotionProposal(tuple(candidate.name for candidate in candidates), chosen, options)


def expected_probability(distances: ArrayLike) -> float:
    """Mean probability of the right candidate from distances (K, K) in units of the noise; 1 / K if all are zero."""
    d = np.asarray(distances, dtype=np.float64)
    inverse = 1 / ndtr(d / 2)
    np.fill_diagonal(inverse, 0.0)
    return float(np.mean(1 / (inverse.sum(axis=1) - (d.shape[0] - 2))))


def separations(candidates: Sequence[OpenHypothesis], command: Vec, dt: float) -> tuple[Vec, list[Vec]]:
    """Angles (K, T) of the candidates, and the possible directions (P, T) of each one's retuning [deg]."""
    angles = np.array([candidate.simulate(command, dt) for candidate in candidates])
    directions = [_retuning_directions(c, angle, command, dt) for c, angle in zip(candidates, angles, strict=True)]
    return angles, directions


def write_motion(path: Path | str, proposal: MotionProposal, command_unit: str = "mm", unit: str = "deg") -> Path:
    """Write the motion in canonical columns of these units.

    The angle is the expected angle, the mean of the candidates, so that the file also serves as a sampled reference;
    `separation_deg` is the difference of the candidates after retuning.
    """
    chosen = proposal.chosen
    columns = {
        "time_s": np.round(chosen.motion.t, 9),
        command_column(command_unit): chosen.motion.command,
        OUTPUT_COLUMN[unit]: chosen.angles.mean(axis=0),
        SEPARATION_COLUMN: chosen.separation,
    }
    return write_atomically(path, format_table(columns))


def evaluate_motion(
    candidates: Sequence[OpenHypothesis], motion: SampledMotion, noise: Noise
) -> EvaluatedMotion | None:
    """Expected result of one motion; None if a simulator gives angles that are not finite."""
    angles, directions = separations(candidates, motion.command, motion.dt)
    if not all(np.isfinite(part).all() for part in (angles, *directions)):
        return None
    count, separation = len(candidates), np.zeros(motion.t.size)
    distances = np.zeros((count, count))
    for j, basis in enumerate(directions):
        others = [i for i in range(count) if i != j]
        left = _unexplained(angles[others] - angles[j], basis, noise)
        distances[others, j] = _distance(left, noise)
        separation = np.maximum(separation, np.abs(left).max(axis=0))
    return EvaluatedMotion(motion, expected_probability(distances), angles, separation, distances)


def _distance(left: Vec, noise: Noise) -> Vec:
    still = left - left.mean(axis=-1, keepdims=True)
    seen = np.linalg.norm(noise.whiten(still), axis=-1)
    form = noise.form_deg / (_FORM_SPREAD * np.maximum(np.sqrt(np.mean(still**2, axis=-1)), 1e-300))
    return np.asarray(seen / np.sqrt(1 + (seen * form) ** 2))


def _retuning_directions(candidate: OpenHypothesis, angle: Vec, command: Vec, dt: float) -> Vec:
    """Changes of the angle [deg] that the candidate's retuning can make, one per row."""
    low, span = float(command.min()), float(np.ptp(command))
    shifted = np.maximum(command - _SHIFT * span, low)
    scaled = low + (1 - _SCALE) * (command - low)
    changed = [candidate.simulate(shifted, dt), candidate.simulate(scaled, dt)]
    retuned = [simulate(command, dt) for simulate in candidate.retunings]
    if not candidate.retunings:
        retuned = [np.concatenate((angle[:1], angle[:-1]))]
    return np.array([np.ones_like(angle), angle, *(np.asarray(other) - angle for other in (*changed, *retuned))])


def _unexplained(targets: Vec, basis: Vec, noise: Noise) -> Vec:
    """Residual of `targets` (N, T) after a least-squares fit of the basis (P, T), in units of the noise."""
    weighted = noise.whiten(basis)
    norms = np.linalg.norm(weighted, axis=1)
    moves = norms > 1e-9
    if not moves.any():
        return targets
    scaled = weighted[moves].T / norms[moves]
    weights = np.linalg.lstsq(scaled, noise.whiten(targets).T, rcond=1e-9)[0]
    return targets - weights.T @ (basis[moves] / norms[moves, None])


_DRAWN, _GENERATIONS = 12, 8  # members in addition to the menu's 12; about 200 motions per search
_LEAST_S = 6.0  # a shorter motion is not worth a separate run


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the motion search.

    Attributes:
        overhead_s: device time of a run in addition to its motion [s].
        least_s: least duration of a motion [s].
        allowed: whether a motion may be played, from the angles that the hypotheses predict.
    """

    seed: int | Sequence[int] = 0
    overhead_s: float = 0.0
    least_s: float = _LEAST_S
    generations: int = _GENERATIONS
    allowed: Callable[[EvaluatedMotion], bool] = lambda option: True


@dataclass(frozen=True, eq=False)
class SearchedMotion:
    """Result of a motion search, with the best motion of the menu for comparison.

    Attributes:
        numbers: of the motion in the family (22,).
        seconds: device time of the motion, including the overhead of its run [s].
        menu: the best motion of the menu by the same measure; None if none can be simulated.
        menu_bits, menu_seconds: information and device time of that one.
    """

    chosen: EvaluatedMotion
    numbers: Vec = field(repr=False)
    bits: float
    seconds: float
    menu: EvaluatedMotion | None = field(repr=False)
    menu_bits: float
    menu_seconds: float
    looked_at: int

    @property
    def gain(self) -> float:
        """Ratio of information per second to that of the menu's best; infinite if that has no information."""
        rate, menu_rate = self.bits / self.seconds, self.menu_bits / self.menu_seconds if self.menu else 0.0
        return rate / menu_rate if menu_rate > 0 else math.inf


def information_bits(probability: float, count: int) -> float:
    """Expected information on which of `count` equally likely explanations is true: log2(count p), 0 by chance."""
    return max(math.log2(max(count * probability, 1.0)), 0.0)


def search_motion(
    hypotheses: Sequence[OpenHypothesis],
    family: MotionFamily,
    noise: Noise,
    settings: SearchSettings = SearchSettings(),
    menu: Sequence[SampledMotion] = (),
) -> SearchedMotion | None:
    """Search the motion with the most expected information per second on which hypothesis is true.

    Maximises log2(K p(x)) / (T(x) + T_run) over the numbers x of the family, p the expected probability of the right
    one of K explanations after retuning each (`propose`). Differential evolution (Storn, Price, J. Global Optimization
    11, 1997) starts from the menu's entries and motions drawn at random.

    Args:
        menu: motions of any duration to compare with, from `motions.menu`.

    Returns:
        The motion; None if no allowed motion can be simulated.
    """
    count = len(hypotheses)
    best: list[tuple[float, EvaluatedMotion, Vec]] = []
    looked = [0]

    def value_of(motion: SampledMotion) -> tuple[float, EvaluatedMotion | None]:
        looked[0] += 1
        option = evaluate_motion(hypotheses, motion, noise)
        if option is None or not settings.allowed(option):
            return -1.0, None
        if motion.duration_s < settings.least_s:
            return motion.duration_s / settings.least_s - 1.0, None
        return _rate(option, count, settings), option

    def cost(x: Vec) -> float:
        value, option = value_of(family.motion(x, "designed"))
        if option is not None and (not best or value > best[0][0]):
            best[:] = [(value, option, x.copy())]
        return -value

    _evolve(cost, family, settings)
    if not best:
        return None
    options = [option for motion in menu if (option := evaluate_motion(hypotheses, motion, noise))]
    compared = max(options, key=lambda option: _rate(option, count, settings), default=None)
    chosen = best[0][1]
    return SearchedMotion(
        chosen=chosen,
        numbers=best[0][2],
        bits=information_bits(chosen.probability, count),
        seconds=chosen.motion.duration_s + settings.overhead_s,
        menu=compared,
        menu_bits=information_bits(compared.probability, count) if compared else 0.0,
        menu_seconds=compared.motion.duration_s + settings.overhead_s if compared else math.nan,
        looked_at=looked[0],
    )


def _rate(option: EvaluatedMotion, count: int, settings: SearchSettings) -> float:
    return information_bits(option.probability, count) / (option.motion.duration_s + settings.overhead_s)


def _evolve(cost: Callable[[Vec], float], family: MotionFamily, settings: SearchSettings) -> None:
    drawn = np.random.default_rng(settings.seed).uniform(0, 1, (_DRAWN, SIZE))
    first = np.vstack([*family.starts.values(), drawn])
    cast(Any, differential_evolution)(  # its types take no array for `init`
        cost,
        [(0.0, 1.0)] * SIZE,
        init=first,
        maxiter=settings.generations,
        rng=np.random.default_rng(settings.seed),
        mutation=(0.4, 0.9),
        recombination=0.5,
        polish=False,
        tol=0.0,
    )
