"""Kinds of model by name; a kind is imported only when it is requested."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from hystmpc.trials.errors import FitError
from hystmpc.trials.from_outside import hint_for, installed, installed_objects

from ..identify.chain_kinds import CHAIN_KINDS
from .kind import ModelKind

GROUP = "hystmpc.kinds"
"""Entry points by which installed packages add a kind of model; the value is MODULE:NAME of a `ModelKind`."""

_BUILT_IN = ("auto", *CHAIN_KINDS, "lstm", "gru", "play_kernel")
_OF_THE_LABORATORY = ("fnn", "fnn_hib", "hb1", "hb2", "svr")


def _built_in(name: str) -> ModelKind:
    if name == "play_kernel":
        from ..play_kernel.fit import PlayKernelKind

        return PlayKernelKind()
    if name in ("lstm", "gru"):
        from .networks import NETWORK_KINDS

        return next(kind for kind in NETWORK_KINDS if kind.name == name)
    from .operator_kinds import AutoKind, OperatorKind

    return OperatorKind(CHAIN_KINDS[name]) if name in CHAIN_KINDS else AutoKind()


@cache
def _others() -> Mapping[str, ModelKind]:
    return installed_objects(GROUP, "kind of model", ModelKind, _BUILT_IN)  # type: ignore[type-abstract]


def kind_names() -> tuple[str, ...]:
    """Names of all kinds of model, those of installed packages last; none of these is imported."""
    return (*_BUILT_IN, *installed(GROUP))


@cache
def all_kinds() -> tuple[ModelKind, ...]:
    """All kinds of model, those of installed packages last."""
    return (*map(_built_in, _BUILT_IN), *_others().values())


def kind_named(name: str) -> ModelKind:
    """Kind of model of that name.

    Raises:
        FitError: if there is none; says what is available.
    """
    if name in _BUILT_IN:
        return _built_in(name)
    if name not in _others():
        hint = hint_for(name, [*_BUILT_IN, *_others()], _OF_THE_LABORATORY)
        raise FitError(f"no kind of model {name!r}, {hint}")
    return _others()[name]


def chosen_kind(name: str, drive: str | None = None, residual: str | None = None) -> ModelKind:
    """Kind of model of that name, or a combination with it.

    Args:
        drive: `auto`, or a simulator with the drive before the kind, as a file or `builtin:NAME`.
        residual: with `auto`, kind of a network of the residual of its operators.

    Raises:
        FitError: on an unknown kind, or one that cannot be combined so.
        ModelError: if the simulator cannot be used.
    """
    kind = kind_named(name)
    if drive is None and residual is None:
        return kind
    from ..load import model_path
    from ..simulator import load_simulator
    from .connected import DrivenKind, ResidualKind

    if drive is not None and residual is not None:
        raise FitError("got a drive and a network of what operators leave, expected one of them")
    if drive is not None:
        return DrivenKind(kind, None if drive == "auto" else load_simulator(model_path(drive)))
    if name != "auto":
        raise FitError(f"{name}: a network of what operators leave is trained with `auto` only")
    return ResidualKind(str(residual))
