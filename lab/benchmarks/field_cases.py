"""Inputs from public bug reports and logs, each given to the program as its user would; prints what it says.

    python lab/benchmarks/field_cases.py FOLDER [--only WORDS] [--lines 12]

FOLDER holds one folder for each case, such as `12-delay-damping-bounds`. Every command runs as a process of its own.
Printed are the exit code, the processor time and the first lines; marked are lines of an error above 300 characters,
tracebacks, and commands that did not end within their time. The exit code is that of the worst: 1 where one is marked.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

_LONGEST = 300  # characters of an error line
_PROGRAM = (sys.executable, "-c", "from hystmpc.cli.entry import main; main()")

CASES: dict[str, tuple[str, ...]] = {
    "01-rest-start": ("check {trial_1}", "fit pi {csv} --out {out}/m.yaml", "evaluate {out}/m.yaml {csv}"),
    "02-noisy-command-creep": ("fit auto {noisy} --out {out}/m.yaml --rate-hz 10", "evaluate {out}/m.yaml {clean}"),
    "03-first-flexure-text": ("check {start_mid}",),
    "04-default-rate": ("fit pi {log_10hz} --out {out}/m.yaml", "fit pi {one_second_500hz} --out {out}/n.yaml"),
    "05-text-columns": (
        "check {iso}",
        "check {date}",
        "check {date_ms} --layout {map_time}",
        "check {quoted_decimal_comma}",
    ),
    "06-merged-rates": ("check {merged}", "check {merged} --layout {map}", "fit pi {merged} --out {out}/m.yaml"),
    "07-lvm-utf16-preamble": ("check {preamble}", "check {units_row}", "check {utf16}"),
    "08-servo-sign-wrap": ("check {csv} --layout {map}", "fit pi {csv} --layout {map} --out {out}/m.yaml"),
    "09-clock-offset": (
        "check {offset_170s} --layout {map_header}",
        "check {offset_170s} --layout {map_log}",
        "fit pi {offset_170s} --layout {map_header} --out {out}/m.yaml",
    ),
    "10-mat-layouts": ("check {rows} --layout {map_rows}", "check {dspace} --layout {map_dspace}", "check {rows}"),
    "11-one-line-json": ("check {one_line}",),
    "12-delay-damping-bounds": ("fit auto {csv} --out {out}/m.yaml",),
    "13-excel-days-whole-seconds": (
        "check {whole_seconds}",
        "check {whole_seconds} --sampled-hz 25",
        "fit pi {whole_seconds} --out {out}/m.yaml",
    ),
    "14-quantised": ("check {trial_1}", "fit auto {csv} --out {out}/m.yaml"),
    "15-moving-average": ("fit auto {csv} --out {out}/m.yaml",),
    "16-top-speed": ("fit auto {csv} --out {out}/m.yaml",),
    "17-early-step": ("check {trial_1}", "fit pi {trial_1} --out {out}/m.yaml", "evaluate {out}/m.yaml {trial_1}"),
    "18-inside-play": ("check {trial_1}", "fit pi {trial_1} --out {out}/m.yaml", "evaluate {out}/m.yaml {trial_1}"),
    "19-counter-wrap": ("check {micros} --layout {map_us}", "check {ms16} --layout {map_ms}"),
    "20-change-only": ("check {trial_1}", "fit pi {trial_1} --out {out}/m.yaml"),
    "23-delay-faster-log": ("evaluate {simd} {csv}", "diagnose --sim {simd} {csv} --out {out}/gap"),
}
"""By case, the commands in order: `{name}` is a file of the case, `{csv}` all its tables, `{out}` an empty folder."""


@dataclass(frozen=True)
class Said:
    """What a command said, how it ended, and what it cost.

    Attributes:
        text: both streams.
        code: exit code; -1 where it was ended.
        seconds: processor time [s].
    """

    text: str
    code: int
    seconds: float

    @property
    def faults(self) -> list[str]:
        """What no command may do."""
        found = ["a traceback"] if "Traceback (most recent call last)" in self.text else []
        long = [len(line) for line in self.text.splitlines() if line.startswith("error: ") and len(line) > _LONGEST]
        found += [f"an error line of {length} characters" for length in long]
        return [*found, "no end within its time"] if self.code < 0 else found


def said(words: list[str], timeout_s: float) -> Said:
    """Run a command of the program."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "COLUMNS": "160", "NO_COLOR": "1", "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [*_PROGRAM, *words], capture_output=True, text=True, timeout=timeout_s, env=environment, check=False
        )
        text, code = done.stdout + done.stderr, done.returncode
    except subprocess.TimeoutExpired:
        text, code = "", -1
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return Said(text, code, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def words_of(command: str, case: Path, out: Path) -> list[str]:
    """The command with the files of a case in place of their names."""
    files = {file.stem: str(file) for file in sorted(case.iterdir())}
    tables = [str(file) for file in sorted(case.glob("*.csv"))]
    words: list[str] = []
    for word in command.split():
        words += tables if word == "{csv}" else [word.format(out=out, **files)]
    return words


def main() -> int:
    """Try all cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="words, one of which a case's name has to hold")
    parser.add_argument("--lines", type=int, default=12, help="lines printed of each command")
    parser.add_argument("--timeout-s", type=float, default=900.0)
    given = parser.parse_args()
    wrong = 0
    for name, commands in CASES.items():
        if given.only and not any(word in name for word in given.only.split()):
            continue
        print(f"\n=== {name}", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            for command in commands:
                heard = said(words_of(command, given.folder / name, Path(folder)), given.timeout_s)
                print(f"--- {command}: exit code {heard.code}, {heard.seconds:.1f} s")
                lines = [line.rstrip() for line in heard.text.splitlines() if line.strip()]
                print("\n".join(f"    {line[:170]}" for line in lines[: given.lines]), flush=True)
                for fault in heard.faults:
                    wrong += 1
                    print(f"!!! {fault}")
    print(f"\n{wrong} faults")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
