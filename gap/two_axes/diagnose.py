"""Diagnosis of two axes, from the trials to the folder: joins, each axis without them, the corrected simulator."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hystmpc.models.effects.catalogue import diagnosable
from hystmpc.models.identify.least_squares import one_blas_thread
from hystmpc.models.two_axes.model import AXES, TwoAxisModel
from hystmpc.trials.errors import GapError, nearest
from hystmpc.trials.files import figures_folder, figures_to, write_atomically
from hystmpc.trials.json_text import file_text, plain
from hystmpc.trials.run_folder import RunFolder
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress, parts

from ..diagnose import DiagnosisResult, diagnose_trials
from ..diagnosis import FIXED_FILE, Diagnosis
from ..report.folder import DIAGNOSIS_FILE, renewed, require_free
from .diagnosis import TWO_AXIS_FORMAT, TwoAxisDiagnosis
from .joins import FREE, JoinTrials, find_joins

_TIMES = 20.0, 40.0, 40.0  # of the joins and of each axis
_MOVES = 0.1  # of the greatest range of its travel: an axis that moves less in a trial is not diagnosed from it


@dataclass(frozen=True, eq=False)
class TwoAxisResult:
    """Result of a diagnosis of two axes with the results of its steps.

    Attributes:
        joined: the simulator with the effects between the axes, its axes as given.
        axes: results of x and of y, with the joins taken off.
    """

    diagnosis: TwoAxisDiagnosis
    joined: TwoAxisModel
    axes: tuple[DiagnosisResult, DiagnosisResult]

    def corrected(self, sure: Callable[[Diagnosis], bool]) -> TwoAxisModel:
        """The simulator with the effects between the axes, and each axis corrected where its diagnosis is sure."""
        x, y = (
            fixed.at_sample_time(self.joined.dt_s) if sure(one.diagnosis) and (fixed := one.data.fixed) else given
            for one, given in zip(self.axes, self.joined.axes, strict=True)
        )
        return replace(self.joined, axes=(x, y))


def diagnose_two_axes(
    trials: Sequence[Trial],
    simulator: TwoAxisModel,
    *,
    out: Path | str | None = None,
    called: Mapping[str, Any] | None = None,
    model: Path | None = None,
    seed: int = 1,
    without: Sequence[str] = (),
    only: Sequence[str] | None = None,
    ordered: bool = True,
    skip_first_flexure: bool = False,
    of_joins: Sequence[Trial] | None = None,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> TwoAxisResult:
    """Diagnose trials of two axes: what joins them, then each axis with the joins taken off.

        w = M u,    y = A^-1 theta - c(w):    axis i is a device of command w_i and angle y_i

    M, A and c are those of the simulator with the effects between the axes.

    Args:
        trials: of commands (T, 2) and angles (T, 2), at the sample time of the simulator.
        out: folder for `diagnosis.json`, report and corrected simulator, and the folders `x` and `y` of the axes.
        without, only: effects of the library, and those between the axes.
        of_joins: trials that tell what joins the axes, as much of one axis as of the other; all where left out. What is
            wrong in one axis may be taken for a join otherwise.
        called, model, seed, ordered, skip_first_flexure, progress, say: see `diagnose_trials`.

    Raises:
        GapError: if the simulator has other than two commands, an axis never moves, or as `find_causes`.
        LogError, ModelError: see `find_causes`.
        ConfigError: if `out` holds anything but an older diagnosis of two axes, or cannot be written.
    """
    if (n := len(simulator.command_limits)) != AXES:
        raise GapError(f"--sim: a model of {n} tendons, a diagnosis expects one of two: `in_travels()` of the model")
    library = (*FREE, *diagnosable())
    for name in (*without, *(only or ())):
        if name not in library:
            raise GapError(f"no effect {name!r} in the library or between the axes{nearest(name, library)}")
    if out is not None:
        require_free(out, (TWO_AXIS_FORMAT,))
    first, *each = parts(progress, _TIMES)
    first(0, 1, "what joins both axes")
    data = JoinTrials.of(simulator, trials if of_joins is None else of_joins, ordered)
    offered = [name for name in FREE if name not in without and (only is None or name in only)]
    joins, joined = one_blas_thread(find_joins)(data, seed, offered)
    x, y = (
        diagnose_trials(
            axis_trials(joined, trials, i),
            joined.axes[i],
            model=model,
            seed=seed,
            without=[name for name in without if name not in FREE],
            only=None if only is None else [name for name in only if name not in FREE],
            ordered=ordered,
            skip_first_flexure=skip_first_flexure,
            progress=each[i],
            say=None if say is None else _of_axis(say, name),
        )
        for i, name in enumerate("xy")
    )
    done = TwoAxisResult(TwoAxisDiagnosis(joins, x.diagnosis, y.diagnosis), joined, (x, y))
    if out is not None:
        settings = {
            "logs": [trial.source for trial in trials], **(called or {}), "seed": seed, "without": list(without),
            "only": None if only is None else list(only), "ordered": ordered, "skip_first_flexure": skip_first_flexure,
        }  # fmt: skip
        models = () if model is None else (model,)
        _save(done.diagnosis, done.corrected(_stable), data, Path(out), settings, models)
        for name, result in (("x", x), ("y", y)):
            with figures_to(None if (folder := figures_folder()) is None else folder / name):
                result.save(Path(out) / name, {**settings, "axis": name}, models)
    return done


def axis_trials(model: TwoAxisModel, trials: Sequence[Trial], axis: int) -> list[Trial]:
    """Trials in which an axis moves, as those of a device of one axis: travel w_i, and y_i without what is shared.

    Raises:
        GapError: if the axis moves in none.
    """
    travels = [model.travels(trial.commands) for trial in trials]
    spans = [float(np.ptp(w[:, axis])) for w in travels]
    if not max(spans) > 0:
        raise GapError(f"{trials[0].source}: axis {'xy'[axis]} never moves in these logs, expected motion along it")
    made = []
    for trial, w, span in zip(trials, travels, spans, strict=True):
        if span > _MOVES * max(spans):
            shared = 0.0 if model.cross_friction is None else model.cross_friction.run(w, model.dt_s)
            y = np.ascontiguousarray((model.in_axes(trial.angles) - shared)[:, axis])
            made.append(replace(trial, command=np.ascontiguousarray(w[:, axis]), angle=y))
    return made


def _of_axis(say: Callable[[str], None], name: str) -> Callable[[str], None]:
    return lambda text: say(f"axis {name}: {text}")


def _stable(diagnosis: Diagnosis) -> bool:
    """Whether something of the axis is named, and the verdict does not flip between splits of the trials."""
    return diagnosis.verdict in ("named", "one_of", "retuned") and not diagnosis.relies_on_its_split


def _save(
    diagnosis: TwoAxisDiagnosis,
    corrected: TwoAxisModel,
    data: JoinTrials,
    out: Path,
    settings: Mapping[str, Any],
    models: Sequence[Path],
) -> None:
    """Write the folder's files, without those of the axes."""
    from .page import two_axis_report  # imports matplotlib

    final = [trial for trial in data.trials if trial.source in data.names]
    name = models[0].name if models else "of both axes"
    with renewed(out, (FIXED_FILE,)) as made:
        RunFolder.create(made, settings, seed=settings["seed"], models=models)
        write_atomically(made / DIAGNOSIS_FILE, file_text(plain(diagnosis.as_json()), indent=2))
        if diagnosis.named:
            corrected.save(made / FIXED_FILE)
        two_axis_report(diagnosis, corrected, final, name, len(data.trials)).save(made / "report.html")
