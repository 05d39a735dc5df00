"""The one list of model kinds: the command line, the studies and the tests read it."""

from __future__ import annotations

from hystmpc.trials.errors import FitError, did_you_mean

from .auto import AutoKind
from .kind import ModelKind
from .networks import NETWORK_KINDS
from .operator_kinds import OPERATOR_KINDS
from .regressions import PlayKernelKind, SvrKind

KINDS: tuple[ModelKind, ...] = (AutoKind(), *OPERATOR_KINDS, *NETWORK_KINDS, SvrKind(), PlayKernelKind())


def kind_named(name: str) -> ModelKind:
    """The kind of that name.

    Raises:
        FitError: if there is none; says what is available.
    """
    kinds = {kind.name: kind for kind in KINDS}
    if name not in kinds:
        raise FitError(f"no kind of model {name!r}, {did_you_mean(name, kinds)}")
    return kinds[name]
