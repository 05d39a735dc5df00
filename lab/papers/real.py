"""Study on recorded logs: every log is tested by models trained without it; comparison of several devices."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from matplotlib.figure import Figure
from pydantic import Field

from hystmpc.models.evaluate import Errors
from hystmpc.models.kinds.catalogue import kind_names
from hystmpc.trials.config import Settings, read_yaml
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.report import (
    REFERENCE,
    Heading,
    Paragraph,
    Piece,
    Plot,
    Report,
    new_figure,
)
from hystmpc.trials.types import Vec

from ..page import NOTHING, Cell, StudyTable
from ..statistics import compared, least_p
from .job import (
    LOGS,
    JobResult,
    PaperOutcome,
    Score,
    Splits,
    TrainingJob,
    TrainingTask,
    before,
    betas_for,
    preset_for,
    steps_for,
    title_of,
)
from .printed import COLOURS, jobs_pieces, jobs_table, paper_set_up
from .settings import PaperSettings

BASELINE = "backlash"
COUNTS = {"later": "without the first flexure", "errors": "with the first flexure"}
_SHOWN = 2  # of the best models beside the backlash


def real_tasks(settings: PaperSettings, splits: Splits) -> tuple[TrainingTask, ...]:
    """Leave-one-trial-out over the logs, for every kind, preset and direction; training skips the first flexure.

    The backlash is always among the kinds, as the baseline of the comparison.
    """
    names = [kind for kind in settings.kinds if kind not in settings.left_out]
    kinds = dict.fromkeys([BASELINE, *names])
    logs, tasks = splits[LOGS], []
    for kind in kinds:
        for preset in dict.fromkeys(preset_for(kind, asked) for asked in settings.presets):
            steps = steps_for(kind, preset, settings)
            for direction in settings.directions:
                for beta in betas_for(kind, preset, settings):
                    for k, held_out in enumerate(logs):
                        fold = f"{k + 1}_{Path(held_out.source).stem}"
                        job = TrainingJob(
                            "main", kind, preset, direction, fold, beta, settings.seed, steps, skip_first_flexure=True
                        )
                        others = tuple(log for log in logs if log is not held_out)
                        tasks.append(
                            TrainingTask(job, others, (), {LOGS: (held_out,)}, before(held_out, logs, settings.parts))
                        )
    return tuple(tasks)


@dataclass(frozen=True, eq=False)
class RealCandidate:
    """Kind, preset and beta with a score for every log.

    Attributes:
        results: one for each log that is left out, in the order of the logs.
    """

    kind: str
    preset: str
    beta: float | None
    results: tuple[JobResult, ...]

    @property
    def name(self) -> str:
        """Name in tables."""
        beta = "" if self.beta is None else f", beta {self.beta:g}"
        return f"{title_of(self.kind)} ({self.preset}{beta})"

    @property
    def scores(self) -> tuple[Score, ...]:
        """Scores, one for each log."""
        return tuple(score for result in self.results for score in result.scores)

    def figures(self, name: str, count: str) -> Vec:
        """One figure of `Errors` a log (N,); over the whole trial where the command never turns."""
        return np.array([getattr(_counted(score, count), name) for score in self.scores])


def _counted(score: Score, count: str) -> Errors:
    return score.later or score.errors if count == "later" else score.errors


def candidates(outcome: PaperOutcome, direction: str) -> tuple[tuple[RealCandidate, ...], tuple[RealCandidate, ...]]:
    """Candidates with a score for every log, and incomplete ones, which are not compared."""
    groups: dict[tuple[str, str, float | None], list[JobResult]] = {}
    for result in outcome.results:
        if result.job.direction == direction:
            key = result.job.kind, result.job.preset, result.job.constancy
            groups.setdefault(key, []).append(result)
    whole: list[RealCandidate] = []
    broken: list[RealCandidate] = []
    for key, results in groups.items():
        complete = all(result.status == "done" for result in results)
        (whole if complete else broken).append(RealCandidate(*key, tuple(results)))
    return tuple(whole), tuple(broken)


def baseline_of(found: Sequence[RealCandidate]) -> RealCandidate | None:
    """Baseline: the 4-parameter backlash with the preset of the lowest error."""
    own = [candidate for candidate in found if candidate.kind == BASELINE]
    return min(own, key=lambda c: float(np.mean(c.figures("offset_free_rmse_deg", "later"))), default=None)


def errors_table(found: Sequence[RealCandidate], direction: str, unit: str, count: str) -> StudyTable:
    """Table of means over the logs, best model first."""
    base = baseline_of(found)
    names = ("offset_free_rmse_deg", "rmse_deg", "max_abs_error_deg", "nrmse", "hold_drift_deg")
    rows: list[list[Cell]] = []
    for c in sorted(found, key=lambda c: float(np.mean(c.figures(names[0], count)))):
        means = [float(np.mean(c.figures(name, count))) for name in names]
        ratio: Cell = means[0] / float(np.mean(base.figures(names[0], count))) if base else NOTHING
        drift = float(np.max(c.figures("hold_drift_deg", count)))
        rows.append([c.name, means[0], ratio, means[1], means[2], 100 * means[3], means[4], drift])
    columns = ["model", f"offset-free RMSE [{unit}]", "over the backlash's", f"RMSE [{unit}]", f"max abs [{unit}]"]
    columns += ["NRMSE [%]", f"hold drift [{unit}]", f"worst hold drift [{unit}]"]
    caption = (
        f"Real logs, leave-one-trial-out, {direction} map, {COUNTS[count]}: means over "
        f"{len(found[0].scores) if found else 0} trials, each by a model that was identified on the others. Ratios to "
        f"{base.name if base else 'the backlash, which is missing'}."
    )
    return StudyTable(f"real_{direction}_{count}", columns, rows, caption)


def trials_table(found: Sequence[RealCandidate], direction: str, unit: str, count: str) -> StudyTable:
    """Table of the offset-free RMSE of every model on every log."""
    logs = [Path(score.trial).name for score in found[0].scores] if found else []
    rows: list[list[Cell]] = [[c.name, *map(float, c.figures("offset_free_rmse_deg", count))] for c in found]
    caption = f"Real logs, {direction} map, {COUNTS[count]}: offset-free RMSE [{unit}] of every trial."
    return StudyTable(f"real_trials_{direction}_{count}", ["model", *logs], rows, caption)


def signed_rank_table(found: Sequence[RealCandidate], direction: str, count: str) -> StudyTable | None:
    """Table of Wilcoxon's signed-rank tests of every model against the backlash; None without both."""
    base = baseline_of(found)
    if base is None or len(found) < len((base, "another")):
        return None
    errors = {c.name: c.figures("offset_free_rmse_deg", count) for c in found}
    tests = compared(errors, [(name, base.name) for name in errors if name != base.name])
    rows: list[list[Cell]] = []
    for test in tests:
        shown = [f"{p:.2g}" for p in (test.p_less, test.p_greater, test.p, test.p_holm)]
        rows.append([test.row, test.column, test.n, test.symbol, *shown, test.symbol_holm])
    n = len(base.scores)
    caption = (
        f"Real logs, {direction} map, {COUNTS[count]}: Wilcoxon signed-rank tests of the offset-free RMSE over {n} "
        f"trials; row < column: the row's error is smaller. With {n} trials no one-sided p can be below "
        f"{least_p(n):.2g}. Holm's correction is over these {len(rows)} two-sided tests."
    )
    columns = ("row", "column", "n", "sign", "p row less", "p row greater", "p two-sided", "p Holm", "sign by Holm")
    return StudyTable(f"real_wilcoxon_{direction}_{count}", columns, rows, caption) if rows else None


def presets_table(found: Sequence[RealCandidate], direction: str, unit: str) -> StudyTable | None:
    """Table of all presets for every kind; None if each has only one."""
    presets = tuple(dict.fromkeys(c.preset for c in found))
    means = {(c.kind, c.preset): float(np.mean(c.figures("offset_free_rmse_deg", "later"))) for c in found}
    rows: list[list[Cell]] = []
    for kind in dict.fromkeys(c.kind for c in found):
        cells: list[Cell] = [means.get((kind, preset), NOTHING) for preset in presets]
        if sum(cell != NOTHING for cell in cells) > 1:
            rows.append([title_of(kind), *cells])
    caption = (
        f"Real logs, {direction} map, {COUNTS['later']}: mean offset-free RMSE [{unit}] by preset of the training."
    )
    return StudyTable(f"real_presets_{direction}", ["model", *presets], rows, caption) if rows else None


def real_report(outcome: PaperOutcome) -> tuple[Report, list[StudyTable]]:
    """Page of the study, and all tables that are written as CSV."""
    pieces = [piece for direction in outcome.settings.directions for piece in _direction(outcome, direction)]
    tables = [piece for piece in pieces if isinstance(piece, StudyTable)]
    shown = [piece.piece if isinstance(piece, StudyTable) else piece for piece in pieces]
    trials = outcome.drawn[LOGS]
    page = Report(
        "Study on recorded logs, leave-one-trial-out",
        (*paper_set_up(outcome), *shown, *jobs_pieces(outcome)),
        f"real logs: {', '.join(Path(trial.source).name for trial in trials)}",
    )
    return page, [*tables, jobs_table(outcome)]


def _direction(outcome: PaperOutcome, direction: str) -> Iterator[Piece | StudyTable]:
    units = outcome.drawn[LOGS][0].units
    unit = units.angle if direction == "forward" else units.command
    found, broken = candidates(outcome, direction)
    yield Heading(f"{direction.capitalize()} map")
    for candidate in broken:
        yield Paragraph(f"Not compared, some of its fits failed: {candidate.name}.")
    turned = [score.later is not None for c in found for score in c.scores]
    if not all(turned):
        yield Paragraph("Trials whose command never turns are counted whole in either way of counting.")
    if not found:
        return
    for count in COUNTS:
        yield errors_table(found, direction, unit, count)
    presets = presets_table(found, direction, unit)
    if presets is not None:
        yield presets
    yield Plot(examples_figure(outcome, found, unit), "Real: errors over time of the best models and the backlash.")
    for count in COUNTS:
        yield trials_table(found, direction, unit, count)
        tests = signed_rank_table(found, direction, count)
        if tests is not None:
            yield tests


def examples_figure(outcome: PaperOutcome, found: Sequence[RealCandidate], unit: str) -> Figure:
    """Plot of the error over time on every held-out log, of the backlash and the best models."""
    base = baseline_of(found)
    ranked = sorted(found, key=lambda c: float(np.mean(c.figures("offset_free_rmse_deg", "later"))))
    best = {c.kind: c for c in reversed(ranked) if base is None or c.kind != base.kind}
    shown = [c for c in ranked if best.get(c.kind) is c][:_SHOWN] + ([base] if base else [])
    trials = outcome.drawn[LOGS]
    with new_figure(7.0, 0.6 + 1.3 * len(trials)) as figure:
        rows = figure.subplots(len(trials), 1, sharey=True, squeeze=False)[:, 0]
        for k, (axes, trial) in enumerate(zip(rows, trials, strict=True)):
            for candidate, colour in zip(shown, COLOURS, strict=False):
                run = outcome.free_run(candidate.results[k].job, trial)
                axes.plot(trial.t, run.theta - run.trial.angle, color=colour, linewidth=0.8, label=candidate.name)
            axes.axhline(0.0, color=REFERENCE, linewidth=0.6)
            axes.set_title(Path(trial.source).name, fontsize=8)
        figure.supylabel(f"error [{unit}]", fontsize=9.0)
        rows[-1].set_xlabel("time [s]")
        figure.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


DEVICES_KINDS = tuple(name for name in kind_names() if name not in ("oscillator", "state_network"))
"""All kinds but those for devices that ring."""


class DeviceLogs(Settings):
    """Logs of one device.

    Attributes:
        logs: files, beside the file that names them; each is left out once.
        layout: layout of the logs, or a mapping file beside that file.
        rate_hz: rate to which they are resampled [Hz].
        parts: equal parts that each log is cut into, for devices of which one log is all there is.
    """

    logs: Annotated[tuple[str, ...], Field(min_length=1)]
    layout: str = "auto"
    rate_hz: Annotated[float, Field(gt=0)] = 25.0
    parts: Annotated[int, Field(ge=1, le=20)] = 1


def device_settings(file: Path, **changes: Any) -> dict[str, PaperSettings]:
    """Settings of the study on the logs of each device that a file lists.

    Raises:
        ConfigError: if the file is no list of devices, or a device's settings are wrong.
    """
    content = read_yaml(file)
    if not isinstance(content, dict) or not content:
        raise ConfigError(f"{file}: expected devices by name, each with its logs")
    found = {}
    for name, own in content.items():
        device, beside = DeviceLogs.parse(own, f"{file}: {name}"), file.parent
        layout = beside / device.layout
        found[str(name)] = PaperSettings.for_study(
            "real",
            logs=[str(beside / log) for log in device.logs],
            layout=str(layout) if layout.is_file() else device.layout,
            rate_hz=device.rate_hz,
            parts=device.parts,
            **{"kinds": DEVICES_KINDS, "presets": ("best",)} | {k: v for k, v in changes.items() if v},
        )
    return found


def kinds_report(outcomes: Mapping[str, PaperOutcome]) -> tuple[Report, list[StudyTable]]:
    """Page of the comparison of kinds, and all tables that are written as CSV."""
    found = {name: candidates(outcome, "forward")[0] for name, outcome in outcomes.items()}
    tables = [kinds_errors_table(found), drift_table(found), cost_table(found)]
    failed = [f"{name}: {r.job.kind}: {r.message}" for name, o in outcomes.items() for r in o.failed]
    pieces: list[Piece] = [Paragraph(try_first(found)), *(table.piece for table in tables)]
    pieces += [Heading("Failed fits"), *map(Paragraph, failed)] if failed else []
    return Report("Kinds of model over devices", tuple(pieces), f"real logs of {', '.join(outcomes)}"), tables


Found = Mapping[str, Sequence[RealCandidate]]
"""By device: kinds with a score for every log."""


def error_percent(candidate: RealCandidate) -> float:
    """Offset-free RMSE, mean over the held-out logs [% of the range of each]."""
    return float(np.mean(_of_range(candidate, "offset_free_rmse_deg")))


def _of_range(candidate: RealCandidate, name: str) -> list[float]:
    """Figure of every log in percent of its measured range; the RMSE relative to the range is known."""
    rmse, share = (candidate.figures(figure, "later") for figure in ("rmse_deg", "nrmse"))
    return np.divide(100 * candidate.figures(name, "later") * share, rmse, where=rmse > 0, out=0 * rmse).tolist()


def ratios(found: Found) -> dict[str, dict[str, float]]:
    """Error divided by that of the best kind on the same device, by kind and device."""
    kinds = dict.fromkeys(candidate.kind for own in found.values() for candidate in own)
    errors = {name: {c.kind: error_percent(c) for c in own} for name, own in found.items()}
    return {
        kind: {name: own[kind] / max(min(own.values()), 1e-12) for name, own in errors.items() if kind in own}
        for kind in kinds
    }


def ranked(found: Found) -> list[tuple[str, float, float]]:
    """Ranking of kinds by number of fitted devices, then by mean ratio (geometric): name, mean and worst ratio."""
    own = ratios(found)
    means = {kind: math.exp(float(np.mean(np.log(list(of.values()))))) for kind, of in own.items()}
    order = sorted(own, key=lambda kind: (-len(own[kind]), means[kind]))
    return [(kind, means[kind], max(own[kind].values())) for kind in order]


def try_first(found: Found) -> str:
    """Recommended first kind, in one sentence."""
    if not any(found.values()):
        return "No kind could be fitted."
    (kind, mean, worst), devices = ranked(found)[0], len(found)
    return (
        f"Try {kind} first: over {devices} devices its error is {mean:.2f} times that of the best kind of each in the "
        f"mean, {worst:.2f} times at worst."
    )


def kinds_errors_table(found: Found) -> StudyTable:
    """Table of errors, kinds by devices."""
    rows: list[list[Cell]] = [
        [kind, *_cells(found, kind, error_percent), mean, worst] for kind, mean, worst in ranked(found)
    ]
    columns = ("kind", *found, "over the best, mean", "over the best, worst")
    caption = (
        "Real logs: offset-free RMSE in per cent of the measured range, from the first reversal on, mean over "
        "logs each of which was left out once. Over the best: ratio to the best kind of a device, geometric mean and "
        "worst."
    )
    return StudyTable("kinds_errors", columns, rows, caption)


def drift_table(found: Found) -> StudyTable:
    """Table of each kind's output drift while the command rests."""
    rows: list[list[Cell]] = [
        [kind, *_cells(found, kind, lambda c: max(_of_range(c, "hold_drift_deg")))] for kind, _, _ in ranked(found)
    ]
    caption = (
        "Real logs: greatest range of the model's output while the command rests, from 1 s after it came to rest, in "
        "per cent of the measured range. The last command of each log is held for 10 s."
    )
    return StudyTable("kinds_drift", ("kind", *found), rows, caption)


def cost_table(found: Found) -> StudyTable:
    """Table of fit time and size of each kind."""
    rows: list[list[Cell]] = []
    for kind, _, _ in ranked(found):
        seconds = _cells(found, kind, lambda c: float(np.median([r.seconds for r in c.results])))
        sizes = sorted({r.numbers for own in found.values() for c in own if c.kind == kind for r in c.results})
        rows.append([kind, *seconds, "-".join(dict.fromkeys(str(n) for n in (sizes[0], sizes[-1])))])
    caption = "Median time of a fit with its export and scores [s], one thread, and numbers in a model: least-most."
    return StudyTable("kinds_cost", ("kind", *found, "numbers"), rows, caption)


def _cells(found: Found, kind: str, value: Any) -> list[Cell]:
    """Table cells, one for each device; of several presets the one with the lowest error."""
    cells: list[Cell] = []
    for own in found.values():
        best = min((c for c in own if c.kind == kind), key=error_percent, default=None)
        cells.append(NOTHING if best is None else value(best))
    return cells
