"""A chain of operators as plain data, as simulator files and model files hold it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from hystmpc.trials.errors import ModelError

from .chain import Chain
from .operators.catalogue import operator_from, operator_spec


def chain_spec(chain: Chain) -> dict[Literal["before", "core", "after"], Any]:
    """Plain data from which `chain_from` builds the same chain."""
    return {
        "before": [operator_spec(operator) for operator in chain.before],
        "core": operator_spec(chain.core),
        "after": [operator_spec(operator) for operator in chain.after],
    }


def chain_from(spec: Mapping[Literal["before", "core", "after"], Any], where: str) -> Chain:
    """A chain from plain data.

    Raises:
        ModelError: if it has no core, or names what the catalogue of operators does not know.
    """
    if "core" not in spec:
        raise ModelError(f"{where} has no 'core', got {', '.join(spec) or 'nothing'}")
    return Chain(
        operator_from(spec["core"], f"{where}.core"),
        _side(spec.get("before"), f"{where}.before"),
        _side(spec.get("after"), f"{where}.after"),
    )


def _side(specs: Any, where: str) -> tuple[Any, ...]:
    if specs is not None and not isinstance(specs, list):
        raise ModelError(f"{where}: got {type(specs).__name__}, expected a list of operators")
    return tuple(operator_from(spec, f"{where}[{k}]") for k, spec in enumerate(specs or []))
