"""The folder of a blind check: cases in the open, answers in one sealed file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

from hystmpc.models.simulator import Simulator, load_simulator, save_simulator
from hystmpc.trials.config import Settings
from hystmpc.trials.csv_files import write_csv
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial

from .answer import Answer
from .case import Case

FORMAT = "hystmpc-blind/1"
ANSWERS = "answers.json"
MANIFEST = "manifest.json"


class Manifest(Settings):
    """What may be known before the answers are opened.

    Attributes:
        format: of the folder.
        cases: names of the case folders.
        answers_sha256: of the sealed file.
        without: classes that the diagnosis of a case is not given; every second such case is a decoy.
    """

    format: str
    cases: tuple[str, ...]
    answers_sha256: str
    without: dict[str, tuple[str, ...]]


def write_case(folder: Path, case: Case) -> None:
    """Write logs and simulator of one case; equal names and layout for every case."""
    for number, trial in enumerate(case.trials, start=1):
        write_csv(trial, folder / f"trial_{number:02d}.csv")
    save_simulator(case.simulator, folder / "sim.yaml")


def seal(folder: Path, answers: Sequence[Answer]) -> Manifest:
    """Write the sealed answers, in the order of the case folders, and the manifest; the manifest goes last."""
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
    """The manifest of a folder of cases.

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
    """Logs and simulator of one case, as the diagnosis gets them.

    Raises:
        LogError: if a log cannot be used.
        ModelError: if the simulator cannot.
    """
    where = folder / "cases" / name
    return read_trials([where]), load_simulator(where / "sim.yaml")


def case_name(index: int, count: int) -> str:
    """Name of a case's folder: a number of three digits or more."""
    return f"{index + 1:0{max(3, len(str(count)))}d}"


def digest(text: str) -> str:
    """SHA-256 of a text, in hexadecimal."""
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
