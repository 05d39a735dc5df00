"""The one list of model kinds: the command line, the studies and the tests read it."""

from __future__ import annotations

from hystmpc.trials.errors import FitError, did_you_mean

from .fnn import FnnKind
from .fnn_hib import FnnHibKind
from .gru import GruKind
from .hb1 import Hb1Kind
from .hb2 import Hb2Kind
from .kind import ModelKind
from .lstm import LstmKind
from .operator_kinds import BacklashKind, BoucWenKind, DrdpiKind, PrandtlIshlinskiiKind
from .play_kernel import PlayKernelKind
from .svr import SvrKind

KINDS: tuple[ModelKind, ...] = (
    BacklashKind(),
    PrandtlIshlinskiiKind(),
    DrdpiKind(),
    BoucWenKind(),
    FnnKind(),
    FnnHibKind(),
    LstmKind(),
    GruKind(),
    Hb1Kind(),
    Hb2Kind(),
    SvrKind(),
    PlayKernelKind(),
)


def kind_named(name: str) -> ModelKind:
    """The kind of that name.

    Raises:
        FitError: if there is none; says what is available.
    """
    kinds = {kind.name: kind for kind in KINDS}
    if name not in kinds:
        raise FitError(f"no kind of model {name!r}, {did_you_mean(name, kinds)}")
    return kinds[name]
