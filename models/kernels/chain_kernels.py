"""Compiled kernels of a symbolic step: generated code for the step and its derivatives, shared loops around it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

import casadi as ca
import numpy as np

from hystmpc.trials.types import Vec

from .numba_ import generated_module
from .program import dense, scalar_program

_DECORATOR = '@njit(cache=True, error_model="numpy", inline="never")\n'


@dataclass(frozen=True)
class ChainKernels:
    """Compiled functions of one step (x, u, p, dt) -> (theta, following); see `chain_loops` for their arguments.

    Attributes:
        constants: numbers of the expressions, for the last arguments.
    """

    simulate: Callable[..., None]
    rollout: Callable[..., None]
    linearise: Callable[..., None]
    command_for: Callable[..., float]
    state_size: int
    step_constants: Vec
    tangent_constants: Vec


def compile_step(function: Any) -> ChainKernels:
    """Compile a dense CasADi function (state, u, p, dt) -> (theta, next state).

    Kernels are cached by the expression's structure: models that differ in numbers only share them.
    """
    return _compile(function.serialize())


@lru_cache(maxsize=64)
def _compile(serialized: str) -> ChainKernels:
    function = ca.Function.deserialize(serialized)
    size, count = function.numel_in(0), function.numel_in(2)
    x, u = ca.SX.sym("x", size), ca.SX.sym("u")
    p, dt = ca.SX.sym("p", count), ca.SX.sym("dt")
    theta, following = function(x, u, p, dt)
    by = ca.jacobian
    arguments = [x, u, p, dt]
    step = scalar_program(dense("step", arguments, [theta, following]), "step")
    tangent = scalar_program(
        dense("tangent", arguments, [theta, following, by(following, x), by(following, u), by(theta, x), by(theta, u)]),
        "tangent",
    )
    generated = "".join(_DECORATOR + program.source + "\n\n" for program in (step, tangent))
    loops = resources.files("hystmpc.models.kernels").joinpath("chain_loops.py").read_text(encoding="utf-8")
    module = generated_module("import math\n\n\n" + generated + loops)
    return ChainKernels(
        module.simulate,
        module.rollout,
        module.linearise,
        module.command_for,
        size,
        np.array(step.constants),
        np.array(tangent.constants),
    )
