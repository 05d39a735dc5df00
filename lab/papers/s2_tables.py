"""Jobs and tables of the study of S2: errors by model, signed-rank tests (Table I), training motions, windows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hystmpc.models.kinds.catalogue import kind_names
from hystmpc.trials.types import Vec

from ..page import NOTHING, Cell, StudyTable
from ..statistics import SignedRank, least_p, pairwise
from .job import (
    WINDOWS,
    JobResult,
    PaperOutcome,
    Splits,
    TrainingJob,
    TrainingTask,
    betas_for,
    preset_for,
    steps_for,
    title_of,
)
from .printed import S2_ORDER, S2_RELATIVE, S2_VALIDATION, S2_WINDOWS, Printed, s2_symbol
from .settings import PaperSettings

MOTIONS = ("sin", "p2p")
TRAINING_SETS = {"sin": ("sin",), "p2p": ("p2p",), "mixed": MOTIONS}
MOTION_NAMES = {"sin": "sinusoids", "p2p": "point-to-point"}
UNITS = {"forward": "deg", "inverse": "mm"}
BASELINE = "fnn"


def split_tested_on(motion: str) -> str:
    """Test split of a motion."""
    return f"{motion}/test"


def s2_tasks(settings: PaperSettings, splits: Splits) -> tuple[TrainingTask, ...]:
    """Tasks of every model on each motion (`main`), on both (`cross`), and with other windows (`window`).

    Everything is tested on both motions. Mixed training has only the last beta, since the data contain the holds that
    the term is for.
    """
    jobs: list[TrainingJob] = []
    if "main" in settings.stages:
        jobs += [job for train in MOTIONS for job in _jobs(settings, "main", train, settings)]
    if "cross" in settings.stages:
        one = settings.model_copy(update={"betas": settings.betas[-1:]})
        jobs += _jobs(settings, "cross", "mixed", one)
    if "window" in settings.stages:
        jobs += _window_jobs(settings)
    return tuple(_task(job, splits) for job in jobs)


def _jobs(settings: PaperSettings, stage: str, train: str, betas: PaperSettings) -> Iterator[TrainingJob]:
    kinds = [kind for kind in settings.kinds if kind not in settings.left_out]
    for kind in kinds:
        for preset in dict.fromkeys(preset_for(kind, asked) for asked in settings.presets):
            steps = steps_for(kind, preset, settings)
            for direction in settings.directions:
                for beta in betas_for(kind, preset, betas):
                    yield TrainingJob(stage, kind, preset, direction, train, beta, settings.seed, steps)


def _window_jobs(settings: PaperSettings) -> Iterator[TrainingJob]:
    """Forward jobs on sinusoids with beta 0, for comparison with numbers of the published code."""
    for kind, windows in WINDOWS.items():
        if kind in settings.kinds and kind not in settings.left_out:
            steps = steps_for(kind, "paper", settings)
            for window in windows:
                yield TrainingJob("window", kind, "paper", "forward", "sin", 0.0, settings.seed, steps, window=window)


def _task(job: TrainingJob, splits: Splits) -> TrainingTask:
    parts = TRAINING_SETS[job.train]
    training = tuple(trial for part in parts for trial in splits[f"{part}/train"])
    validation = tuple(trial for part in parts for trial in splits[f"{part}/val"])
    return TrainingTask(
        job, training, validation, {split_tested_on(motion): splits[split_tested_on(motion)] for motion in MOTIONS}
    )


@dataclass(frozen=True, eq=False)
class Matched:
    """Models trained and tested on one motion, in one direction, with one preset."""

    outcome: PaperOutcome
    motion: str
    direction: str
    preset: str

    @cached_property
    def results(self) -> dict[str, JobResult]:
        """Results with the better beta, by kind."""
        wanted = {"stage": "main", "direction": self.direction, "preset": self.preset, "train": self.motion}
        split = [split_tested_on(self.motion)]
        found = {kind: self.outcome.better(split, kind=kind, **wanted) for kind in self.outcome.kinds}
        return {kind: result for kind, result in found.items() if result is not None}

    def errors(self, kind: str, name: str = "rmse_deg") -> Vec:
        """Figure of every test trial (N,)."""
        return self.results[kind].figures(name, [split_tested_on(self.motion)])

    def other_betas(self, kind: str) -> str:
        """Mean RMSE of the models with the worse beta, as text."""
        chosen, split = self.results[kind], [split_tested_on(self.motion)]
        wanted = {"stage": "main", "kind": kind, "direction": self.direction, "preset": self.preset}
        others = [r for r in self.outcome.matching(train=self.motion, **wanted) if r is not chosen]
        means = [f"{np.mean(r.figures('rmse_deg', split)):.4g} (beta {r.job.constancy:g})" for r in others]
        return ", ".join(means) or "-"

    @property
    def tests(self) -> tuple[SignedRank, ...]:
        """Signed-rank tests of the RMSE, models in the order of the paper's table."""
        return pairwise({kind: self.errors(kind) for kind in self.results})

    @property
    def suffix(self) -> str:
        """End of a table's name."""
        return f"{self.direction}_{self.motion}_{self.preset}"

    @property
    def where(self) -> str:
        """Text of the combination for captions."""
        return f"{self.direction} map, {MOTION_NAMES[self.motion]}, preset {self.preset}"


def matched(outcome: PaperOutcome) -> list[Matched]:
    """All combinations that have results."""
    views = [
        Matched(outcome, motion, direction, preset)
        for preset in outcome.presets
        for direction in outcome.settings.directions
        for motion in MOTIONS
    ]
    return [view for view in views if view.results]


_CATALOGUE = frozenset(kind_names())


def errors_table(view: Matched) -> StudyTable:
    """Table of mean, spread and maximum of the errors, a row a model."""
    unit = UNITS[view.direction]
    rows: list[list[Cell]] = []
    for kind, result in view.results.items():
        rmse, largest = view.errors(kind), view.errors(kind, "max_abs_error_deg")
        means = [float(np.mean(view.errors(kind, name))) for name in ("nrmse", "offset_free_rmse_deg")]
        drift = float(np.max(view.errors(kind, "hold_drift_deg")))
        beta: Cell = NOTHING if result.job.constancy is None else result.job.constancy
        others = view.other_betas(kind)
        code = S2_VALIDATION.get((view.direction, view.motion), {}).get(kind, NOTHING)
        figures = [float(np.mean(rmse)), float(np.std(rmse)), float(np.max(rmse)), float(np.max(largest))]
        rows.append([title_of(kind), rmse.size, *figures, 100 * means[0], means[1], drift, beta, others, str(code)])
    columns = ["model", "trials", *(f"{name} [{unit}]" for name in ("mean RMSE", "std of RMSE", "max RMSE", "max abs"))]
    columns += ["mean NRMSE [%]", f"mean offset-free RMSE [{unit}]", f"worst hold drift [{unit}]", "beta"]
    columns += ["mean RMSE of the other beta"]
    caption = (
        f"Simulated, {view.where}: errors over the test trials; of the betas the one with the lower test error, as the "
        f"paper does. Last column: RMSE on validation windows of the authors' device."
    )
    return StudyTable(f"errors_{view.suffix}", [*columns, f"paper's code [{unit}]"], rows, caption)


def trials_table(view: Matched) -> StudyTable:
    """Table of RMSE / max abs / NRMSE of every model on every test trial."""
    split = split_tested_on(view.motion)
    names = [score.trial for score in next(iter(view.results.values())).of_split(split)]
    figures = {
        kind: [view.errors(kind, name) for name in ("rmse_deg", "max_abs_error_deg", "nrmse")] for kind in view.results
    }
    rows = [
        [name.rpartition("/")[2], *(f"{f[0][k]:.3f} / {f[1][k]:.2f} / {100 * f[2][k]:.2f}" for f in figures.values())]
        for k, name in enumerate(names)
    ]
    unit = UNITS[view.direction]
    caption = f"Simulated, {view.where}: RMSE [{unit}] / max abs [{unit}] / NRMSE [%] of every test trial."
    return StudyTable(f"trials_{view.suffix}", ["trial", *map(title_of, view.results)], rows, caption)


def relative_table(view: Matched) -> StudyTable | None:
    """Figure 8 in numbers: errors in percent of the FNN's; None without an FNN."""
    if BASELINE not in view.results:
        return None
    rows: list[list[Cell]] = []
    for kind in view.results:
        printed = S2_RELATIVE.get((view.motion, view.direction, kind), (None, None))
        cells: list[Cell] = [title_of(kind)]
        for ours, paper in zip(relative_to_baseline(view, kind), printed, strict=True):
            cells += [round(ours, 1), str(paper or NOTHING), _difference(ours, paper)]
        rows.append(cells)
    columns = ("model", "mean", "mean in the paper", "difference", "max", "max in the paper", "difference")
    caption = (
        f"Figure 8 in numbers, {view.where}: mean RMSE and greatest error, in per cent of the FNN's. Columns 2 and 5 "
        "are simulated, 3 and 6 the paper's; differences in points."
    )
    return StudyTable(f"relative_to_fnn_{view.suffix}", columns, rows, caption)


def relative_to_baseline(view: Matched, kind: str) -> tuple[float, float]:
    """Mean RMSE and greatest absolute error of a kind over those of the FNN [%]."""
    mean = [float(np.mean(view.errors(name))) for name in (kind, BASELINE)]
    largest = [float(np.max(view.errors(name, "max_abs_error_deg"))) for name in (kind, BASELINE)]
    return 100 * mean[0] / mean[1], 100 * largest[0] / largest[1]


def order_table(view: Matched) -> StudyTable:
    """Table of the models in ascending order of mean RMSE, and the order of the paper."""
    ours = sorted(view.results, key=lambda kind: float(np.mean(view.errors(kind))))
    paper = " < ".join(", ".join(map(_title, group)) for group in S2_ORDER[view.motion])
    rows = [["simulated", " < ".join(map(title_of, ours))], ["paper, from its conclusions [P]", paper]]
    caption = (
        f"Order by mean RMSE, {view.where}; the paper does not tell apart what stands between commas, and does not "
        "place the GRU on point-to-point motions."
    )
    return StudyTable(f"order_{view.suffix}", ("", "least error first"), rows, caption)


def _title(kind: str) -> str:
    """Name of a kind in tables; the kind itself if the catalogue does not hold it."""
    return title_of(kind) if kind in _CATALOGUE else kind


def _difference(ours: float, paper: Printed | None) -> Cell:
    if paper is None or paper.above or isinstance(paper.value, str):
        return NOTHING
    return round(ours - paper.value, 1)


def long_table(outcome: PaperOutcome) -> StudyTable:
    """Table of every figure of every job on every trial, for CSV only."""
    rows: list[Sequence[Cell]] = []
    for result in outcome.done:
        job = result.job
        what = [job.stage, job.kind, job.preset, job.direction, job.train, str(job.constancy), str(job.window)]
        rows += [[*what, s.split, s.trial, *vars(s.errors).values()] for s in result.scores]
    figures = ("rmse", "bias", "offset_free_rmse", "max_abs_error", "nrmse", "hold_drift")
    columns = ("stage", "kind", "preset", "direction", "trained_on", "beta", "window", "split", "trial", *figures)
    return StudyTable("per_trial", columns, rows, "", shown=False)


def wilcoxon_table(view: Matched) -> StudyTable | None:
    """Table I: signed-rank tests of every pair with the paper's symbols; None for a single model."""
    tests = view.tests
    if not tests:
        return None
    rows: list[list[Cell]] = []
    for test in tests:
        printed = s2_symbol(view.motion, view.direction, test.row, test.column)
        same = NOTHING if printed is None else ("yes" if printed.value == test.symbol else "no")
        shown = [f"{p:.2g}" for p in (test.p_less, test.p_greater, test.p, test.p_holm)]
        rows.append(
            [
                title_of(test.row),
                title_of(test.column),
                test.n,
                test.symbol,
                str(printed or NOTHING),
                same,
                *shown,
                test.symbol_holm,
            ]
        )
    agree, known = [sum(row[5] == "yes" for row in rows), sum(row[5] != NOTHING for row in rows)]
    n = max(test.n for test in tests)
    caption = (
        f"Table I, {view.where}: Wilcoxon signed-rank tests of the RMSE over {n} simulated test trials; row < column: "
        f"the row's error is smaller. {agree} of {known} known signs of the paper agree. One-sided exact p is at least "
        f"{least_p(n):.2g}; the paper corrects nothing, Holm's correction is over the {len(rows)} two-sided tests here."
    )
    columns = ("row", "column", "n", "simulated", "paper", "agree", "p row less", "p row greater", "p two-sided")
    return StudyTable(f"wilcoxon_{view.suffix}", (*columns, "p Holm", "sign by Holm"), rows, caption)


def symbols_table(outcome: PaperOutcome, preset: str, motion: str) -> StudyTable | None:
    """Table I in the paper's layout: forward / inverse, own result and the paper's in brackets."""
    views = {v.direction: v for v in matched(outcome) if v.preset == preset and v.motion == motion}
    signs = {(t.row, t.column, d): t.symbol for d, view in views.items() for t in view.tests}
    kinds = [kind for kind in outcome.kinds if any(kind in view.results for view in views.values())]
    if len(kinds) < len(("row", "column")):
        return None

    def cell(row: str, column: str) -> str:
        ours = " / ".join(signs.get((row, column, d), NOTHING) for d in UNITS)
        known = [s2_symbol(motion, d, row, column) for d in UNITS]
        paper = " / ".join(str(p.value) if p else NOTHING for p in known)
        return f"{ours}  ({paper})" if any(known) else ours

    rows = [
        [title_of(row), *(cell(row, column) if j < i else "" for j, column in enumerate(kinds[:-1]))]
        for i, row in enumerate(kinds)
        if i
    ]
    mark = "[P]" if motion == "p2p" else "[I], from the text: the printed rows are lost"
    caption = (
        f"Table I, {MOTION_NAMES[motion]}, preset {preset}: forward / inverse, row against column; simulated, in "
        f"brackets the paper's {mark}."
    )
    return StudyTable(f"table_1_{motion}_{preset}", ["", *map(title_of, kinds[:-1])], rows, caption)


def cross_table(outcome: PaperOutcome, direction: str, preset: str) -> StudyTable | None:
    """Table of mean RMSE by training motion and test motion; None without cross-trained models."""
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


def window_table(outcome: PaperOutcome) -> StudyTable | None:
    """Table of the error by length of the training windows; None without that stage."""
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
