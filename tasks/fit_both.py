"""Fit of a device that bends in two planes, from logs with two commands and two angles."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hystmpc.trials.axes import both_axes
from hystmpc.trials.errors import FitError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress, Vec

from .inputs import Say
from .outputs import SIMULATOR, check_output

if TYPE_CHECKING:
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
        unseen_deg: errors of free runs over trials that the fit has not seen (2,) [deg]; None without any.
    """

    kind: str
    identified: TwoAxisFit = field(repr=False)
    trials: tuple[Trial, ...] = field(repr=False)
    unseen_deg: Vec | None = None

    @property
    def model(self) -> TwoAxisModel:
        """The model."""
        return self.identified.model

    @property
    def report(self) -> str:
        """What joins the axes, and the errors, in one line."""
        unseen = "" if self.unseen_deg is None else f"; unseen {self.unseen_deg[0]:.3g}, {self.unseen_deg[1]:.3g} deg"
        return f"{self.kind}: {self.identified.report}{unseen}"

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
    held: Sequence[Trial],
    request: FitRequest,
    out: Path | str | None,
    only_one: Mapping[str, object],
    progress: Progress | None,
    say: Say | None = None,
) -> FitOfBothAxes:
    """Identify a model of two axes.

    Args:
        held: trials that the fit does not see.
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

    done, unseen = fit_two_axes(kind, trials, request, [request.limits] * 2, tell), None
    if done.interrupted and say is not None:
        say("interrupted: the best so far of each axis is kept")
    if others := both_axes(held):
        errors = [done.model.run(trial.commands, trial.angles[0]) - trial.angles for trial in others]
        unseen = np.sqrt(np.mean(np.vstack(errors) ** 2, axis=0))
    made = FitOfBothAxes(kind.name, done, tuple(trials), unseen)
    if out is not None:
        done.model.save(out)
    return made
