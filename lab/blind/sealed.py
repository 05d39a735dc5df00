"""Folder of a blind check: open cases, answers in one sealed file, densities of the error by region."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from hystmpc.gap.logs.simulated import SIMULATED
from hystmpc.gap.residual import MOTION_PARTS, motion_part_labels
from hystmpc.models.simulator import Simulator, load_simulator, save_simulator
from hystmpc.trials.config import Settings
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec

from ..devices.cores import Mounting
from .device import BlindDevice, core_of
from .generators import NAMES, UNKNOWN, Withheld, generator_named

Suite = Literal[
    "single",
    "none",
    "misset",
    "pairs",
    "contaminated",
    "unknown",
    "without",
    "controls",
    "injection",
    "triple",
    "retuned",
    "configuration",
    "aliased",
]
FORMAT = "hystmpc-blind/1"
ANSWERS = "answers.json"
MANIFEST = "manifest.json"
DENSE = 1.25
"""Density from which on a region counts as one in which the gap lies."""


class EffectAnswer(Settings):
    """One withheld effect.

    Attributes:
        ratio: gap of this effect alone after retuning, in floors.
        gap_deg: the same gap [deg].
        main: whether it counts as a cause, or is a smaller contaminant.
    """

    label: str
    generator: str
    size: float
    shape: dict[str, float] = Field(default_factory=dict)
    ratio: float = 0.0
    gap_deg: float = 0.0
    main: bool = True

    def withheld(self) -> Withheld:
        """Withheld effect with its generator."""
        return Withheld(generator_named(self.generator), self.size, self.shape)


class Answer(Settings):
    """True answer of one case.

    Attributes:
        suite: which part of the check it belongs to; decoys and controls say more in `variant`.
        separable: whether these motions separate the effects from their confounders.
        plan, motions: kind of recording plan, and motion by trial.
        floor_deg, noise_deg, form_deg: noise and model-form error together, and each [deg].
        retuned_deg: what a refit of the baseline leaves of the affected device, noise apart [deg].
        true_closed: share of that, squared, which the effects make up; the rest is model-form error.
        retuned_by_trial, form_by_trial: of each trial alone: what the refit leaves of it, and what one leaves of the
            unaffected device [deg].
        where: density of the retuned error by region, 1 on average.
        second: trials of the second configuration, numbered from 1.
        device, mounting, seed: of the simulated device, to record more of it.
        unaffected: the device from which the simulator was made.
        baseline: kind of the simulator.
        own_simulator: whether the logs hold what the unaffected device gives, as the user's own simulator.
    """

    suite: Suite
    variant: str = ""
    effects: tuple[EffectAnswer, ...] = ()
    without: tuple[str, ...] = ()
    separable: bool = True
    plan: str = ""
    motions: tuple[str, ...] = ()
    floor_deg: float = 0.0
    noise_deg: float = 0.0
    form_deg: float = 0.0
    resolution_deg: float = 0.0
    retuned_deg: float = 0.0
    true_closed: float | None = None
    retuned_by_trial: tuple[float, ...] = ()
    form_by_trial: tuple[float, ...] = ()
    where: dict[str, float] = Field(default_factory=dict)
    second: tuple[int, ...] = ()
    device: dict[str, Any] = Field(default_factory=dict)
    unaffected: dict[str, Any] = Field(default_factory=dict)
    mounting: dict[str, float] = Field(default_factory=dict)
    seed: int = 0
    baseline: str = ""
    own_simulator: bool = False

    @property
    def mains(self) -> tuple[EffectAnswer, ...]:
        """Effects that count as causes, the largest first."""
        return tuple(sorted((e for e in self.effects if e.main), key=lambda e: -e.ratio))

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of a correct diagnosis; none if its library has none for them."""
        return tuple(dict.fromkeys(e.label for e in self.mains if e.label in NAMES - set(self.without)))

    @property
    def truth(self) -> str:
        """True class: `none`, `unknown`, or the name of the largest cause."""
        if not self.mains:
            return "none"
        return self.labels[0] if self.labels else UNKNOWN

    @property
    def ratio(self) -> float:
        """Ratio of the largest cause; 0 without any."""
        return self.mains[0].ratio if self.mains else 0.0

    def blind_device(self) -> BlindDevice:
        """The simulated device of the case."""
        core = core_of(self.device).mounted(Mounting(**self.mounting))
        effects = tuple(effect.withheld() for effect in self.effects)
        return BlindDevice(core, self.noise_deg, self.resolution_deg, self.seed, effects)

    def with_own_output(self, trials: Sequence[Trial]) -> list[Trial]:
        """Trials with what the unaffected device gives, where it is the user's own simulator; as they are otherwise."""
        if not self.own_simulator:
            return list(trials)
        device = BlindDevice(core_of(self.unaffected), 0.0, self.resolution_deg, self.seed)
        outputs = device.true_angles([trial.command for trial in trials])
        return [
            replace(trial, channels={f"{SIMULATED}_{trial.units.angle}": output})
            for trial, output in zip(trials, outputs, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class Case:
    """Logs and nominal simulator of one device.

    Attributes:
        simulator: identified on other trials of the unaffected device.
    """

    trials: tuple[Trial, ...]
    simulator: Simulator
    answer: Answer


class Manifest(Settings):
    """Public facts of a blind check, before the answers are opened.

    Attributes:
        answers_sha256: of the sealed file.
        without: classes that the diagnosis of a case is not given; every second such case is a decoy.
    """

    format: str
    cases: tuple[str, ...]
    answers_sha256: str
    without: dict[str, tuple[str, ...]]


def write_case(folder: Path, case: Case) -> None:
    """Write logs and simulator of one case, with equal names for every case."""
    for number, trial in enumerate(case.answer.with_own_output(case.trials), start=1):
        write_csv(trial, folder / f"trial_{number:02d}.csv")
    save_simulator(case.simulator, folder / "sim.yaml")


def seal(folder: Path, answers: Sequence[Answer]) -> Manifest:
    """Write the sealed answers, in the order of the case folders, and finally the manifest."""
    names = [case_name(k, len(answers)) for k in range(len(answers))]
    text = json.dumps(
        {name: answer.model_dump(mode="json") for name, answer in zip(names, answers, strict=True)}, indent=1
    )
    write_atomically(folder / ANSWERS, text)
    manifest = Manifest(
        format=FORMAT,
        cases=tuple(names),
        answers_sha256=digest(text),
        without={name: a.without for name, a in zip(names, answers, strict=True) if a.without},
    )
    write_atomically(folder / MANIFEST, json.dumps(manifest.model_dump(mode="json"), indent=1))
    return manifest


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a folder of cases.

    Raises:
        LogError: if there is none, or it is of another format.
    """
    path = folder / MANIFEST
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise LogError(f"{path}: cannot be read, expected the manifest of `hystmpc gap blind make`") from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise LogError(f"{path}: expected a manifest of format {FORMAT!r}")
    try:
        return Manifest.parse(data, str(path))
    except ConfigError as error:
        raise LogError(str(error)) from None


def open_answers(folder: Path) -> dict[str, Answer]:
    """Open the sealed answers.

    Raises:
        LogError: if they are missing, or are not the ones whose hash the manifest holds.
    """
    path, manifest = folder / ANSWERS, read_manifest(folder)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError:
        raise LogError(f"{path}: cannot be read, expected the sealed answers") from None
    if digest(text) != manifest.answers_sha256:
        raise LogError(
            f"{path}: sha256 {digest(text)[:12]}..., expected {manifest.answers_sha256[:12]}...: changed since sealed"
        )
    return {name: Answer.parse(data, f"{path}: {name}") for name, data in json.loads(text).items()}


def read_case(folder: Path, name: str) -> tuple[list[Trial], Simulator]:
    """Read the logs and the simulator of one case in the form given to the diagnosis."""
    where = folder / "cases" / name
    return read_trials([where]), load_simulator(where / "sim.yaml")


def case_name(index: int, count: int) -> str:
    """Name of a case's folder: a number of three digits or more."""
    return f"{index + 1:0{max(3, len(str(count)))}d}"


def digest(text: str) -> str:
    """SHA-256 of a text, in hexadecimal."""
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def densities(trials: Sequence[Trial], errors: Sequence[Vec]) -> dict[str, float]:
    """Density by region: share of the squared error divided by share of the samples; no region without samples."""
    region = np.concatenate([motion_part_labels(trial) for trial in trials])
    square = np.concatenate(list(errors)) ** 2
    total = max(float(square.mean()), 1e-12)
    return {
        name: float(square[region == k].mean()) / total for k, name in enumerate(MOTION_PARTS) if np.any(region == k)
    }
