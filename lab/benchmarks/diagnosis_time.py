"""Duration of a diagnosis: ten trials of 60 s at 25 Hz, two effects, the whole library; the goal is 5 s on two idle
cores.

    python lab/benchmarks/diagnosis_time.py [--device rod] [--model pi] [--trials 10] [--seconds 60] [--seed 1]
        [--repeat 2]
    python lab/benchmarks/diagnosis_time.py --trials 100 --seconds 600      # minutes, below 2 GB

The device is one of the blind check (capstan, dahl or rod), with creep in its tendon and a slow servo; its simulator is
identified before these effects are added. Recording and identification do not count. `--repeat 2` shows how far times
vary. The peak of memory is that of the process, recording and identification included.
"""

from __future__ import annotations

import argparse
import os
import resource
import time
from dataclasses import replace

import numpy as np
from kit import asked
from kit import show as table
from rich.console import Console

from hystmpc.gap.diagnose import conclude, find_causes
from hystmpc.models.identify.chain_fit import OperatorFitSettings
from hystmpc.models.identify.simulators import identify
from hystmpc.models.simulator import Simulator
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Vec
from hystmpc_lab.blind.device import BlindDevice
from hystmpc_lab.blind.generators import Withheld, generator_named
from hystmpc_lab.blind.plan import RICH
from hystmpc_lab.devices.cores import RATE_HZ, CapstanCore, DahlCore, RodCore

GOAL_S = 5.0
CORES = {"capstan": CapstanCore, "dahl": DahlCore, "rod": RodCore}
EFFECTS = (
    Withheld(generator_named("tendon_log_creep"), 0.12, {"onset_s": 0.5}),
    Withheld(generator_named("cascaded_servo"), 0.15, {"inner": 2.0, "strokes_per_s": 8.0}),
)
CHECK, WHICH, FAR, REST = "check and retune", "which", "how far", "where, what next"
_NOTES = {"checking the trials": CHECK, "measuring the gap on the final trials": FAR, "where and what next": REST}


class Laps:
    """Wall and processor time of each step of a diagnosis, measured by its progress notes."""

    def __init__(self) -> None:
        self.wall: dict[str, float] = {}
        self.processor: dict[str, float] = {}
        self._step, self._since = CHECK, (time.perf_counter(), time.process_time())

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Callback for the progress of the diagnosis."""
        del done, total
        now = time.perf_counter(), time.process_time()
        for kept, before, after in zip((self.wall, self.processor), self._since, now, strict=True):
            kept[self._step] = kept.get(self._step, 0.0) + after - before
        self._since = now
        self._step = _NOTES.get(note, self._step if self._step in (FAR, REST) else WHICH)


def commands(count: int, seconds: float, random: np.random.Generator) -> list[Vec]:
    """Commands (T,) [mm] of all kinds with the given duration; the last two repeat the first two."""
    made: list[Vec] = []
    for k in range(max(count - 2, 1)):
        parts: list[Vec] = []
        while sum(part.size for part in parts) < seconds * RATE_HZ:
            parts.append(RICH[k % len(RICH)].draw(random))
        made.append(np.concatenate(parts)[: round(seconds * RATE_HZ)])
    return [*made, *made[: count - len(made)]]


def recorded(args: argparse.Namespace) -> tuple[list[Trial], Simulator]:
    """Trials with the effects, and a simulator identified on others without."""
    random = np.random.default_rng(args.seed)
    device = BlindDevice(CORES[args.device].draw(random), 0.05, 0.01, args.seed)
    plain = device.record(commands(5, args.seconds, random))
    named = [replace(trial, source=f"fit_{k}.csv") for k, trial in enumerate(plain)]
    simulator, _ = identify(args.model, named, OperatorFitSettings(restarts=0))
    return device.with_effects(EFFECTS).record(commands(args.trials, args.seconds, random)), simulator


def show(console: Console, laps: Laps, title: str) -> None:
    """Print the table of one diagnosis."""
    wall = sum(laps.wall.values())
    rows = [(step, f"{laps.wall[step]:.2f}", f"{laps.processor[step]:.2f}") for step in laps.wall]
    table(
        ("step", "wall s", "processor s"), [*rows, ("all", f"{wall:.2f}", f"{sum(laps.processor.values()):.2f}")], title
    )
    console.print(f"{'within' if wall <= GOAL_S else 'above'} {GOAL_S:g} s")


def main() -> None:
    """Record, identify, diagnose, print."""
    args = asked(
        __doc__,
        device={"choices": sorted(CORES), "default": "capstan"},
        model=("backlash", "kind of simulator: backlash, pi, ..."),
        trials=10,
        seconds=60.0,
        seed=1,
        repeat=(1, "diagnoses of the same trials, one after another"),
    )
    console = Console()
    trials, simulator = recorded(args)
    for k in range(args.repeat):
        laps = Laps()
        diagnosis, _ = conclude(find_causes(trials, simulator, seed=args.seed, progress=laps, say=console.print), laps)
        laps(100, 100)
        names = ", ".join(effect.name for effect in diagnosis.effects) or "-"
        show(console, laps, f"diagnosis {k + 1}: {diagnosis.verdict}, {names}")
    peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20  # the system counts in KiB
    console.print(f"peak of memory {peak_gb:.2f} GiB")
    load = os.getloadavg()[0]
    seconds = sum(trial.duration_s for trial in trials)
    console.print(
        f"{len(trials)} trials, {seconds:.0f} s at {RATE_HZ:g} Hz, {args.model}; load of the machine {load:.1f}"
    )


if __name__ == "__main__":
    main()
