"""How training decides, in the study of S2: motion trained on against motion tested on, and length of the windows."""

from __future__ import annotations

import numpy as np

from ..tables import NOTHING, Cell, StudyTable
from .outcome import Outcome, title_of
from .printed import S2_WINDOWS
from .s2_plan import MOTIONS, TRAINING_SETS, split_tested_on
from .s2_views import MOTION_NAMES, UNITS


def cross_table(outcome: Outcome, direction: str, preset: str) -> StudyTable | None:
    """Mean RMSE by training motion and test motion; None without cross-trained models."""
    rows: list[list[Cell]] = []
    for kind in outcome.kinds:
        for train, parts in TRAINING_SETS.items():
            splits = [split_tested_on(part) for part in parts]
            result = outcome.better(splits, kind=kind, direction=direction, preset=preset, train=train, window=None)
            if result is not None:
                means = [float(np.mean(result.figures("rmse_deg", [split_tested_on(m)]))) for m in MOTIONS]
                beta: Cell = NOTHING if result.job.constancy is None else result.job.constancy
                rows.append([title_of(kind), MOTION_NAMES.get(train, train), *means, beta])
    if not rows:
        return None
    unit = UNITS[direction]
    caption = (
        f"Training against test motion (simulated), {direction} map, preset {preset}: mean RMSE [{unit}]. Each is "
        "the better of its betas on its own motion; mixed training has the last beta only. The paper finds models "
        "worse on the other motion, and models trained on both worse than matched ones; it prints no numbers."
    )
    columns = ("model", "trained on", *(f"tested on {MOTION_NAMES[m]} [{unit}]" for m in MOTIONS), "beta")
    return StudyTable(f"cross_training_{direction}_{preset}", columns, rows, caption)


def window_table(outcome: Outcome) -> StudyTable | None:
    """Error by length of the training windows; None without that stage."""
    rows: list[list[Cell]] = []
    for result in outcome.matching(stage="window"):
        window = result.job.window or 0
        mse = 1e4 * (min(e for _, e in result.history) / 90.0) ** 2 if result.history else NOTHING
        code = S2_WINDOWS.get(result.job.kind, {}).get(window, NOTHING)
        figures = result.figures("rmse_deg", [split_tested_on("sin")])
        rows.append([title_of(result.job.kind), window, window * 0.04, float(np.mean(figures)), mse, str(code)])
    if not rows:
        return None
    columns = ("model", "window [samples]", "[s]", "test RMSE [deg]", "validation MSE [1e-4]", "paper's code [1e-4]")
    caption = (
        "Window study (simulated), forward map, sinusoids, beta 0; length of the training windows (LSTM) or of the "
        "history buffer (FNN-HIB): mean RMSE of free runs over the test trials, and "
        "mean square error of theta/90 on validation windows beside that of the authors' code."
    )
    return StudyTable("window_study", columns, rows, caption)
