"""Comparison of the exported C with the Python controller: greatest difference of the commands, step times, memory.

    python lab/benchmarks/exported_c.py [--steps 100000] [--case NAME] [--float32] [--repetitions 5]

Both run a closed loop on a device of their own with noise, sensor faults and stops, as in `tests/codegen/`. The C is
compiled for this machine. It is called through ctypes, whose call is part of its
time. These times are processor time.

Then a C program takes the same steps again and times each one by the monotonic clock. Its commands have to be equal.
It does so a few times. The least time of a step counts, so that what else the machine did does not. The caches stay
warm between two steps, which they may not at the bench.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, final

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from kit import asked

from hystmpc.codegen import ControllerExport, export_controller
from hystmpc.codegen.compiler import compiler
from hystmpc.trials.types import Mat
from tests.codegen.compiled import EXAMPLES, Library
from tests.codegen.loops import Compared, compare
from tests.codegen.networks import small_network
from tests.codegen.test_commands import CASES, PLAIN, tip

FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fPIC")
"""For speed on this machine."""
_PROGRAM = Path(__file__).with_name("replay.c")
_STEP, _INIT, _STOP = 0.0, 1.0, 2.0  # as in the program
GRU: dict[str, dict[str, Any]] = {"gru": dict(PLAIN), "gru-that-learns": {}}


@final
class Recorder(Library):
    """Library wrapper that records all calls."""

    def __init__(self, export: ControllerExport, folder: Path, single: bool, options: Sequence[str]) -> None:
        super().__init__(export, folder, single, options)
        self._calls: list[list[float]] = []

    def init(self, angle: Any, command: Any) -> int:
        self._calls.append([_INIT, *np.atleast_1d(angle), *np.atleast_1d(command)])
        return super().init(angle, command)

    def stop(self) -> None:
        self._calls.append([_STOP])
        super().stop()

    def step(self, angle: Any, reference: Any = None) -> Any:
        answer = super().step(angle, reference)
        self._calls.append([_STEP, *np.atleast_1d(angle), *np.atleast_1d(answer.u), *reference])
        return answer

    def calls(self) -> Mat:
        """Recorded calls, one a row: kind, measurements, commands, reference; zeros for missing values."""
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


@cache
def _file() -> str:
    """Path of a temporary GRU file with two layers of 64, which is kept until the end."""
    return small_network("gru", 64, 2, Path(tempfile.mkdtemp()))


def _gru(controller: dict[str, Any]) -> tuple[dict[str, Any], float]:
    return tip(_file(), **controller), 0.0


def _say(name: str, found: Compared, times: Mat, export: ControllerExport) -> None:
    """Print three lines of a case; `times`: time of every step in every repetition of the program [us]."""
    steps, least = found.c.size, times.min(axis=0)
    off = np.abs(found.python - found.c)
    python_us, c_us, program_us = 1e6 * found.python_s / steps, 1e6 * found.c_s / steps, float(least.mean())
    median, p99, p999 = np.quantile(least, [0.5, 0.99, 0.999])
    print(
        f"{name}: {steps} steps, difference up to {found.greatest:.2g} mm, "
        f"99 % within {np.quantile(off, 0.99):.2g} mm, median {np.median(off):.2g} mm, "
        f"{int(np.sum(off > 1e-6))} steps over 1e-6 mm; "
        f"{export.memory_bytes} bytes, {export.remembered_bytes} remembered; {dict(found.sources)}\n"
        f"    Python {python_us:.0f} us; C through ctypes {c_us:.1f} us, ratio {python_us / c_us:.1f}; "
        f"in a C program {program_us:.1f} us, ratio {python_us / program_us:.1f}\n"
        f"    C program, least of {len(times)} times [us]: median {median:.1f}, 99 % {p99:.1f}, 99.9 % {p999:.1f}, "
        f"longest {least.max():.1f}; of all times the mean is {times.mean():.1f}, the longest {times.max():.1f}",
        flush=True,
    )


def main() -> None:
    """Print three lines a case."""
    given = asked(
        __doc__,
        steps=100_000,
        repetitions=(5, "of the steps in the C program"),
        case={"choices": [*CASES, *GRU], "action": "append"},
        float32=False,
    )
    for name in given.case or [*CASES, *GRU]:
        settings, lag_s = CASES[name] if name in CASES else _gru(GRU[name])
        export = export_controller(settings, single=given.float32, folder=EXAMPLES)
        with tempfile.TemporaryDirectory() as folder:
            c = Recorder(export, Path(folder), given.float32, FLAGS)
            found = compare(settings, c, given.steps, lag_s)
            times = replay(export, c.calls(), Path(folder), FLAGS, given.repetitions)
        _say(name, found, times, export)


if __name__ == "__main__":
    main()
