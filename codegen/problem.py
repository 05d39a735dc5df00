"""Problem that an exported controller states, by its settings: of one axis, or of two."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hystmpc.core.library import engine
from hystmpc.core.structs import Struct
from hystmpc.ctrl.command import limits_of_model, modelled_limits
from hystmpc.ctrl.law import LawSettings
from hystmpc.ctrl.mpc_settings import LinearisedMpcSettings
from hystmpc.ctrl.planner.settings import TipSettings, of_two_axes, read_settings
from hystmpc.ctrl.problem import problem_of, written_in
from hystmpc.ctrl.two_axes.guarded import TwoAxisController
from hystmpc.ctrl.two_axes.tip_controller import read_two_axis_settings, within_limits
from hystmpc.models.load import load_model, model_path
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.two_axes.model import load_two_axes
from hystmpc.trials.errors import ExportError


@dataclass(frozen=True, eq=False)
class ExportedProblem:
    """What the source of an exported controller states.

    Attributes:
        struct: `hystmpc_problem` of core/controller.h; of two axes `hystmpc_axes` of core/axes.h.
        axes: `hystmpc_problem` of every axis.
        rests: how the predictor of each axis comes to rest, structs `hystmpc_rest_rule`; None without a model.
        inputs: entries of the predictor's state that hold each measured input, by name.
        words: model, controller and limits, in one line.
    """

    struct: Struct
    axes: tuple[Struct, ...]
    rests: tuple[Struct | None, ...]
    inputs: Mapping[str, tuple[int, ...]]
    words: str

    @property
    def commands(self) -> int:
        """Number of commands, n."""
        return int(self.struct.fields.get("commands", 1))

    @property
    def dt_s(self) -> float:
        """Time between two steps [s]."""
        return float(self.axes[0].fields["dt_s"])

    @property
    def samples(self) -> int:
        """Number of reference samples that a step uses."""
        return int(engine().reference_samples(self.axes[0].address))

    def states(self) -> list[int]:
        """Number of states of the predictor of each axis that has a model."""
        models = [model for axis in self.axes if (model := axis.fields.get("model")) is not None]
        return [int(model.fields["predictor"].fields["states"]) for model in models]


def exported_problem(source: Path | str | Mapping[str, Any] | TipSettings, folder: Path | None) -> ExportedProblem:
    """Return the problem of a controller's settings; of two axes where their model is.

    Args:
        source: a `tip.yaml`, a mapping or settings.
        folder: base of relative file names in a mapping.

    Raises:
        ExportError: where a part of the controller has no C; says what was got and what is supported.
        ConfigError, ModelError, ControllerError: as `TipController.from_config`.
    """
    if of_two_axes(_located(source, folder)):
        return _of_two_axes(source, folder)  # type: ignore[arg-type]  # a file or a mapping
    settings, home = read_settings(source)
    return _of_one_axis(settings, home if folder is None else folder)


def _located(source: object, folder: Path | None) -> object:
    """The settings, with the place of their model where a folder is given."""
    if folder is None or not isinstance(source, Mapping) or not isinstance(source.get("model"), str):
        return source
    return {"model": str(model_path(source["model"], folder))}


def _check(controller: LawSettings) -> None:
    if hasattr(controller, "law"):
        raise ExportError(
            f"export-c: got the law {type(controller).__name__} written in Python, expected one of hystmpc"
        )
    if isinstance(controller, LinearisedMpcSettings) and controller.solver != "active_set":
        raise ExportError(f"export-c: got controller.solver {controller.solver}, supported is active_set: an exact one")


def _of_one_axis(settings: TipSettings, folder: Path) -> ExportedProblem:
    controller = settings.controller.resolved()
    _check(controller)
    model = load_model(model_path(settings.model, folder), start="conditioned")
    inverse = None if settings.inverse is None else model_path(settings.inverse, folder)
    known, facts = controller_model(model, inverse, settings.actuator_lag_s), model.metadata
    predictor, inverted = known.predictive if controller.predicts else known.feedforward
    limits = modelled_limits(settings.limits, limits_of_model(facts))
    problem = problem_of(controller, predictor, inverted, limits)
    if written := written_in(problem):
        raise ExportError(
            f"export-c: got a model of kind {facts.kind} with {written} that is computed by Python, "
            "supported are operators, lstm and gru, and what connects them"
        )
    least, most, dt = problem.fields["lower"], problem.fields["upper"], problem.fields["dt_s"]
    rate = problem.fields["reach"] / dt
    words = f"{settings.model}: {settings.controller.kind} on {facts.kind}, every {dt:g} s"
    words += f", {least:g} to {most:g} at {rate:g} per s [{facts.command_unit}]"
    modelled = problem.fields.get("model") is not None
    return ExportedProblem(
        problem,
        (problem,),
        (predictor.rest_part if modelled else None,),
        predictor.input_states if modelled else {},
        words,
    )


def _of_two_axes(source: Path | str | Mapping[str, Any], folder: Path | None) -> ExportedProblem:
    settings, home = read_two_axis_settings(source)
    _check(settings.controller.resolved())
    model = load_two_axes(model_path(settings.model, home if folder is None else folder))
    if model.inputs:
        raise ExportError(f"export-c: got two axes that depend on {model.inputs[0].name}, expected no measured input")
    controller = TwoAxisController(within_limits(model, settings.limits), settings.controller)
    problem = controller.problem
    axes = problem.fields["first"], problem.fields["second"]
    if written := written_in(problem):
        raise ExportError(f"export-c: got a model of two axes with {written} in Python, supported are operators")
    words = f"{settings.model}: {settings.controller.kind} of two axes, every {controller.dt:g} s, "
    words += ", ".join(f"{one.lower:g} to {one.upper:g} at {one.rate:g}" for one in controller.limits)
    modelled = [axis.fields.get("model") is not None for axis in axes]
    rests = tuple(rest if has else None for rest, has in zip(controller.rests, modelled, strict=True))
    return ExportedProblem(problem, axes, rests, {}, f"{words} per s [{model.axes[0].command_unit}]")
