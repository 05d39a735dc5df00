"""Verification on the device: tracking of new references by each controller, and the comparison of their errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hystmpc.ctrl.command import Source
from hystmpc.models.identify.estimation_noise import resolution
from hystmpc.rig.axes import each
from hystmpc.rig.config import BenchSettings
from hystmpc.sim.results import Limits, holds, violations
from hystmpc.trials.brief import brief
from hystmpc.trials.types import Vec, rms

from .device import MovableDevice, Track
from .identify import TIP_FILE, tip_settings
from .motions import CONTROLLERS, AnyMotion
from .stages import Figure

TITLES = {"mpc": "linearised MPC", "inverse": "inverse alone", "pid": "PID, tuned on the model"}
MPC, PID = "mpc", "pid"
_SETTLED_S = 0.5  # after which a hold counts as settled
_AT_REST = 1e-6  # of the command's range
_BLOCK_S = 1.0  # length of a block of correlated errors
_ERRORS = 2.0  # standard errors by which the square error has to fall
_LEAST_GAIN = 0.05  # of the square error
_NOISE_FACTOR = 1.5  # factor on the sensor's noise, below which errors are indistinguishable from it
_FALLBACKS = 0.02  # of the samples
_ROUNDS = 0.8  # share of the sensor's noise from which quantisation dominates
_LATE_STEPS = (
    "give the loop a core of its own (block realtime), lower rate_hz, or end other programs on this machine",
    "verify again then: with other settings into a new --out, with the same ones after 7-verify is removed",
)
_DECIDED = (Source.MPC, Source.CONTROLLER)  # decisions of the controller itself

Tracks = Mapping[str, Mapping[str, Track]]
"""By reference, then by controller."""


@dataclass(frozen=True)
class ControllerScore:
    """Score of one controller over all references."""

    rms_deg: Figure  # of measured minus wanted angle, sensor noise included [deg]
    by_motion: Mapping[str, Figure]  # RMS by reference [deg]
    greatest_deg: Figure  # greatest absolute error [deg]
    rest_share: Figure  # share of the settled samples of holds with a resting command; NaN without holds
    fallback_share: Figure  # share of the samples answered by a fallback
    beyond: int  # samples beyond a limit of the command
    late_share: Figure = 0.0  # share of the samples answered by a fallback after a missed deadline, or skipped


@dataclass(frozen=True)
class Verification:
    """Result of the verification."""

    verified: bool  # whether the predictive controller is better than the PID, beyond chance
    verdict: str
    steps: tuple[str, ...]  # next steps
    sensor_sigma_deg: Figure  # noise of the sensor according to the model [deg]
    scores: Mapping[str, ControllerScore]  # by controller
    __repr__ = brief


def track_all(
    device: MovableDevice,
    motions: Mapping[str, AnyMotion],
    bench: BenchSettings,
    folder: Path,
    say: Callable[[str], None],
) -> Tracks:
    """Track every reference with every controller; existing tracks are kept.

    Raises:
        DeviceStoppedError: if a run was stopped safely; finished tracks are kept.
        HystmpcError: if a controller cannot be built.
    """
    root = folder.parent
    files = {name: root / "6-controller" / f"{name}.yaml" for name in CONTROLLERS} | {MPC: root / TIP_FILE}
    tracks = dict[str, dict[str, Track]]()
    for motion, reference in motions.items():
        tracks[motion] = {}
        for name in CONTROLLERS:
            file = folder / "tracks" / f"{motion}.{name}.csv"
            say(f"{motion}, {TITLES[name]}")
            if not file.exists():
                key = f"{folder.name}/{motion}.{name}"
                device.track(key, tip_settings(files[name]), reference, bench).save(file)
            tracks[motion][name] = Track.load(file)
    return tracks


def load_tracks(folder: Path) -> Tracks:
    """Read the tracks of a complete stage."""
    tracks = dict[str, dict[str, Track]]()
    for file in sorted((folder / "tracks").glob("*.csv")):
        motion, _, name = file.stem.rpartition(".")
        tracks.setdefault(motion, {})[name] = Track.load(file)
    return tracks


def judge_tracks(tracks: Tracks, limits: Limits, dt_s: float, sigma_deg: float, model_sigma_deg: float) -> Verification:
    """Compare the controllers: scores, and whether the predictive one is better than the PID.

    Square errors are compared in blocks of one second of the same reference: verified is a mean difference of more than
    two standard errors and 5 %. The errors contain the noise and quantisation of the sensor, equal for all. Where
    deadlines were missed, fallbacks are compared, and the controllers are not judged.

    Of two axes every error is the distance in the plane of both angles.

    `sigma_deg` is the noise of the sensor, `model_sigma_deg` the error of the model's free run [deg].
    """
    scores = {name: _scored({m: t[name] for m, t in tracks.items()}, limits, dt_s) for name in CONTROLLERS}
    mpc, pid = scores[MPC], scores[PID]
    gains = np.concatenate([_gains(t[PID], t[MPC], dt_s) for t in tracks.values()])
    mean = float(np.mean(gains)) if gains.size else 0.0
    error = float(np.std(gains, ddof=1)) / math.sqrt(gains.size) if gains.size > 1 else math.inf
    verified = mean > _ERRORS * error and mean > _LEAST_GAIN * pid.rms_deg**2
    seen = [a for runs in tracks.values() for t in runs.values() for a in t.angles_deg.T]
    step = resolution([angles[np.isfinite(angles)] for angles in seen])
    rounding = step * math.sqrt(len(each(limits)) / 12.0)
    sigma_deg = max(sigma_deg, rounding)
    figures = (
        f"RMS of measured less wanted angle {mpc.rms_deg:.3f} deg, PID {pid.rms_deg:.3f} deg, inverse alone "
        f"{scores['inverse'].rms_deg:.3f} deg; the sensor's noise alone is {sigma_deg:.3f} deg"
    )
    if rounding > _ROUNDS * sigma_deg:
        figures += f" (it reads in steps of {step:.3g} deg, so that no RMS below {rounding:.3f} deg can be measured)"
    if max(score.late_share for score in scores.values()) > _FALLBACKS:
        return Verification(False, f"{_late_words(scores)} {figures}.", _LATE_STEPS, sigma_deg, scores)
    if verified:
        steps = _verified_steps(scores)
        return Verification(
            True, f"Verified: better than the PID tuned on the model. {figures}.", steps, sigma_deg, scores
        )
    why, steps = _reasons(scores, mean, error, sigma_deg, model_sigma_deg)
    return Verification(False, f"Not better than the PID. {figures}. {why}", steps, sigma_deg, scores)


def _late_words(scores: Mapping[str, ControllerScore]) -> str:
    """Sentence on missed deadlines."""
    shares = ", ".join(f"{TITLES[name]} {100 * score.late_share:.0f} %" for name, score in scores.items())
    return (
        "Nothing is verified: this machine missed deadlines, and the comparison is not valid. Samples without time for "
        f"the controller, which a fallback has answered or which were skipped: {shares}. Deadlines cause such errors, "
        "not the model."
    )


def _verified_steps(scores: Mapping[str, ControllerScore]) -> tuple[str, ...]:
    """Recommended next steps with a verified controller."""
    steps = [f"use {TIP_FILE}: hystmpc.TipController.from_config, or `controller:` of `hystmpc run`"]
    if scores["inverse"].rms_deg <= scores[MPC].rms_deg:
        steps.append(
            "the inverse alone is as good on these references; without feedback it does not correct for a device that "
            "changes, which five minutes do not show"
        )
    if scores[MPC].beyond:
        steps.append("do not use it yet: commands beyond the limits were counted, which must not happen")
    return tuple(steps)


def _scored(tracks: Mapping[str, Track], limits: Limits, dt_s: float) -> ControllerScore:
    errors = {name: track.error_deg[np.isfinite(track.error_deg)] for name, track in tracks.items()}
    pooled = np.concatenate(list(errors.values()))
    held = resting = samples = fallbacks = beyond = late = skipped = 0
    for track in tracks.values():
        moves = np.abs(np.diff(track.commands, axis=0, prepend=track.commands[:1]))
        still = np.all(moves <= [_AT_REST * (one.upper - one.lower) for one in each(limits)], axis=1)
        for start, stop in holds(track.reference_deg, dt_s):
            part = still[start + round(_SETTLED_S / dt_s) : max(stop - 1, 0)]
            held, resting = held + part.size, resting + int(np.sum(part))
        samples += len(track.source)
        fallbacks += sum(source not in _DECIDED for source in track.source)
        late += sum(a and b not in _DECIDED for a, b in zip(track.late, track.source, strict=False))
        skipped += round((track.t[-1] - track.t[0]) / dt_s) + 1 - len(track.source)
        beyond += violations(track.command, track.command[0], limits, dt_s)
    return ControllerScore(
        rms_deg=rms(pooled),
        by_motion={name: rms(error) for name, error in errors.items()},
        greatest_deg=float(np.abs(pooled).max(initial=0.0)) if pooled.size else math.nan,
        rest_share=resting / held if held else math.nan,
        fallback_share=fallbacks / max(samples, 1),
        beyond=beyond,
        late_share=(late + skipped) / max(samples + skipped, 1),
    )


def _gains(pid: Track, mpc: Track, dt_s: float) -> Vec:
    """Mean square error of the PID minus that of the predictive controller, in blocks of a second (B,) [deg^2]."""
    count = min(pid.t.size, mpc.t.size)
    difference = pid.error_deg[:count] ** 2 - mpc.error_deg[:count] ** 2
    blocks = np.array_split(difference, max(int(count * dt_s / _BLOCK_S), 1))
    means = np.array([np.mean(b[np.isfinite(b)]) if np.isfinite(b).any() else np.nan for b in blocks])
    return means[np.isfinite(means)]


def _reasons(
    scores: Mapping[str, ControllerScore], mean: float, error: float, sigma_deg: float, model_sigma_deg: float
) -> tuple[str, tuple[str, ...]]:
    """Reason for a missing advantage over the PID, and next steps."""
    mpc, pid = scores[MPC], scores[PID]
    if max(mpc.rms_deg, pid.rms_deg) < _NOISE_FACTOR * sigma_deg:
        return "Both are at the sensor's noise: these references cannot tell them apart.", (
            "verify with faster or larger references (commission.motions), or keep the PID",
        )
    if mpc.fallback_share > _FALLBACKS:
        share = f"{100 * mpc.fallback_share:.0f} %"
        return f"A fallback has answered {share} of the samples, and not for want of time: it had no solution.", (
            "read the status of these samples in 7-verify/runs; look at limits, sensor and model",
        )
    if abs(mean) <= _ERRORS * error:
        return "The difference is within chance on these motions.", (
            "verify with longer references (commission.motions), or keep the PID",
        )
    if model_sigma_deg > pid.rms_deg:
        return f"The model's free run is off by {model_sigma_deg:.2f} deg.", (
            "record what 5-diagnose proposes, and identify again from all trials with --logs",
        )
    return "Its error has another cause than the model's free run and the noise.", (
        "look at the tracks in the report; `hystmpc tune` searches the settings of the controller",
    )
