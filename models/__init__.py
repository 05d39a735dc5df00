"""Models of actuators with hysteresis: operators, networks, their identification, inverses and the ONNX contract."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hystmpc.trials import lazily

if TYPE_CHECKING:
    from .chain import Chain
    from .effects.catalogue import EFFECTS, add_effect
    from .effects.effect import Candidate, Effect, Freedom, Scale
    from .effects.place import effect_operator, neutral_operator, with_effect
    from .kinds.catalogue import kind_named
    from .kinds.kind import FitRequest, Identified, ModelKind
    from .linear.nonlinearities import OperatorNonlinearity, SettledNonlinearity
    from .linear.systems import from_control
    from .maps import QuadraticMap, TipMap
    from .model import Model
    from .operators.operator import Memoryless, Number, Operator, maximum, minimum
    from .two_axes.model import CrossFriction, TwoAxisModel, load_two_axes

__all__ = [
    "EFFECTS",
    "Candidate",
    "Chain",
    "CrossFriction",
    "Effect",
    "FitRequest",
    "Freedom",
    "Identified",
    "Memoryless",
    "Model",
    "ModelKind",
    "Number",
    "Operator",
    "OperatorNonlinearity",
    "QuadraticMap",
    "Scale",
    "SettledNonlinearity",
    "TipMap",
    "TwoAxisModel",
    "add_effect",
    "effect_operator",
    "from_control",
    "kind_named",
    "load_two_axes",
    "maximum",
    "minimum",
    "neutral_operator",
    "with_effect",
]

if not TYPE_CHECKING:
    __getattr__ = lazily(
        __name__,
        ("hystmpc.models.chain", "Chain"),
        ("hystmpc.models.effects.catalogue", "EFFECTS"),
        ("hystmpc.models.effects.effect", "Candidate Effect Freedom Scale"),
        ("hystmpc.models.effects.catalogue", "add_effect"),
        ("hystmpc.models.effects.place", "effect_operator neutral_operator with_effect"),
        ("hystmpc.models.kinds.catalogue", "kind_named"),
        ("hystmpc.models.maps", "QuadraticMap TipMap"),
        ("hystmpc.models.kinds.kind", "FitRequest Identified ModelKind"),
        ("hystmpc.models.linear.nonlinearities", "OperatorNonlinearity SettledNonlinearity"),
        ("hystmpc.models.linear.systems", "from_control"),
        ("hystmpc.models.model", "Model"),
        ("hystmpc.models.operators.operator", "Memoryless Number Operator maximum minimum"),
        ("hystmpc.models.two_axes.model", "CrossFriction TwoAxisModel load_two_axes"),
    )
