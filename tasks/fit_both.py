"""Fit of a device that bends in two planes, from logs with two commands and two angles."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress

from .evaluate import Evaluation, free_runs
from .inputs import Say
from .outputs import SIMULATOR, check_output

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hystmpc.models.kinds.kind import FitRequest, ModelKind
    from hystmpc.models.two_axes.identify import TwoAxisFit
    from hystmpc.models.two_axes.model import TwoAxisModel

_ROUNDS = 6  # fits of an axis, at most: each, from what it does alone, and once more where the joint changes


@dataclass(frozen=True, eq=False)
class FitOfBothAxes:
    """A model of two axes, identified from trials.

    Attributes:
        kind: of every axis.
        identified: model, what joins the axes, errors.
        trials: trials of the identification, of commands (T, 2) and angles (T, 2).
        evaluations: free runs of the written model on each set of trials, see `Fit`.
    """

    kind: str
    identified: TwoAxisFit = field(repr=False)
    trials: tuple[Trial, ...] = field(repr=False)
    evaluations: tuple[tuple[str, Evaluation], ...] = field(default=(), repr=False)

    @property
    def model(self) -> TwoAxisModel:
        """The model."""
        return self.identified.model

    @property
    def report(self) -> str:
        """What joins the axes, and the errors, in one line."""
        return f"{self.kind}: {self.identified.report}"

    def plot(self) -> Figure:
        """Draw the free run of the model on the trials of its identification."""
        return free_runs(self.model, self.trials, False).plot()

    def save(self, path: Path | str, *, force: bool = False) -> Path:
        """Write the model (`.yaml`).

        Raises:
            ConfigError: if the path has another ending, cannot be written, or is taken; see `force` of `fit`.
        """
        check_output("--out", path, (SIMULATOR,), (), force)
        return self.model.save(path)


def fit_both(
    kind: ModelKind,
    trials: Sequence[Trial],
    request: FitRequest,
    out: Path | str | None,
    only_one: Mapping[str, object],
    progress: Progress | None,
    say: Say | None = None,
) -> FitOfBothAxes:
    """Identify a model of two axes.

    Args:
        out: file to write, `.yaml`.
        only_one: options by name that one axis alone has.
        progress: called with steps done, their number and the error so far.
        say: called where Ctrl-C has ended the search of an axis.

    Raises:
        FitError: if such an option is given, or as `fit_two_axes`.
        ConfigError: if the file is no `.yaml`.
    """
    from hystmpc.models.two_axes.identify import fit_two_axes

    if given := [f"--{name}" for name, value in only_one.items() if value]:
        raise FitError(
            f"got {', '.join(given)} and logs of two axes, expected logs of one axis, or none of these options"
        )
    if out is not None:
        check_output("--out", out, (SIMULATOR,), (), force=True)
    total = _ROUNDS * (kind.steps(request) or math.inf)
    if progress is not None:
        progress(0, total, "what joins both axes")

    def tell(steps: int, rmse: float) -> None:
        if progress is not None:
            progress(steps, total, f"best {rmse:.4g} deg")

    done = fit_two_axes(kind, trials, request, [request.limits] * trials[0].commands.shape[1], tell)
    if done.interrupted and say is not None:
        say("interrupted: the best so far of each axis is kept")
    if out is not None:
        done.model.save(out)
    return FitOfBothAxes(kind.name, done, tuple(trials))


def write_page_of_both(made: FitOfBothAxes, path: Path | str, name: str) -> None:
    """Write the page of a fit of two axes: errors, figures, and what joins the axes."""
    from hystmpc.models.evaluation_report import evaluation_report
    from hystmpc.models.two_axes.report import joint_pieces
    from hystmpc.trials.report import Heading, Paragraph, Points

    parts = [
        f"{axis}: {' + '.join(operator.name for operator in simulator.chain.operators)}"
        for axis, simulator in zip("xy", made.model.axes, strict=True)
    ]
    axes = (Heading("The axes"), Paragraph(f"{made.report}."), Points(tuple(parts)))
    sets = [(which, evaluation.trials) for which, evaluation in reversed(made.evaluations)]
    evaluation_report(f"Fit of {name}", f"{made.kind}, two axes", sets, (*joint_pieces(made.model), *axes)).save(path)
