"""Closed-loop tracking error measured in runs, and its fall from one run to another on the same reference."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hystmpc.ctrl.law import LawSettings
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings, SamplingMpcSettings
from hystmpc.models.load import load_model, model_path
from hystmpc.models.simulator import Simulator, load_simulator
from hystmpc.rig.config import RunSettings
from hystmpc.sim.results import load_results
from hystmpc.trajectories.drawn import CountedMotion, approached
from hystmpc.trajectories.trajectory import Trajectory, sample, steps
from hystmpc.trials.errors import ConfigError, HystmpcError, LogError, ModelError
from hystmpc.trials.figures import TrackedLine, TrackedMotion, tracking_figure
from hystmpc.trials.from_outside import only_reads
from hystmpc.trials.report import Heading, Paragraph, Piece, Plot, Table
from hystmpc.trials.run_folder import Column, RunFolder
from hystmpc.trials.types import Vec

from .diagnosis import FIXED_FILE, TrackingGap
from .expected_tracking import AGREEMENT, UnexplainedPlant, expected_tracking
from .report.figures import AFTER, BEFORE
from .report.folder import DIAGNOSIS_FILE, GIVEN_FILE, holds_diagnosis

_BENCH = {"transport", "sensor", "reference"}  # settings that only an experiment has
_LEAST = 10  # samples that can be compared


@dataclass(frozen=True, eq=False)
class MeasuredRun:
    """Run of one controller along one reference, (N,) samples without the approach to its start.

    Attributes:
        name: motion and controller of a simulation; empty at a bench.
        t: end of the sample, from the beginning of the reference [s].
        reference_deg, angle_deg: reference and measured angle; for a simulation the true angle [deg].
        noise_deg: standard deviation of the noise in that angle; None if unknown [deg].
        approached_first: whether the reference began with an approach from the device's position.
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
    approached_first: bool

    @property
    def rmse_deg(self) -> float:
        """Root of mean (angle - reference)^2 - noise^2, zero if the noise exceeds the error [deg]."""
        error = (self.angle_deg - self.reference_deg)[np.isfinite(self.angle_deg)]
        return math.sqrt(max(float(np.mean(error**2)) - (self.noise_deg or 0.0) ** 2, 0.0))


@only_reads()
def measured_runs(folder: Path) -> tuple[MeasuredRun, ...]:
    """Read all runs of a folder of `run` or `simulate`.

    Raises:
        LogError: if it holds no such run, or one that was stopped before the end of its reference.
        ConfigError: if its settings are not those of such a run.
        TrajectoryError: if its reference cannot be regenerated.
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
            approached_first=r.run.first > 0,
        )
        for r in study.results
    )


def _at_bench(run: RunFolder) -> MeasuredRun:
    settings = RunSettings.parse(run.config(), str(run.path / "config.yaml"))
    log, reference, dt_s = run.log(), settings.reference.build(), settings.dt_s
    if missing := [name for name in ("angle_deg", "reference_deg", "sequence") if name not in log]:
        raise LogError(f"{run.path}: the log lacks {', '.join(missing)}, expected the log of a run at a bench")
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
        approached_first=True,
    )


def _noise_deg(model: str) -> float | None:
    """Standard deviation of the sensor noise from the model file [deg]; None if it is unknown."""
    try:
        noise = load_model(model_path(model)).metadata.noise
    except ModelError:
        return None
    return None if noise is None else noise.sensor_sigma_deg


def _numbers(log: Mapping[str, Column], name: str) -> Vec:
    return np.asarray(log[name], dtype=np.float64)


_SAME_DEG = 1e-6


@dataclass(frozen=True, eq=False)
class TrackingFall:
    """Fall of the tracking error from an earlier run to a run on the same reference.

    Attributes:
        before: the earlier run; None without one.
        expected: on this reference; None without a diagnosis.
    """

    after: MeasuredRun
    before: MeasuredRun | None
    expected: TrackingGap | None

    @property
    def share(self) -> float:
        """Measured fall as a share of the error before; not-a-number without an earlier run."""
        if self.before is None:
            return math.nan
        return TrackingGap(self.before.rmse_deg, self.after.rmse_deg).fall_share

    @property
    def agrees(self) -> bool:
        """Whether the measured share is within `AGREEMENT` of the expected one."""
        if self.expected is None or self.expected.why_not or self.before is None:
            return False
        expected = self.expected.fall_share
        return abs(self.share - expected) <= AGREEMENT * abs(expected)


def tracking_falls(run: Path, before: Sequence[Path], diagnosis: Path | None = None) -> tuple[TrackingFall, ...]:
    """Fall of the tracking error from every earlier run, and its prediction by a diagnosis on the same reference.

    Args:
        run: folder of `run` or `simulate`.
        before: folders of the same kind, on the same reference.
        diagnosis: folder of `diagnose`; its simulators are run in closed loop on the run's reference.

    Raises:
        LogError: if a folder holds no run or diagnosis, or references differ.
        HystmpcError: of any kind, if the closed loop cannot be simulated.
    """
    after = measured_runs(run)
    earlier = [_runs_to_compare(run, after, folder) for folder in before]
    pair = None if diagnosis is None else _simulators(diagnosis)
    falls = []
    for k, run_after in enumerate(after):
        earlier_runs = [earlier_run for earlier_runs in earlier if (earlier_run := earlier_runs[k]) is not None]
        expected = None if pair is None or (before and not earlier_runs) else _expected(run_after, *pair)
        falls += [TrackingFall(run_after, earlier_run, expected) for earlier_run in earlier_runs]
        if not before:
            falls.append(TrackingFall(run_after, None, expected))
    return tuple(falls)


def fall_lines(falls: Iterable[TrackingFall]) -> list[str]:
    """Sentences on the measured and the expected fall, a line each."""
    lines = []
    for fall in falls:
        lines.append(_measured_line(fall))
        if fall.expected is not None:
            lines.append(_expected_line(fall, fall.expected))
    return lines


def fall_pieces(falls: Sequence[TrackingFall]) -> tuple[Piece, ...]:
    """Report pieces on the measured and the expected fall: table, sentences, and a figure for each pair of runs."""
    rows: list[tuple[Any, ...]] = []
    for fall in falls:
        name = fall.after.name or "tracking error"
        if fall.before is not None:
            rows.append(
                (name, f"measured, {fall.before.folder.name}", *_row(fall.before.rmse_deg, fall.after.rmse_deg))
            )
        if fall.expected is not None and not fall.expected.why_not:
            rows.append((name, "expected", *_row(fall.expected.before_deg, fall.expected.after_deg)))
    columns = ("of", "", "before [deg]", "after [deg]", "fall [%]")
    pieces: list[Piece] = [Heading("Fall of the tracking error"), *map(Paragraph, fall_lines(falls))]
    pieces.append(Table(columns, rows, "RMS along the reference, without the way to its start."))
    pieces += [
        Plot(_figure(fall.before, fall.after), f"{fall.after.name or 'Angle'}: before and after.")
        for fall in falls
        if fall.before is not None
    ]
    return tuple(pieces)


def _runs_to_compare(run: Path, after: Sequence[MeasuredRun], folder: Path) -> list[MeasuredRun | None]:
    """Earlier run of the same name for each run; None if there is none."""
    by_name = {earlier.name: earlier for earlier in measured_runs(folder)}
    matched = [by_name.get(run_after.name) for run_after in after]
    if not any(matched):
        names = ", ".join(by_name) or "nothing"
        raise LogError(f"--before {folder}: got {names}, expected runs of the names in {run}")
    for run_after, earlier in zip(after, matched, strict=True):
        if earlier is not None:
            _require_same(run_after, earlier)
    return matched


def _require_same(after: MeasuredRun, before: MeasuredRun) -> None:
    rate = 1.0 / after.dt_s
    (_, wanted), (_, other) = sample(after.reference, rate), sample(before.reference, rate)
    where = f"--before {before.folder}"
    if wanted.size != other.size:
        got, expected = before.reference.duration_s, after.reference.duration_s
        raise LogError(f"{where}: a reference of {got:.4g} s, expected that of {after.folder}, {expected:.4g} s")
    apart = float(np.max(np.abs(wanted - other)))
    if apart > _SAME_DEG:
        distance = f"a reference up to {apart:.3g} deg beside that of {after.folder}"
        raise LogError(f"{where}: {distance}, expected the same one")


def _simulators(folder: Path) -> tuple[Simulator, Simulator]:
    if not holds_diagnosis(folder):
        raise LogError(f"--diagnosis {folder}: got no {DIAGNOSIS_FILE}, expected a folder of `diagnose`")
    for name in (GIVEN_FILE, FIXED_FILE):
        if not (folder / name).is_file():
            raise LogError(
                f"--diagnosis {folder}: got no {name}, expected one; a network, angles that follow no command and "
                "older diagnoses have none"
            )
    return load_simulator(folder / GIVEN_FILE), load_simulator(folder / FIXED_FILE)


def _expected(run: MeasuredRun, nominal: Simulator, corrected: Simulator) -> TrackingGap:
    if not isinstance(run.settings, LinearisedMpcSettings | SamplingMpcSettings):
        return TrackingGap(why_not=f"{run.name or run.folder}: its controller does not predict with a model")
    nominal, corrected = nominal.at_sample_time(run.dt_s), corrected.at_sample_time(run.dt_s)
    settings: LawSettings = run.settings
    motion = CountedMotion(run.name or "reference", run.reference, 0.0)
    if run.approached_first:
        rest = UnexplainedPlant(corrected, 1).true_angle
        motion = approached(motion.name, rest, float(run.reference(0.0)), run.reference)
    try:
        return expected_tracking(nominal, corrected, (motion,), settings=settings)[0]
    except ConfigError:
        raise
    except HystmpcError as error:
        return TrackingGap(why_not=f"the closed loop could not be simulated ({error})")


def _row(before: float, after: float) -> tuple[float, float, float]:
    return before, after, 100 * TrackingGap(before, after).fall_share


def _measured_line(fall: TrackingFall) -> str:
    name, after = (f"{fall.after.name}: " if fall.after.name else ""), fall.after
    if fall.before is None:
        return f"{name}the tracking error is {after.rmse_deg:.3g} deg RMS {_noise_words(after)}"
    before = fall.before
    change = "fell" if fall.share >= 0 else "rose"
    text = (
        f"{name}the tracking error {change} from {before.rmse_deg:.3g} deg RMS ({before.folder.name}) to "
        f"{after.rmse_deg:.3g} deg, by {100 * abs(fall.share):.0f} % {_noise_words(before, after)}"
    )
    return text if before.settings == after.settings else f"{text}; the two runs differ in the controller's settings"


def _expected_line(fall: TrackingFall, expected: TrackingGap) -> str:
    if expected.why_not:
        return f"no fall can be expected: {expected.why_not}"
    text = (
        f"expected on this reference: from {expected.before_deg:.3g} deg RMS to {expected.after_deg:.3g} deg, "
        f"by {100 * expected.fall_share:.0f} %"
    )
    if fall.before is None:
        return text
    verdict = "is" if fall.agrees else "is not"
    return f"{text}; the measured fall {verdict} within {100 * AGREEMENT:.0f} % of it"


def _noise_words(*runs: MeasuredRun) -> str:
    if all(run.noise_deg is None for run in runs):
        return "(with the sensor's noise: no model file knows it)"
    if any(run.noise_deg is None for run in runs):
        return "(one of them with the sensor's noise: its model file does not know it)"
    if not any(run.noise_deg for run in runs):
        return "(true angle)"
    sizes = " and ".join(dict.fromkeys(f"{run.noise_deg:.2g}" for run in runs))
    return f"(noise of the sensor subtracted: {sizes} deg)"


def _figure(before: MeasuredRun, after: MeasuredRun) -> Figure:
    runs = ((before, BEFORE), (after, AFTER))
    lines = [TrackedLine(run.t, run.angle_deg, run.angle_deg - run.reference_deg, look) for run, look in runs]
    return tracking_figure([TrackedMotion(after.t, after.reference_deg, lines)], "error [deg]", height=4.0)
