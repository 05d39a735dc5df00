"""Friction of pneumatic seals: kinds of model on withheld strokes and on a withheld pressure.

Run: python benchmarks/seal_friction.py FOLDER [--kinds maxwell_slip,auto]

The folder holds `{seal}_{pressure}bar.tsv` of github.com/EvaZillen/3D-printed-pneumatic-actuator (CC0), laid out as in
examples/seal_friction.yaml.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hystmpc.models.contract.export import export_onnx
from hystmpc.models.evaluate import evaluate
from hystmpc.models.identify.chain_kinds import branch
from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.models.kinds.kind import FitRequest
from hystmpc.models.load import load_model
from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.read import read_trials
from hystmpc.trials.segments import Motion
from hystmpc.trials.trial import Trial, resample, without_loose_ends
from hystmpc.trials.types import Vec

LAYOUT = str(Path(__file__).parents[1] / "examples/seal_friction.yaml")
KINDS = "maxwell_slip,maxwell_slip_rate,auto,bouc_wen,pi,play_kernel"
RATE_HZ, GAP_S = 25.0, 0.35  # the rig's logger pauses for 0.3 s while it moves on: 6 mm of 40
FITTED = 0.6  # of the time of a file; the rest is withheld
SEAL, SEEN, WITHHELD = "O-ring", (1.0, 3.0), 7.0  # bar


def read(path: Path) -> Trial:
    """A log at one rate."""
    return resample(without_loose_ends(read_trials(path, LAYOUT)[0], GAP_S), RATE_HZ, GAP_S)


def predicted(kind: str, trials: Sequence[Trial], others: Sequence[Trial]) -> tuple[list[Vec], float]:
    """Free runs over others of a kind fitted to trials, and the time of the fit [s]."""
    started = time.perf_counter()
    chosen = kind_named(kind)
    found = chosen.fit(trials, FitRequest(chosen.usual_preset(False)))
    seconds = time.perf_counter() - started
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        export_onnx(found.bundle, path)
        model = load_model(path)
        print(f"    {kind}: {found.report}")
        return [evaluate(model, other).theta for other in others], seconds


def half_height(trial: Trial) -> float:
    """Half the distance of the branches at the middle of the stroke [N]: the friction force."""
    middle = 0.5 * float(trial.command.max() + trial.command.min())
    rise, fall = (np.polyval(branch([trial], way, rises=False), middle) for way in (Motion.LOADING, Motion.UNLOADING))
    return 0.5 * float(rise - fall)


def withheld_strokes(path: Path, kinds: Sequence[str]) -> None:
    """Fit to the first strokes of a file, score on the last."""
    whole = read(path)
    cut = int(FITTED * len(whole))
    seen, left = whole.select(0, cut), slice(cut, len(whole))
    still = float(np.std(whole.angle[left]))
    print(f"{path.stem}: friction {half_height(whole):.3g} N, standard deviation of the withheld force {still:.3g} N")
    for kind in kinds:
        try:
            (theta,), seconds = predicted(kind, [seen], [whole])
        except HystmpcError as error:
            print(f"  {kind:18s} refused: {error}")
            continue
        rmse = float(np.std((theta - whole.angle)[left]))
        print(
            f"  {kind:18s} {rmse:7.3f} N  {100 * rmse / float(np.ptp(whole.angle)):5.1f} % of range  {seconds:5.1f} s"
        )


def withheld_pressure(folder: Path, kinds: Sequence[str]) -> None:
    """Fit to the low pressures, score on the high one; friction as it is, and scaled by a line over the pressure."""
    trials = {p: read(folder / f"{SEAL}_{p:g}bar.tsv") for p in (*SEEN, WITHHELD)}
    trials = {p: replace(t, angle=t.angle - t.angle.mean()) for p, t in trials.items()}
    heights = {p: half_height(t) for p, t in trials.items()}
    slope, offset = np.polyfit(SEEN, [heights[p] for p in SEEN], 1)
    law = float(offset + slope * WITHHELD)
    print(f"{SEAL}: friction " + ", ".join(f"{h:.3g} N at {p:g} bar" for p, h in heights.items()))
    print(f"  from {SEEN}: {offset:.3g} N + {slope:.3g} N/bar p, {law:.3g} N at {WITHHELD:g} bar")
    test = trials[WITHHELD]
    ones = [replace(trials[p], angle=trials[p].angle / heights[p]) for p in SEEN]
    for kind in kinds:
        (plain,), _ = predicted(kind, [trials[p] for p in SEEN], [test])
        (scaled,), _ = predicted(kind, ones, [replace(test, angle=test.angle / law)])
        errors = [float(np.std(theta - test.angle)) for theta in (plain, law * scaled)]
        print(f"  {kind:18s} {errors[0]:7.3f} N as it is  {errors[1]:7.3f} N scaled")


def main() -> None:
    """The two tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--kinds", default=KINDS)
    given = parser.parse_args()
    kinds = given.kinds.split(",")
    for path in sorted(given.folder.glob("*.tsv")):
        withheld_strokes(path, kinds)
    withheld_pressure(given.folder, kinds)


if __name__ == "__main__":
    main()
