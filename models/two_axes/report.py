"""What joins the axes of a model, as pieces of a report: matrices, shared friction, the comparison of the fit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hystmpc.trials.report import Heading, Paragraph, Piece, Table
from hystmpc.trials.types import Vec

from .model import AXES, TwoAxisModel

_AXES = ("x", "y")


def joint_pieces(model: TwoAxisModel) -> Iterator[Piece]:
    """Pieces on M, A and the shared friction, with a sentence each, and on the joints that the fit compared."""
    yield Heading("What joins both axes")
    if model.comparison:
        yield Table(("joint", "error [deg]"), list(model.comparison.items()), "Errors on parts left out of the fit.")
    commands = command_names(model)
    rows = [(f"axis {name}", *row) for name, row in zip(_AXES, model.mix, strict=True)]
    yield Table(("M", *(f"command {name}" for name in commands)), rows, "Travel of each axis by one unit of a command.")
    yield Paragraph(_mix_sentence(model, commands))
    turned = [(f"angle {name}", *row) for name, row in zip(_AXES, model.frame, strict=True)]
    yield Table(("A", "axis x", "axis y"), turned, "Measured angle by one degree of an axis.")
    yield Paragraph(_frame_sentence(model))
    yield Paragraph(_friction_sentence(model))


def command_names(model: TwoAxisModel) -> tuple[str, ...]:
    """Names of the commands: x and y, or numbers of three to six tendons."""
    n = len(model.command_limits)
    return _AXES if n == AXES else tuple(str(k + 1) for k in range(n))


def _mix_sentence(model: TwoAxisModel, commands: tuple[str, ...]) -> str:
    m = model.matrix
    if np.count_nonzero(m, axis=0).max() <= 1:
        return "Each command pulls by one axis alone: the tendons are aligned with the axes."
    said = [f"command {name} pulls at {_degrees(column)} deg" for name, column in zip(commands, m.T, strict=True)]
    return f"In the plane of both axes, {', '.join(said)} from axis x: a command moves both axes."


def _frame_sentence(model: TwoAxisModel) -> str:
    a = model.turn
    if np.count_nonzero(a, axis=0).max() <= 1:
        return "Each angle shows one axis alone: the sensor's frame is aligned with the axes."
    said = [f"axis {name} at {_degrees(column)} deg" for name, column in zip(_AXES, a.T, strict=True)]
    return f"The sensor shows a bend of {' and of '.join(said)} from its own x: each angle shows both axes."


def _friction_sentence(model: TwoAxisModel) -> str:
    shared = model.cross_friction
    if shared is None:
        return "No friction that both axes share was needed."
    x, y = (2 * np.abs(shared.weights) @ np.array(shared.radii)).tolist()
    coupled = (
        "" if shared.coupling is None else " Static coupling comes on top: a bend along one axis changes the other."
    )
    return (
        "Both axes share a friction: a motion along one of them frees the other one. "
        f"This friction changes x by at most {x:.3g} deg and y by at most {y:.3g} deg.{coupled}"
    )


def _degrees(column: Vec) -> str:
    return f"{np.degrees(np.arctan2(column[1], column[0])):.3g}"
