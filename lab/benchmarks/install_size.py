"""Size of `pip install hystmpc` and import times in the environment that runs this program.

    python lab/benchmarks/install_size.py [--largest 12] [--runs 5]

Sizes are those of the files that a distribution lists, compiled bytecode included, in MB of 1e6 bytes. The package and
all that it requires are counted, extras left out. Times are processor time of a new interpreter with one import, minus
that of an interpreter alone: the minimum of some runs. The packages with the largest share are listed, in percent of
one run (`python -X importtime`).
"""

from __future__ import annotations

import re
import resource
import subprocess
import sys
from collections import Counter
from importlib.metadata import distribution
from pathlib import Path

from kit import asked
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

IMPORTS = (
    "hystmpc",
    "hystmpc.cli.main",
    "hystmpc.trials.read",
    "hystmpc.ctrl.planner.tip_controller",
    "hystmpc.tasks.fit",
    "hystmpc.gap.diagnose",
)
_MODULE = re.compile(r"^import time:\s+(\d+) \|\s+\d+ \|\s+([\w.]+)$", re.MULTILINE)


def required(name: str, extras: frozenset[str] = frozenset()) -> set[str]:
    """Distribution and all its installed requirements."""
    found: set[str] = set()
    ahead = [(canonicalize_name(name), extras)]
    while ahead:
        name, wanted = ahead.pop()
        if name in found:
            continue
        found.add(name)
        for line in distribution(name).requires or ():
            part = Requirement(line)
            if part.marker is None or any(part.marker.evaluate({"extra": extra}) for extra in wanted | {""}):
                ahead.append((canonicalize_name(part.name), frozenset(part.extras)))
    return found


def megabytes(name: str) -> float:
    """Size of a distribution's files [MB], without those of an editable install."""
    paths = (Path(str(file.locate())) for file in distribution(name).files or ())
    return sum(path.stat().st_size for path in paths if path.is_file()) / 1e6


def seconds(code: str, runs: int) -> float:
    """Minimum processor time, user and system, of several interpreters that run `code`."""

    def once() -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-c", code], check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime

    return min(once() for _ in range(runs))


def modules(code: str) -> dict[str, int]:
    """Modules that `code` imports, and the time of each without its own imports."""
    command = [sys.executable, "-X", "importtime", "-c", code]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    return {name: int(us) for us, name in _MODULE.findall(said)}


def slowest(module: str, count: int = 4) -> str:
    """Packages with the largest import times, without those that every interpreter loads."""
    always, times = modules("pass"), Counter[str]()
    for name, us in modules(f"import {module}").items():
        if name not in always:
            times[name.partition(".")[0]] += us
    return ", ".join(f"{name} {100 * us / times.total():.0f}" for name, us in times.most_common(count))


def main() -> None:
    """Print both tables as Markdown."""
    wanted = asked(__doc__, largest=12, runs=5)
    sizes = {name: megabytes(name) for name in required("hystmpc")}
    print(f"| of {len(sizes)} distributions | MB |\n|---|---|")
    for name in sorted(sizes, key=lambda n: -sizes[n])[: wanted.largest]:
        print(f"| {name} | {sizes[name]:.0f} |")
    print(f"| all | {sum(sizes.values()):.0f} |\n\n| import | ms | most of it, % |\n|---|---|---|")
    empty = seconds("pass", wanted.runs)
    for module in IMPORTS:
        took = seconds(f"import {module}", wanted.runs) - empty
        print(f"| `{module}` | {1000 * took:.0f} | {slowest(module)} |")


if __name__ == "__main__":
    main()
