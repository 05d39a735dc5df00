"""Closed-loop runs read back for a comparison: the samples along the reference, and their error without the noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hystmpc.ctrl.law import LawSettings
from hystmpc.models.load import load_model, model_path
from hystmpc.rig.config import RunSettings
from hystmpc.sim.results import load_results
from hystmpc.trajectories.trajectory import Trajectory, steps
from hystmpc.trials.errors import LogError, ModelError
from hystmpc.trials.from_outside import only_reads
from hystmpc.trials.run_folder import Column, RunFolder
from hystmpc.trials.types import Vec

_BENCH = {"transport", "sensor", "reference"}  # settings that only an experiment has
_LEAST = 10  # samples that can be compared


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """One controller along one reference, (N,) samples of the reference itself, without the way to its start.

    Attributes:
        folder: of the run.
        name: motion and controller of a simulation; empty at a bench.
        reference: what was tracked.
        settings: of the controller.
        dt_s: sample time [s].
        t: end of the sample, from the beginning of the reference [s].
        reference_deg, angle_deg: wanted and measured angle; of a simulation the true one [deg].
        noise_deg: standard deviation of the noise in that angle; None where it is not known [deg].
        led: whether the reference began with a way from where the device was.
    """

    folder: Path
    name: str
    reference: Trajectory
    settings: LawSettings
    dt_s: float
    t: Vec
    reference_deg: Vec
    angle_deg: Vec
    noise_deg: float | None
    led: bool

    @property
    def rmse_deg(self) -> float:
        """Root of mean (angle - reference)^2 - noise^2, zero where the noise exceeds the error [deg]."""
        error = (self.angle_deg - self.reference_deg)[np.isfinite(self.angle_deg)]
        return math.sqrt(max(float(np.mean(error**2)) - (self.noise_deg or 0.0) ** 2, 0.0))


@only_reads()
def measured_runs(folder: Path) -> tuple[MeasuredRun, ...]:
    """All runs of a folder of `run` or `simulate`.

    Raises:
        LogError: if it holds no such run, or one that was stopped before the end of its reference.
        ConfigError: if its settings are not those of such a run.
        TrajectoryError: if its reference cannot be made any more.
    """
    run = RunFolder.open(folder)
    if run.config().keys() >= _BENCH:
        return (_at_bench(run),)
    study = load_results(folder)
    motions = {name: motion.build() for name, motion in study.config.motions.items()}
    return tuple(
        MeasuredRun(
            folder=folder,
            name=f"{r.motion}, {r.controller}",
            reference=motions[r.motion],
            settings=study.config.controllers[r.controller].resolved(),
            dt_s=r.run.dt,
            t=r.run.log.time_s[r.run.first :] - r.run.first * r.run.dt,
            reference_deg=r.run.log.reference_deg[r.run.first :],
            angle_deg=r.run.true_deg[r.run.first :],
            noise_deg=0.0,
            led=r.run.first > 0,
        )
        for r in study.results
    )


def _at_bench(run: RunFolder) -> MeasuredRun:
    settings = RunSettings.parse(run.config(), str(run.path / "config.yaml"))
    log, reference, dt_s = run.log(), settings.reference.build(), settings.dt_s
    if gone := [name for name in ("angle_deg", "reference_deg", "sequence") if name not in log]:
        raise LogError(f"{run.path}: the log lacks {', '.join(gone)}, expected the log of a run at a bench")
    sequence = _numbers(log, "sequence").astype(np.int64)
    follows = np.flatnonzero(np.diff(sequence) == 1)  # rows whose end is the next row's beginning
    wanted, angle = _numbers(log, "reference_deg")[follows], _numbers(log, "angle_deg")[follows + 1]
    tracked = np.flatnonzero(np.isfinite(wanted))
    last = int(sequence[follows[tracked[-1]]]) if tracked.size else 0
    first = last - steps(reference.duration_s, dt_s) + 1
    if not tracked.size or int(sequence[follows[tracked[0]]]) > first:
        raise LogError(
            f"{run.path}: tracked for {tracked.size * dt_s:.3g} s, expected all {reference.duration_s:.3g} s of the "
            "reference; a run that was stopped is not compared"
        )
    rows = tracked[sequence[follows[tracked]] >= first]
    if np.count_nonzero(np.isfinite(angle[rows])) < _LEAST:
        raise LogError(f"{run.path}: fewer than {_LEAST} samples with an angle along the reference")
    return MeasuredRun(
        folder=run.path,
        name="",
        reference=reference,
        settings=settings.controller.controller.resolved(),
        dt_s=dt_s,
        t=np.asarray((sequence[follows[rows]] - first + 1) * dt_s, dtype=np.float64),
        reference_deg=wanted[rows],
        angle_deg=angle[rows],
        noise_deg=_noise_deg(settings.controller.model),
        led=True,
    )


def _noise_deg(model: str) -> float | None:
    """The sensor's noise as the model's file has it; None where the file says nothing or is not there any more."""
    try:
        noise = load_model(model_path(model)).metadata.noise
    except ModelError:
        return None
    return None if noise is None else noise.sensor_sigma_deg


def _numbers(log: Mapping[str, Column], name: str) -> Vec:
    return np.asarray(log[name], dtype=np.float64)
