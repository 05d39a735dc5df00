"""Mutation test: every safety rule is broken on purpose, one line at a time, and the tests of its room must fail.

    python lab/benchmarks/mutants.py [--jobs 2] [--only TEXT] [--timeout 300] [--out mutants.json]

Each mutant of `mutants.yaml` is written into a copy of the checkout, its tests run there, fast ones first, and it is
reverted. A mutant is killed when a test fails, crashes or hangs; it survives when they all pass. Text that does
not occur exactly once is an error, so that the list cannot become outdated. First, the same tests run without any
mutant: if they fail, nothing can be concluded. Exit code 1 below 95 % killed, 2 if a mutant does not apply.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from kit import asked, save, show
from rich.console import Console

from hystmpc.trials.config import read_yaml

LIST = Path(__file__).with_suffix(".yaml")
ROOT = Path(__file__).resolve().parents[2]
LEAST_SHARE = 0.95
_LEFT_OUT = (
    ".git",
    ".venv*",
    ".typecheck",
    ".hypothesis",
    ".*_cache",
    "runs",
    "demo",
    "build",
    "dist",
    "*.egg-info",
)
_FAILED, _INTERRUPTED, _NO_TESTS = 1, 2, 5  # exit codes of pytest; an import that fails is an interruption
_CRASHED = {-int(s) for s in signal.Signals if s.name in ("SIGSEGV", "SIGBUS", "SIGABRT", "SIGFPE", "SIGILL")}
_FIRST_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)
_WHERE = "import hystmpc.ctrl.command, hystmpc.rig.safety.intake as i; print(hystmpc.ctrl.command.__file__, i.__file__)"

Verdict = Literal["killed", "survived", "error"]


@dataclass(frozen=True)
class Mutant:
    """Single wrong line. A harmless change, which leaves the behaviour as it is, is no mutant.

    Attributes:
        file: path relative to the root of the checkout.
        old: text that occurs exactly once in the file.
        tests: files or folders of tests that have to fail, relative to the root of the checkout.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    @property
    def room(self) -> str:
        """Room of the package, for the table."""
        return self.file.partition("/")[0]


def listed(path: Path = LIST) -> tuple[Mutant, ...]:
    """Mutants of a list: groups of one file and its tests, each with its mutants."""
    return tuple(
        Mutant(one["name"], group["file"], one["old"], one["new"], tuple(group["tests"]))
        for group in read_yaml(path)
        for one in group["mutants"]
    )


MUTANTS = listed()


class NotApplicableError(Exception):
    """A mutant whose old text does not occur exactly once, or a copy in which nothing can be learned."""


@dataclass(frozen=True)
class Result:
    """Outcome of one mutant.

    Attributes:
        verdict: `killed`, `survived`, or `error` if nothing can be concluded.
        by: first test that failed, `timeout`, or the error.
        seconds: duration [s].
    """

    name: str
    room: str
    verdict: Verdict
    by: str
    seconds: float


def mutated(mutant: Mutant, text: str) -> str:
    """Text of the file with the wrong line.

    Raises:
        NotApplicableError: if the old text does not occur exactly once, or nothing would change.
    """
    count = text.count(mutant.old)
    if count != 1 or mutant.old == mutant.new:
        raise NotApplicableError(
            f"{mutant.file}: got {count} times {mutant.old!r}, expected it once, and another text instead "
            f"({mutant.name})"
        )
    return text.replace(mutant.old, mutant.new)


class Copy:
    """Copy of the checkout in a folder `hystmpc`, so that the package imported there is the copy.

    The folder above stands first on the path: Python finds the package there before it asks the finder of the editable
    install, which is the last one.

    Raises:
        NotApplicableError: if another checkout would be imported.
    """

    def __init__(self, folder: Path, timeout_s: float) -> None:
        self.root, self.timeout_s = folder / "hystmpc", timeout_s
        shutil.copytree(ROOT, self.root, ignore=shutil.ignore_patterns(*_LEFT_OUT), symlinks=True)
        self._environment = {
            **os.environ,
            "PYTHONPATH": str(folder),
            "PYTHONDONTWRITEBYTECODE": "1",
            "OMP_NUM_THREADS": "1",
            "HYSTMPC_DATA": os.environ.get("HYSTMPC_DATA", str(ROOT.parent / "shared" / "data")),
        }
        code, said = self._run(["-c", _WHERE])
        if code or any(not Path(file).is_relative_to(self.root) for file in said.split()):
            raise NotApplicableError(f"imported: {said.strip()}, expected files of {self.root}")

    def judged(self, mutant: Mutant) -> Result:
        """Apply a mutant, run its tests, revert it."""
        began = time.monotonic()
        try:
            with self._applied(mutant):
                verdict, by = self.tested(mutant.tests)
        except (NotApplicableError, OSError) as error:
            verdict, by = "error", str(error)
        return Result(mutant.name, mutant.room, verdict, by, time.monotonic() - began)

    def tested(self, tests: Sequence[str]) -> tuple[Verdict, str]:
        """Whether some test fails, the fast ones first."""
        passed = False
        for marks in ("not slow", "slow"):
            try:
                code, said = self._run(["-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-m", marks, *tests])
            except subprocess.TimeoutExpired:
                return "killed", f"timeout after {self.timeout_s:g} s"
            if code in _CRASHED:  # a wrong line of C may end the process that tests it
                return "killed", f"signal {-code}"
            if code in (_FAILED, _INTERRUPTED):
                found = _FIRST_FAILED.search(said)
                return "killed", found[1] if found else f"exit code {code}"
            if code not in (0, _NO_TESTS):
                return "error", f"pytest: exit code {code}: {' '.join(said.split())[-200:]}"
            passed = passed or code == 0
        return ("survived", "") if passed else ("error", "there are no such tests")

    @contextmanager
    def _applied(self, mutant: Mutant) -> Iterator[None]:
        file = self.root / mutant.file
        before = file.read_bytes()
        file.write_text(mutated(mutant, before.decode("utf-8")), encoding="utf-8")
        stale = list((file.parent / "__pycache__").glob(f"{file.stem}.*.pyc"))
        for compiled in stale:  # stale bytecode is reused for a new text of equal length
            compiled.unlink()
        try:
            yield
        finally:
            file.write_bytes(before)

    def _run(self, arguments: Sequence[str]) -> tuple[int, str]:
        """Exit code and output of Python in the copy; if it hangs, kill its processes and raise `TimeoutExpired`."""
        process = subprocess.Popen(
            [sys.executable, *arguments],
            cwd=self.root,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            said, _ = process.communicate(timeout=self.timeout_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            raise
        return process.returncode, said


def run(mutants: Sequence[Mutant], jobs: int, timeout_s: float, tell: Console) -> list[Result]:
    """Judge all mutants in one copy of the checkout for each worker.

    Raises:
        NotApplicableError: if a copy is not the one imported, or a test fails without any mutant.
    """
    here = threading.local()
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder, ThreadPoolExecutor(jobs) as pool:
        numbers = iter(range(jobs))

        def copy() -> Copy:
            if not hasattr(here, "copy"):
                here.copy = Copy(Path(folder) / str(next(numbers)), timeout_s)
            return here.copy

        def sound(tests: tuple[str, ...]) -> None:
            verdict, by = copy().tested(tests)
            if verdict != "survived":
                raise NotApplicableError(
                    f"without any mutant: got {verdict} {by}, expected that {', '.join(tests)} pass"
                )

        def judged(mutant: Mutant) -> Result:
            result = copy().judged(mutant)
            line = f"{result.verdict:9s}{mutant.room}: {mutant.name} ({result.seconds:.0f} s) {result.by}"
            tell.print(line, highlight=False, markup=False, soft_wrap=True)
            return result

        list(pool.map(sound, sorted({mutant.tests for mutant in mutants})))
        return list(pool.map(judged, mutants))


def share(results: Sequence[Result]) -> float:
    """Share of killed mutants; an error does not count as killed."""
    return sum(r.verdict == "killed" for r in results) / max(len(results), 1)


def main() -> int:
    """Judge the mutants; exit codes as in the module's text."""
    options = asked(
        __doc__,
        jobs=(1, "workers, each with a copy of its own"),
        only={"action": "append", "default": [], "help": "a part of a name or file; may be repeated"},
        timeout=(300.0, "for the tests of one mutant [s]"),
        out={"type": Path, "help": "JSON file of the results"},
    )
    chosen = [m for m in MUTANTS if not options.only or any(t in m.name or t in m.file for t in options.only)]
    console = Console(width=160)
    if not chosen:
        console.print(f"error: --only: got {', '.join(options.only)}, expected a part of a mutant's name or file")
        return 2
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # the copies are removed at any end
    try:
        results = run(chosen, options.jobs, options.timeout, console)
    except NotApplicableError as error:
        console.print(f"error: {error}", soft_wrap=True, markup=False)
        return 2
    rows = ((r.room, r.name, r.verdict, r.by, f"{r.seconds:.0f}") for r in results)
    title = f"{len(results)} mutants, {share(results):.1%} killed"
    show(("room", "what is wrong", "verdict", "by", "s"), rows, title, width=160)
    save(options.out, {"killed_share": share(results), "mutants": [asdict(r) for r in results]})
    if any(r.verdict == "error" for r in results):
        return 2
    return int(share(results) < LEAST_SHARE)


if __name__ == "__main__":
    sys.exit(main())
