"""Trials as runs of an identification: starts, errors in blocks, checks and metadata of a trial set."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hystmpc.trials.check import LEAST_SAMPLES
from hystmpc.trials.errors import FitError
from hystmpc.trials.segments import first_flexure_end
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Index, Mask, Vec

from ..contract.metadata import DeviceLimits, InitialRule, ModelMetadata, Range
from ..start import Box, Runs, TrialStart, estimated_start, trial_start

_GROUP = 32768  # samples in a group of runs: some MB of derivatives


@dataclass(frozen=True, eq=False)
class Run:
    """Trial with its start, history and scored samples.

    Attributes:
        command, angle: (T,) [cmd], [deg].
        rest_command, rest_angle: command and angle of the rest before [cmd], [deg].
        counts: samples that are scored (T,).
        bent_before: greatest command of all trials recorded before [cmd]; the rest command for the first.
        clock_s: time recorded before this trial [s].
        correction: angle of the nominal simulator less that of the chain that represents it (T,) [deg]; zero for a
            chain.
        lead: first samples of a trial in motion, used only to estimate its start.
        approach: commands between the rest and the first sample, see `TrialStart`.
        inputs: measured inputs (T,) by name.
    """

    name: str
    command: Vec
    angle: Vec
    dt_s: float
    rest_command: float
    rest_angle: float
    counts: NDArray[np.bool_]
    bent_before: float
    clock_s: float
    correction: Vec
    lead: int = 0
    approach: tuple[float, ...] = ()
    inputs: Mapping[str, Vec] = field(default_factory=dict)

    @property
    def start(self) -> TrialStart:
        """Start of the run, see `models.start`."""
        return TrialStart(self.rest_command, self.rest_angle, self.lead, self.approach)

    def begun(self, runs: Runs, box: Box, held: int) -> Run:
        """Run with the start estimated by a model (`estimated_start`), held there for `held` samples."""
        start = estimated_start(self.start, self.command, self.angle - self.correction, self.dt_s, box, runs)
        if self.approach and start.at_rest:
            return self
        approach = (*((start.command,) * held), *start.approach)
        return replace(self, rest_command=start.command, rest_angle=start.angle, approach=approach)

    @cached_property
    def scored(self) -> slice | NDArray[np.bool_]:
        """Index of the scored samples: a slice, which copies nothing, where they are contiguous."""
        spans = spans_of(self.counts)
        return slice(*spans[0]) if len(spans) == 1 else self.counts

    def blocks(self, seconds: float) -> NDArray[np.intp]:
        """Block number of each counted sample."""
        length = max(round(seconds / self.dt_s), 1)
        return np.flatnonzero(self.counts) // length


def spans_of(counts: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First sample and end of each stretch of samples that count (T,)."""
    edges = np.flatnonzero(np.diff(counts, prepend=False, append=False)).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def end_to_end(signals: Sequence[Vec]) -> tuple[Vec, Index]:
    """Concatenated signals (T,), and the first sample of each followed by T (N + 1,)."""
    return np.concatenate(signals), np.cumsum([0, *(signal.size for signal in signals)])


@dataclass(frozen=True, eq=False)
class RunsTogether:
    """N runs of one rate, concatenated for one call of the simulation, T samples in all.

    Attributes:
        command: of all runs with their approaches (A,).
        first: first sample of each run, followed by A (N + 1,).
        recorded: samples among these that belong to the trials (T,).
        angle, correction: of all trials (T,), see `Run`.
        begin: first sample of each trial, followed by T (N + 1,).
        spans: first sample and end of each stretch that is scored.
        inputs: of all runs with their approaches (A,) each, those that every run has.
    """

    runs: tuple[Run, ...]
    command: Vec
    first: Index
    recorded: slice | Mask
    angle: Vec
    correction: Vec
    begin: Index
    spans: list[tuple[int, int]]
    inputs: Mapping[str, Vec]

    @classmethod
    def of(cls, runs: Sequence[Run]) -> RunsTogether:
        """Concatenate runs."""
        command, first = end_to_end([np.concatenate([run.approach, run.command]) for run in runs])
        angle, begin = end_to_end([run.angle for run in runs])
        recorded: slice | Mask = slice(None)
        if command.size > angle.size:
            recorded = np.concatenate([np.arange(-len(run.approach), run.command.size) >= 0 for run in runs])
        correction = np.concatenate([run.correction for run in runs])
        spans = spans_of(np.concatenate([run.counts for run in runs]))
        inputs = {
            name: np.concatenate([np.pad(run.inputs[name], (len(run.approach), 0), mode="edge") for run in runs])
            for name in runs[0].inputs
            if all(name in run.inputs for run in runs)
        }
        return cls(tuple(runs), command, first, recorded, angle, correction, begin, spans, inputs)

    @classmethod
    def groups(cls, runs: Sequence[Run]) -> tuple[RunsTogether, ...]:
        """Concatenate runs in groups whose derivatives fit in a processor's cache."""
        groups, size = list[list[Run]](), _GROUP
        for run in runs:
            size += run.command.size
            if size > _GROUP:
                groups.append([])
                size = run.command.size
            groups[-1].append(run)
        return tuple(cls.of(group) for group in groups)

    @property
    def dt_s(self) -> float:
        """Sample time [s]."""
        return self.runs[0].dt_s

    @property
    def rests(self) -> tuple[Vec, Vec]:
        """Commands (N,) [cmd] and angles (N,) [deg] at rest before the runs."""
        command, angle = np.array([(run.rest_command, run.rest_angle) for run in self.runs]).T
        return command, angle

    @property
    def first_inputs(self) -> Mapping[str, Vec]:
        """Measured inputs (N,) at the first samples of the runs, and before them."""
        return {name: values[self.first[:-1]] for name, values in self.inputs.items()}

    def each(self) -> Iterator[tuple[Run, slice]]:
        """Runs with their slices."""
        for run, a, b in zip(self.runs, self.begin[:-1].tolist(), self.begin[1:].tolist(), strict=True):
            yield run, slice(a, b)


@dataclass(frozen=True)
class Before:
    """History of a device at the begin of a trial.

    Attributes:
        bent: greatest command of all trials recorded before [cmd]; minus infinity for the first.
        clock_s: time recorded before [s].
    """

    bent: float = -np.inf
    clock_s: float = 0.0

    def scaled(self, factor: float) -> Before:
        """History with commands multiplied by a factor."""
        return Before(factor * self.bent, self.clock_s)

    @classmethod
    def each(cls, trials: Sequence[Trial]) -> tuple[Before, ...]:
        """History before every trial, in recording order."""
        clocks = [cls()]
        for trial in trials:
            last = clocks[-1]
            bent = max(last.bent, float(trial.command.max()))
            clocks.append(cls(bent, last.clock_s + trial.duration_s + trial.dt))
        return tuple(clocks[:-1])


def runs_of(
    trials: Sequence[Trial],
    corrections: Sequence[Vec] | None = None,
    before: Sequence[Before] | None = None,
    starts: Sequence[TrialStart] | None = None,
) -> tuple[Run, ...]:
    """Runs of trials in recording order, uniformly sampled; every sample counts except the lead of a trial in motion.

    Args:
        before: of each trial, where trials in between were left out.
        starts: of each trial, where they are known from its samples at another rate.
    """
    runs: list[Run] = []
    before = Before.each(trials) if before is None else before
    for k, trial in enumerate(trials):
        command = np.ascontiguousarray(trial.command)
        start = starts[k] if starts else trial_start(trial.command, trial.angle, trial.dt, trial.inverted)
        runs.append(
            Run(
                name=trial.source,
                command=command,
                angle=np.ascontiguousarray(trial.angle),
                dt_s=trial.dt,
                rest_command=start.command,
                rest_angle=start.angle,
                counts=np.arange(len(trial)) >= start.lead,
                bent_before=max(before[k].bent, float(command[0])),
                clock_s=before[k].clock_s,
                correction=np.zeros(len(trial)) if corrections is None else corrections[k],
                lead=start.lead,
                inputs=dict(trial.inputs),
            )
        )
    return tuple(runs)


def runs_to_fit(trials: Sequence[Trial], skip_first_flexure: bool, lead_s: float = 0.0) -> tuple[Run, ...]:
    """Runs of trials whose first `lead_s` and, where skipped, first flexure do not count."""
    made = []
    for trial, run in zip(trials, runs_of(trials), strict=True):
        first = max(first_flexure_end(trial) if skip_first_flexure else 0, round(lead_s / trial.dt))
        made.append(replace(run, counts=run.counts & (np.arange(len(trial)) >= first)))
    return tuple(made)


_BLOCK_S = 3.0


@dataclass(frozen=True, eq=False)
class Blocks:
    """Squared errors in blocks; blocks without a sample are left out.

    Attributes:
        energy: sum of squared errors of each block (B,) [deg^2].
        samples: of each block (B,).
        run: number of the run that each belongs to (B,).
    """

    energy: Vec
    samples: Vec
    run: NDArray[np.intp]

    @property
    def mse(self) -> float:
        """Mean square error [deg^2]."""
        return float(self.energy.sum() / self.samples.sum())


def blocks_of(errors: Sequence[Vec], runs: Sequence[Run]) -> Blocks:
    """Errors (C,) of the counted samples of each run, in blocks of three seconds."""
    energy, samples, owner = [], [], []
    for k, (error, run) in enumerate(zip(errors, runs, strict=True)):
        blocks = run.blocks(_BLOCK_S)
        blocks = blocks - blocks.min()
        energy.append(np.bincount(blocks, error**2).astype(np.float64))
        samples.append(np.bincount(blocks).astype(np.float64))
        owner.append(np.full(energy[-1].size, k))
    filled = np.concatenate(samples) > 0
    return Blocks(np.concatenate(energy)[filled], np.concatenate(samples)[filled], np.concatenate(owner)[filled])


def fingerprint(trials: Sequence[Trial]) -> str:
    """SHA-256 over time, command, angle and measured inputs of all trials, in order."""
    digest = hashlib.sha256()
    for trial in trials:
        for signal in (trial.t, trial.command, trial.angle, *trial.inputs.values()):
            digest.update(np.ascontiguousarray(signal).tobytes())
    return digest.hexdigest()


def ordered(trials: Sequence[Trial]) -> list[Trial]:
    """Trials by the mean speed of their commands, equal ones by their angles: an order that no list of files changes.

    Folds take every third trial (`CrossValidation.folds`): slow and fast ones are then in each. Units do not count.
    """

    def key(trial: Trial) -> tuple[float, list[float], list[float]]:
        speed = float(np.abs(np.diff(trial.command)).sum()) / (len(trial) * trial.dt)
        return float(f"{speed:.6g}"), trial.angle.tolist(), trial.command.tolist()

    return sorted(trials, key=key)


def command_range(trials: Sequence[Trial]) -> Range:
    """Least and greatest command [cmd]."""
    return Range(lower=float(min(t.command.min() for t in trials)), upper=float(max(t.command.max() for t in trials)))


def angle_range(trials: Sequence[Trial]) -> Range:
    """Least and greatest angle [deg]."""
    return Range(lower=float(min(t.angle.min() for t in trials)), upper=float(max(t.angle.max() for t in trials)))


def fastest_command(trials: Sequence[Trial]) -> float:
    """Greatest speed of the command [cmd/s]."""
    return float(max(np.max(np.abs(np.diff(t.command)) / np.diff(t.t)) for t in trials))


def check_trial_set(trials: Sequence[Trial]) -> float:
    """Common sample time of trials that can be fitted together [s].

    Raises:
        FitError: if there is no trial, one is too short, sample times or units differ, or command or angle is constant.
    """
    if not trials:
        raise FitError("got no trials, expected at least one")
    dt, units = float(f"{trials[0].dt:.10g}"), trials[0].units  # 0.04, not the difference of two time stamps
    for trial in trials:
        if len(trial) < LEAST_SAMPLES:
            raise FitError(f"{trial.source}: {len(trial)} samples, expected at least {LEAST_SAMPLES}")
        if abs(trial.dt - dt) > 1e-3 * dt:
            raise FitError(
                f"{trial.source}: sampled every {trial.dt:.6g} s, expected {dt:.6g} s as {trials[0].source}; "
                "resample all to one rate (`--rate-hz`)"
            )
        if trial.units != units:
            raise FitError(f"{trial.source}: units {trial.units}, expected {units} as {trials[0].source}")
        for name, signal in (("command", trial.command), ("angle", trial.angle)):
            if np.ptp(signal) <= 1e-9 * float(np.max(np.abs(signal))):
                raise FitError(f"{trial.source}: the {name} is constant at {signal[0]:.6g}, expected a motion")
    return dt


Fact = str | float | int | bool


def facts_of(
    kind: str,
    trials: Sequence[Trial],
    limits: DeviceLimits,
    rules: tuple[InitialRule, InitialRule],
    warmup_samples: int,
    training: Mapping[str, Fact],
) -> ModelMetadata:
    """Metadata of a model identified on `trials`, with their ranges, fingerprint and names.

    Args:
        limits: limits of the command; the range in the trials where left out.
        rules: `initial` and `conditioned`.

    Raises:
        FitError: on unusable trials.
        ModelError: if they are beyond the bounds of a model file.
    """
    dt, trained = check_trial_set(trials), command_range(trials)
    return ModelMetadata.of(
        kind=kind,
        dt_s=dt,
        command_unit=trials[0].units.command,
        angle_unit=trials[0].units.angle,
        inverse=trials[0].inverted,
        command_limits=limits.command or trained,
        command_rate=limits.rate_per_s or fastest_command(trials),
        trained_command=trained,
        trained_angle=angle_range(trials),
        trained_rate=fastest_command(trials),
        initial=rules[0],
        conditioned=rules[1],
        warmup_samples=warmup_samples,
        training_data_hash=fingerprint(trials),
        training={**training, "logs": ", ".join(Path(trial.source).name for trial in trials)},
    )


def fixed_rule(state: Vec) -> InitialRule:
    """Initial rule of a state (S,) that does not depend on the measured angle."""
    return InitialRule(offset=tuple(state.tolist()), slope=(0.0,) * state.size)


AS_IT_IS: Vec = np.ones(1)
"""The filter that changes nothing."""
_PAST = 6
_RIDGE = 1e-9


def whitening(errors: Sequence[Vec]) -> Vec:
    """Prediction-error filter (P + 1,), whose output is the unpredictable part of the errors.

    e_k - a_1 e_{k-1} - ... - a_P e_{k-P}, P = 6, with a of least squares over all runs: a slow model-form error is
    removed, and noise remains.

    Source: Cochrane and Orcutt, Application of least squares regression to relationships containing auto-correlated
    error terms, J. Am. Stat. Assoc. 44 (1949).
    """
    past = np.concatenate([np.lib.stride_tricks.sliding_window_view(e[:-1], _PAST)[:, ::-1] for e in errors])
    square = past.T @ past
    square += _RIDGE * max(float(np.trace(square)), _RIDGE) * np.eye(_PAST)
    a = np.linalg.solve(square, past.T @ np.concatenate([e[_PAST:] for e in errors]))
    return np.concatenate([[1.0], -a])


def whitened(signal: Vec, white: Vec) -> Vec:
    """Filtered signal (T, ...) of one run; zero in the first samples, which lack a past. A filter begins with 1."""
    if white.size == 1:
        return signal
    past, left = white.size - 1, np.zeros_like(signal)
    for k, weight in reversed(list(enumerate(white.tolist()))):
        left[past:] += weight * signal[past - k : max(len(signal) - k, 0)]
    return left
