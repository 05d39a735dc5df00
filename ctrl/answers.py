"""Words for the answers of the engine's controller: levels of fallback, and why a better one was not used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hystmpc.core.structs import constants

from .command import Source
from .feedback import LEVELS

_CODES = constants()
SOURCES: tuple[Source, ...] = (
    Source.MPC,
    Source.CONTROLLER,
    Source.SHIFTED_PLAN,
    Source.INVERSE,
    Source.HOLD,
    Source.STOP,
)
"""Levels of fallback in the order of the engine's HYSTMPC_MPC ... HYSTMPC_STOP."""

OK, FAILED, NO_SOLUTION = (_CODES[f"HYSTMPC_{name}"] for name in ("OK", "FAILED", "NO_SOLUTION"))
_REASONS: Mapping[int, str] = {
    _CODES[f"HYSTMPC_{name}"]: text
    for name, text in {
        "LATCHED": "latched {cause}",
        "BAD_REFERENCE": "{reference}",
        "NO_SENSOR_NOW": "no usable measurement for {missing} samples",
        "STALE_MODEL": "the model state is {stalled} samples old",
        "NO_PLAN": "PlanningError: {planner}",
        "NO_SOLUTION": "PlanningError: {planner}",
        "NO_COMMAND": "the law answers no finite command",
        "NO_TIME": "NoTimeError: {refusal}",
        "FAILED": "{outside}",
    }.items()
}
_PLANNER: Mapping[int, str] = {
    _CODES["HYSTMPC_QP_INFEASIBLE"]: "active set: primal infeasible",
    _CODES["HYSTMPC_QP_NOT_CONVEX"]: "active set: not convex",
    _CODES["HYSTMPC_QP_NOT_FINITE"]: "active set: solution not finite",
    _CODES["HYSTMPC_QP_UNFINISHED"]: "active set: maximum changes reached",
    _CODES["HYSTMPC_NO_JACOBIAN"]: "the model's Jacobian is not finite",
    _CODES["HYSTMPC_NO_PROGRAM"]: "the quadratic program is not finite",
    _CODES["HYSTMPC_NO_SAMPLE"]: "no random plan has a finite prediction",
    _CODES["HYSTMPC_NO_PREDICTION"]: "no candidate plan has a finite prediction",
}


def planner_words(fault: int) -> str:
    """Return why a planner has no plan, by its answer."""
    return _PLANNER.get(fault, f"exit flag {fault}")


def status_words(
    answer: Any, level: int, forecast_error: float, stalled: int, faults: Sequence[str], more: Mapping[str, Any]
) -> str:
    """Return the status line of an answer.

    Args:
        answer: struct `hystmpc_command` of core/controller.h.
        level: of the supervisor, after the step.
        forecast_error: relative error of the forecasts.
        stalled: samples for which the model has not advanced, after the step.
        faults: what functions written in Python have raised in this step, in their order: see `core.outside`.
        more: words that are known outside the engine: cause, reference, stalled (before the step), refusal, unfinished;
            planner, where Python solves its programs.
    """
    source, notes, raised = SOURCES[answer.source], [], iter(faults)
    if answer.status != OK:
        outside = next(raised, "it has failed") if answer.status == FAILED else ""
        words = {"missing": answer.missing, "planner": planner_words(answer.fault), "outside": outside, **more}
        reason = _REASONS[answer.status].format(**words)
        notes.append(f"stopped: {reason}" if source is Source.STOP else reason)
        if answer.inverse:
            no_number = "the inverse answers no finite command"
            notes.append(no_number if answer.inverse == 1 else next(raised, no_number))
    else:
        if level:
            notes.append(f"{LEVELS[level]}: forecasts are off by {100 * forecast_error:.0f} % of the motion")
        if answer.fault > 0:
            notes.append(str(more["unfinished"]))
    if answer.missing:
        notes.append(f"measurement missing or outlying for {answer.missing} samples, predicted")
    if stalled:
        notes.append(f"model state not advanced: {next(raised, 'its answer is not finite')}")
    return "; ".join(notes) or "ok"
