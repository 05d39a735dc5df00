"""The one list of model kinds: the command line, the laboratory and the tests read it."""

from __future__ import annotations

from hystmpc.trials.errors import FitError, did_you_mean
from hystmpc.trials.from_outside import installed_objects

from .auto import AutoKind
from .kind import ModelKind
from .networks import NETWORK_KINDS
from .operator_kinds import OPERATOR_KINDS
from .regressions import PlayKernelKind

GROUP = "hystmpc.kinds"
"""Entry points by which installed packages add a kind of model; the value is MODULE:NAME of a `ModelKind`."""

_OWN: tuple[ModelKind, ...] = (AutoKind(), *OPERATOR_KINDS, *NETWORK_KINDS, PlayKernelKind())
_OTHERS = installed_objects(GROUP, "kind of model", ModelKind, [kind.name for kind in _OWN])  # type: ignore[type-abstract]
KINDS: tuple[ModelKind, ...] = (*_OWN, *_OTHERS.values())
"""Kinds of model, those of installed packages last."""


def kind_named(name: str) -> ModelKind:
    """The kind of that name.

    Raises:
        FitError: if there is none; says what is available.
    """
    kinds = {kind.name: kind for kind in KINDS}
    if name not in kinds:
        raise FitError(f"no kind of model {name!r}, {did_you_mean(name, kinds)}")
    return kinds[name]


def chosen_kind(name: str, drive: str | None = None, residual: str | None = None) -> ModelKind:
    """The kind of that name, or a combination with it.

    Args:
        name: see `kind_named`.
        drive: `auto` or a simulator, a file or `builtin:NAME`: the kind stands behind its drive.
        residual: with `auto`, kind of a network of what its operators leave.

    Raises:
        FitError: on an unknown kind, or one that cannot be combined so.
        ModelError: if the simulator cannot be used.
    """
    kind = kind_named(name)
    if drive is None and residual is None:
        return kind
    from ..load import model_path
    from ..simulator import load_simulator
    from .connected import DrivenKind, ResidualKind  # compiled code, which a list of kinds need not load

    if drive is not None and residual is not None:
        raise FitError("got a drive and a network of what operators leave, expected one of them")
    if drive is not None:
        return DrivenKind(kind, None if drive == AutoKind.name else load_simulator(model_path(drive)))
    if name != AutoKind.name:
        raise FitError(f"{name}: a network of what operators leave is trained with `auto` only")
    return ResidualKind(str(residual))
