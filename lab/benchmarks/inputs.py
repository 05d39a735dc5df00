"""Errors at values of a measured input that a fit has not seen, beside those of a model that was fitted there.

    python lab/benchmarks/inputs.py [--pair] [--seals FOLDER] [--seal O-ring] [--levels 1 1.33 1.67 2]
        [--withheld 1.17 1.5 1.83]

Without a folder: the simulated tendon catheter, whose friction is proportional to the input and doubles over its
range. It is made of 40 friction elements with a rough tendon: no operator is that device. With a folder: recorded seals
of that name. Each pressure is withheld in turn; the fit is told the range of all. `fitted there` is identified from the
first 60 % of the withheld file. Both models are scored on the rest of it, less the mean error. With `--pair` the same
catheter is pulled by two opposed tendons: the command is their difference, and the input their sum z, the
co-contraction. It stiffens the joint, so that the catheter gets 2 / (1 + z) of the difference, and its friction is
proportional to z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from kit import asked

from hystmpc.models.evaluate import evaluate
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.kinds.operator_kinds import AutoKind
from hystmpc.models.simulator import ChainModel
from hystmpc.sim.devices.names import named_device
from hystmpc.sim.plants.device import DevicePlant
from hystmpc.sim.plants.simulated import Effects
from hystmpc.trials.layouts import LogMapping
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

DT_S, DURATION_S, FRICTION = 0.04, 40.0, 0.55
SEALS = LogMapping.parse(
    {
        "command": {"signal": "[4]", "unit": "mm"},
        "angle": {"signal": "[6]", "unit": "N"},
        "inputs": {"pressure_bar": "[5]"},
        "time": "[0]",
        "time_unit": "ms",
    }
)
NAME, SEEN = "pressure_bar", 0.6


def motion(kind: int, seed: int) -> Vec:
    """Commands (T,) [mm]: a decaying sinusoid, or ramps between random points."""
    t = np.arange(0.0, DURATION_S, DT_S)
    if kind == 0:
        return np.asarray(3.0 - 2.8 * np.cos(2 * np.pi * (0.1 + 0.01 * seed) * t) * np.exp(-0.03 * t))
    rng = np.random.default_rng(seed)
    at = np.concatenate([[0.0], np.sort(rng.uniform(0.0, DURATION_S, 16)), [DURATION_S]])
    return np.interp(t, at, np.concatenate([[0.2], rng.uniform(0.2, 5.8, 17)]))


def recorded(level: float, seeds: Sequence[int], pair: bool = False) -> list[Trial]:
    """Trials of the simulated catheter at one value of the input, of one tendon or of an opposed pair."""
    made, share = [], 2 / (1 + level) if pair else 1.0
    for kind, seed in enumerate(seeds):
        device = named_device("tendon", {"friction": FRICTION * level}, {})
        plant = DevicePlant(device, Effects(noise_deg=0.05), DT_S, seed=seed)
        u = motion(kind % 2, seed)
        first, source = plant.reset(), f"{level:g}, {seed}"
        y = np.array([first, *(plant.apply(share * float(v)) for v in u[:-1])])
        t, inputs = DT_S * np.arange(u.size), {NAME: np.full(u.size, level)}
        made.append(Trial(t, np.r_[u[0], u[:-1]], y, units=Units("mm", "deg"), source=source, inputs=inputs))
    return made


def errors(seen: Sequence[Trial], tests: Sequence[Trial], with_input: bool, before: Sequence[Trial] = ()) -> Vec:
    """Root mean square errors of `auto`, less their means, on each test."""
    names = [NAME] if with_input else []
    values = np.concatenate([trial.inputs[NAME] for trial in (*seen, *tests)])
    request = FitRequest(ranges={NAME: (float(values.min()), float(values.max()))})
    fit = AutoKind().fit([trial.with_inputs(names) for trial in seen], request)
    assert fit.simulator is not None
    model, earlier = ChainModel(fit.simulator), list(before) or [None] * len(tests)
    runs = [evaluate(model, trial, before=part) for trial, part in zip(tests, earlier, strict=True)]
    print(f"    {fit.report}")
    return np.array([run.errors.offset_free_rmse_deg for run in runs])


def simulated(levels: Sequence[float], withheld: Sequence[float], pair: bool) -> list[tuple[str, Vec, Vec, Vec]]:
    """Rows: value, errors with the input, without it, and fitted there."""
    seen = [trial for k, level in enumerate(levels) for trial in recorded(level, (2 * k, 2 * k + 1), pair)]
    tests = {level: recorded(level, (100, 101), pair) for level in withheld}
    every = [trial for level in withheld for trial in tests[level]]
    known, unknown = (errors(seen, every, with_input) for with_input in (True, False))
    rows = []
    for k, level in enumerate(withheld):
        there = errors(recorded(level, (50, 51, 52, 53), pair), tests[level], False)
        rows.append((f"{level:g}", known[2 * k : 2 * k + 2], unknown[2 * k : 2 * k + 2], there))
    return rows


def centred(path: Path) -> list[Trial]:
    """Trials of a file less their mean force: that is of the pressure on the piston, not of the seal."""
    trials = read_trials(path, SEALS, rate_hz=1 / DT_S)
    mean = float(np.concatenate([trial.angle for trial in trials]).mean())
    return [replace(trial, angle=trial.angle - mean) for trial in trials]


def seals(folder: Path, seal: str) -> list[tuple[str, Vec, Vec, Vec]]:
    """The same of recorded seals; each pressure is withheld."""
    logs = {path: centred(path) for path in sorted(folder.glob(f"{seal}_*bar.tsv"))}
    rows = []
    for path in logs:
        seen = [trial for other in logs if other != path for trial in logs[other]]
        trial = max(logs[path], key=len)
        cut = round(SEEN * len(trial))
        head, tail = trial.select(0, cut), trial.select(cut)
        known, unknown = (errors(seen, [tail], with_input, [head]) for with_input in (True, False))
        rows.append((path.stem, known, unknown, errors([head], [tail], False, [head])))
    return rows


def main() -> int:
    """Print a row for each withheld value."""
    given = asked(
        __doc__,
        pair=False,
        seals={"type": Path},
        seal={"default": "O-ring"},
        levels={"type": float, "nargs": "+", "default": [1.0, 1.33, 1.67, 2.0]},
        withheld={"type": float, "nargs": "+", "default": [1.17, 1.5, 1.83]},
    )
    rows = seals(given.seals, given.seal) if given.seals else simulated(given.levels, given.withheld, given.pair)
    print(f"{'withheld':>16} {'with input':>12} {'without':>12} {'fitted there':>12} {'over that':>10}")
    for name, *of_models in rows:
        known, unknown, there = (float(np.sqrt(np.mean(values**2))) for values in of_models)
        print(f"{name:>16} {known:12.3f} {unknown:12.3f} {there:12.3f} {known / there:10.2f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
