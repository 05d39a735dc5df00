"""A C program that takes the steps of a recorded run once more, and times each of them."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any, final

import numpy as np

from hystmpc.codegen import ControllerExport
from hystmpc.codegen.compiler import compiler
from hystmpc.trials.types import Mat
from tests.codegen.compiled import Library

_PROGRAM = Path(__file__).with_name("replay.c")
_STEP, _INIT, _STOP = 0.0, 1.0, 2.0  # as in the program


@final
class Recorder(Library):
    """A library whose calls are recorded."""

    def __init__(self, export: ControllerExport, folder: Path, single: bool, options: Sequence[str]) -> None:
        super().__init__(export, folder, single, options)
        self._calls: list[list[float]] = []

    def init(self, angle: float, command: float) -> int:
        self._calls.append([_INIT, angle, command])
        return super().init(angle, command)

    def stop(self) -> None:
        self._calls.append([_STOP])
        super().stop()

    def step(self, angle: float, reference: Any = None) -> Any:
        answer = super().step(angle, reference)
        self._calls.append([_STEP, angle, answer.u, *reference])
        return answer

    def calls(self) -> Mat:
        """The calls, one a row: kind, measurement, command, reference; zeros where there is none of these."""
        width = max(len(call) for call in self._calls)
        return np.array([call + [0.0] * (width - len(call)) for call in self._calls])


def replay(export: ControllerExport, calls: Mat, folder: Path, options: Sequence[str], repetitions: int) -> Mat:
    """Time of every step in every repetition (repetitions, steps) [us].

    Raises:
        RuntimeError: if a command differs from the recorded one.
    """
    export.write(folder)
    program = folder / "replay"
    command = compiler()
    assert command is not None
    files = [str(_PROGRAM), str(folder / "hystmpc.c"), "-I", str(folder), "-lm"]
    subprocess.run([*command, "-std=c99", "-ffp-contract=off", *options, "-o", program, *files], check=True)
    words = [program, str(len(calls)), str(repetitions)]
    done = subprocess.run(words, input=calls.tobytes(), capture_output=True, check=False)
    if done.returncode:
        raise RuntimeError(f"replay: got exit {done.returncode}, expected 0: {done.stderr.decode().strip()}")
    return np.frombuffer(done.stdout).reshape(repetitions, -1) / 1000.0
