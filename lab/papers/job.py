"""Jobs of a study: model to be trained, exported and scored; trials, training and results."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.contract.load import OnnxModel, load_onnx
from hystmpc.models.evaluate import Errors, TrialEvaluation, evaluate
from hystmpc.models.identify.runs import fingerprint
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest, Identified
from hystmpc.models.kinds.networks import NetworkKind
from hystmpc.models.networks.settings import NetworkSettings
from hystmpc.models.train.networks import fit_network, network_bundle
from hystmpc.trials.errors import ConfigError, FitError, LogError
from hystmpc.trials.read import expand_logs, read_trials
from hystmpc.trials.trial import Trial, resample
from hystmpc.trials.types import Vec

from ..rivals.kinds import FeedForwardSettings
from ..study import Outcome, Result
from .settings import NETWORKS, PAPER_PRESETS, QUICK_SCALE, DirectionName, PaperSettings

Splits = Mapping[str, tuple[Trial, ...]]
LOGS = "logs"
"""The one split of the study on recorded logs."""
_FEWEST_LOGS = 2
_QUICK_TRIALS = {"train": 2, "val": 1, "test": 3}
_QUICK_SAMPLES, _QUICK_S = 600, 5.0  # whichever is longer: a command has to turn in it


@dataclass(frozen=True)
class TrainingJob:
    """Training of one model; with the trials of its `TrainingTask` it determines the result.

    Attributes:
        direction: `inverse` swaps command and angle of every trial.
        train: name of the training set: `sin`, `p2p`, `mixed`, `train`, or the log that is left out.
        constancy: beta of S2 eq. (12), None for the preset's.
        steps: epochs, updates or iterations; None for the preset's.
        skip_first_flexure: train without the first flexure, score with and without it.
        window: samples of a training window or a history buffer, see `WINDOWS`; None for the preset's.
    """

    stage: str
    kind: str
    preset: str
    direction: DirectionName
    train: str
    constancy: float | None
    seed: int
    steps: int | None
    skip_first_flexure: bool = False
    window: int | None = None

    @property
    def key(self) -> str:
        """Name of the job's files: unique in a study."""
        parts = [self.stage, self.kind, self.preset, self.direction, re.sub(r"[^\w.]+", "_", self.train)]
        parts += [] if self.constancy is None else [f"b{self.constancy:g}"]
        parts += [] if self.window is None else [f"w{self.window}"]
        return "-".join([*parts, f"s{self.seed}"])

    @property
    def request(self) -> FitRequest:
        """Job as a request to a kind of model; validation trials are added by the worker."""
        return FitRequest(
            training=self.preset,
            seed=self.seed,
            steps=self.steps,
            constancy_weight=self.constancy,
            skip_first_flexure=self.skip_first_flexure,
        )


@dataclass(frozen=True, eq=False)
class TrainingTask:
    """Job with its trials, command to angle whatever the job's direction.

    Attributes:
        before: what the one test trial's log holds before it, see `before`.
    """

    job: TrainingJob
    training: tuple[Trial, ...]
    validation: tuple[Trial, ...]
    tests: Splits
    before: Trial | None = None

    @property
    def key(self) -> str:
        """Key of the job."""
        return self.job.key

    @property
    def samples(self) -> int:
        """Samples to train on."""
        return sum(len(trial) for trial in self.training)

    @property
    def inputs(self) -> list[Any]:
        """Inputs that determine the result: the job's settings and all its trials."""
        parts = {"training": self.training, "validation": self.validation} | dict(self.tests)
        parts |= {"before": (self.before,)} if self.before else {}
        hashes = {name: fingerprint(trials) for name, trials in parts.items()}
        names = {name: [trial.source for trial in trials] for name, trials in parts.items()}
        return [asdict(self.job), hashes, names]


def preset_for(kind: str, asked: str, paper: str = "paper") -> str:
    """Requested preset, or the kind's first preset if it has none of that name.

    `paper` is the name of the preset that this study's paper has trained with, taken where `paper` is asked for.
    """
    presets = kind_named(kind).trainings
    wanted = paper if asked == "paper" and paper in presets else asked
    return wanted if wanted in presets else presets[0]


def betas_for(kind: str, preset: str, settings: PaperSettings) -> tuple[float | None, ...]:
    """Weights of the constancy term to train with: those of the study for networks as in the paper, else none."""
    return settings.betas if kind in NETWORKS and preset in PAPER_PRESETS else (None,)


def steps_for(kind: str, preset: str, settings: PaperSettings) -> int | None:
    """Number of training steps, None for the preset's.

    `epochs_scale` applies to networks with a paper's preset; `quick` reduces all step counts.
    """
    steps = kind_named(kind).steps(FitRequest(training=preset))
    if steps is None:
        return None
    if settings.quick:
        return max(1, round(steps * QUICK_SCALE))
    scaled = kind in NETWORKS and preset in PAPER_PRESETS and settings.epochs_scale != 1.0
    return max(1, round(steps * settings.epochs_scale)) if scaled else None


def study_splits(settings: PaperSettings) -> Splits:
    """Trials by split: those of `datasets.make_dataset` for `s1` and `s2`, one split `logs` for `real`."""
    splits: Mapping[str, tuple[Trial, ...]]
    if settings.study == "real":
        splits = {LOGS: _logs(settings)}
    else:
        from ..datasets import make_dataset

        splits = make_dataset(settings.study, settings.seed).splits
    return {name: _shortened(name, trials) for name, trials in splits.items()} if settings.quick else dict(splits)


def _logs(settings: PaperSettings) -> tuple[Trial, ...]:
    logs = expand_logs(settings.logs)
    twice = [log for log in logs if logs.count(log) > 1]
    if twice:
        raise ConfigError(f"study real: {twice[0]} is given twice, expected each log once")
    whole = (resample(t, settings.rate_hz) for t in read_trials(settings.logs, settings.layout))
    trials = tuple(part for trial in whole for part in _parts(trial, settings.parts))
    sources = [trial.source for trial in trials]
    if len(sources) < _FEWEST_LOGS:
        raise ConfigError(f"study real: got {len(sources)} log, expected at least two: each is tested on the others")
    return trials


def _parts(trial: Trial, count: int) -> list[Trial]:
    """Equal parts of a trial with different names."""
    if count == 1:
        return [trial]
    edges, path = [len(trial) * k // count for k in range(count + 1)], Path(trial.source)
    return [
        replace(trial.select(start, stop), source=str(path.with_stem(f"{path.stem}_part{k + 1}")))
        for k, (start, stop) in enumerate(pairwise(edges))
    ]


def before(trial: Trial, logs: Sequence[Trial], parts: int) -> Trial | None:
    """Recording before a trial that is one of several parts of a log; None before the first part."""
    at = next(k for k, log in enumerate(logs) if log is trial)
    earlier = logs[at - at % parts : at]
    if not earlier:
        return None
    t, command, angle = (np.concatenate([getattr(log, name) for log in earlier]) for name in ("t", "command", "angle"))
    return Trial(t, command, angle, units=trial.units, source=trial.source)


def _shortened(split: str, trials: tuple[Trial, ...]) -> tuple[Trial, ...]:
    part = split.rpartition("/")[2]
    count = _QUICK_TRIALS.get(part, len(trials) if part != LOGS else 3)
    return tuple(trial.select(0, max(_QUICK_SAMPLES, round(_QUICK_S / trial.dt))) for trial in trials[:count])


@dataclass(frozen=True)
class Score:
    """Errors of a model's free run over one trial.

    Attributes:
        errors: over the whole trial; in mm or bar for an inverse map.
        later: over the trial from the first reversal of the command on; None where that was not asked for, or the
            command never turns.
    """

    split: str
    trial: str
    errors: Errors
    later: Errors | None = None


@dataclass(frozen=True)
class JobResult(Result):
    """Outcome of one job.

    Attributes:
        message: the error of a failed job, else the fit's own report.
        history: step and best error so far, in the unit of the output.
        numbers: that the model holds: parameters of operators, weights of a network; 0 in older results.
    """

    job: TrainingJob
    samples: int
    history: tuple[tuple[int, float], ...] = ()
    scores: tuple[Score, ...] = ()
    numbers: int = 0

    def of_split(self, split: str) -> tuple[Score, ...]:
        """Scores of one split, in the order of its trials."""
        return tuple(score for score in self.scores if score.split == split)

    def figures(self, name: str, splits: Iterable[str]) -> Vec:
        """One figure of `Errors` over all trials of some splits, (N,)."""
        return np.array([getattr(score.errors, name) for split in splits for score in self.of_split(split)])


def model_file(folder: Path, job: TrainingJob) -> Path:
    """File of a job's model."""
    return folder / "models" / f"{job.key}.onnx"


@dataclass(frozen=True, eq=False)
class PaperOutcome(Outcome[PaperSettings, JobResult]):
    """Study with the results of all its jobs; the trials are given by split."""

    @property
    def presets(self) -> tuple[str, ...]:
        """Presets of the trained models, in order."""
        return tuple(dict.fromkeys(result.job.preset for result in self.results))

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of model with any result, in the order of the settings."""
        here = {result.job.kind for result in self.done}
        return (*(k for k in self.settings.kinds if k in here), *sorted(here - set(self.settings.kinds)))

    def matching(self, **wanted: object) -> tuple[JobResult, ...]:
        """Complete jobs with these settings, such as `kind="lstm", direction="forward"`."""
        return tuple(r for r in self.done if all(getattr(r.job, name) == value for name, value in wanted.items()))

    def better(self, splits: Sequence[str], **wanted: object) -> JobResult | None:
        """Of matching jobs with different beta, the one with the lowest mean RMSE over the trials of some splits.

        This is the paper's rule ("the model with lowest error is reported"): it chooses by test trials.
        """
        candidates = [result for result in self.matching(**wanted) if result.figures("rmse_deg", splits).size]
        return min(candidates, key=lambda r: float(np.mean(r.figures("rmse_deg", splits))), default=None)

    def model(self, job: TrainingJob) -> OnnxModel:
        """Model of a job, read from its file."""
        return load_onnx(model_file(self.folder, job))

    def free_run(self, job: TrainingJob, trial: Trial) -> TrialEvaluation:
        """Free run of a job's model over a trial, swapped automatically for an inverse map."""
        logs = self.drawn.get(LOGS)
        earlier = before(trial, logs, self.settings.parts) if logs else None
        return evaluate(self.model(job), trial, before=earlier)


def title_of(kind: str) -> str:
    """Name of a kind in tables."""
    return kind_named(kind).title


WINDOWS = {"lstm": (2, 10, 20, 30, 40, 50, 100), "fnn_hib": (1, 2, 10, 20, 30, 40, 50, 100)}
"""Lengths that the code of S2 compares [samples]: of a training window, and of a history buffer."""

_FIXED_S = 3.0  # to load libraries, to export and to compare
_OPERATOR_S_PER_SAMPLE = 5e-4  # least squares on free runs
_SCORING_S_PER_SAMPLE = 8e-5  # a step of a model file by onnxruntime


def fit_with_window(kind: str, trials: Sequence[Trial], request: FitRequest, window: int) -> Identified:
    """Identify with training windows (recurrent networks) or a history buffer (FNN-HIB) of `window` samples.

    Raises:
        FitError: for a kind that has neither, or as its `fit` raises.
    """
    if kind not in WINDOWS:
        raise FitError(f"{kind}: got a window of {window} samples, the window study knows {', '.join(WINDOWS)}")
    network = kind_named(kind)
    assert isinstance(network, NetworkKind)
    settings = windowed(network.training(request), window)
    trained = fit_network(trials, settings, None, request.validation)
    history = tuple((look.step, look.validation_rmse_deg) for look in trained.history)
    report = f"weights of step {trained.best_step} of {settings.steps}, {window} samples"
    return Identified(network_bundle(trained, trials, request.limits), None, history, report, trained.interrupted)


def windowed(settings: NetworkSettings, window: int) -> NetworkSettings:
    """Settings with a history buffer of another length for a feed-forward network, else with other windows."""
    data = settings.model_dump()
    if isinstance(settings.network, FeedForwardSettings):
        data["network"]["history"] = window
    else:
        data["training"]["length"] = window
    return NetworkSettings.parse(data, f"window of {window} samples")


def run_task(task: TrainingTask, settings: PaperSettings, folder: Path) -> dict[str, Any]:
    """Train, export into `folder`/models, score on every test trial; return the fields of a `JobResult`."""
    del settings  # the task holds all of them
    made, scores = _trained(task, folder)
    history = tuple((int(step), float(error)) for step, error in made.history if math.isfinite(error))
    return {"message": made.report, "history": history, "scores": scores, "numbers": _numbers(made)}


def _trained(task: TrainingTask, folder: Path) -> tuple[Identified, tuple[Score, ...]]:
    identified = _identified(task)
    if identified.interrupted:
        raise KeyboardInterrupt
    path = model_file(folder, task.job)
    path.parent.mkdir(parents=True, exist_ok=True)
    export_onnx(identified.bundle, path)
    return identified, tuple(_scores(load_onnx(path), task))


def _numbers(identified: Identified) -> int:
    if identified.simulator is not None:
        return int(identified.simulator.chain.values.size)
    graph = identified.bundle.graph() if callable(identified.bundle.graph) else identified.bundle.graph
    return sum(math.prod(tensor.dims) for tensor in graph.initializer)


def _identified(task: TrainingTask) -> Identified:
    job = task.job
    training, validation = directed(task.training, job.direction), directed(task.validation, job.direction)
    request = replace(job.request, validation=validation)
    if job.window is not None:
        return fit_with_window(job.kind, training, request, job.window)
    return kind_named(job.kind).fit(training, request)


def directed(trials: Iterable[Trial], direction: str) -> tuple[Trial, ...]:
    """Trials in a kind's direction: swapped for an inverse map."""
    return tuple(trial.swapped() if direction == "inverse" else trial for trial in trials)


def _scores(model: OnnxModel, task: TrainingTask) -> Iterable[Score]:
    for split, trials in task.tests.items():
        for trial in trials:
            later = None
            if task.job.skip_first_flexure:
                try:
                    later = evaluate(model, trial, skip_first_flexure=True, before=task.before).errors
                except LogError:  # a command that never turns has nothing after its first flexure
                    later = None
            yield Score(split, trial.source, evaluate(model, trial, before=task.before).errors, later)


def estimated_seconds(tasks: Sequence[TrainingTask], settings: PaperSettings) -> dict[str, float]:
    """Expected processor time by key of the job on this machine under its present load [s].

    Jobs of one kind, preset and constancy term on about as many samples are timed once; a quick study goes by the
    samples alone.
    """
    seconds: dict[tuple[object, ...], float | None] = {}
    expected = {}
    for task in tasks:
        job = task.job
        size = round(2 * math.log2(max(task.samples, 1)))  # half octaves
        group = job.kind, job.preset, job.steps, job.window, bool(job.constancy), size
        if not settings.quick and group not in seconds:
            seconds[group] = _training_seconds(task)
        training = seconds.get(group)
        expected[job.key] = _FIXED_S + _scoring_seconds(task)
        expected[job.key] += _OPERATOR_S_PER_SAMPLE * task.samples if training is None else training
    return expected


def _training_seconds(task: TrainingTask) -> float | None:
    job = task.job
    trials = directed(task.training, job.direction)
    request = replace(job.request, validation=directed(task.validation, job.direction))
    try:
        return kind_named(job.kind).estimate(trials, request)
    except FitError:  # the job itself will say what is wrong
        return None


def _scoring_seconds(task: TrainingTask) -> float:
    samples = sum(len(trial) for trials in task.tests.values() for trial in trials)
    return _SCORING_S_PER_SAMPLE * samples * (2 if task.job.skip_first_flexure else 1)
