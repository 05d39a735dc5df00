"""Settings of the studies on public data."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field

from hystmpc.models.kinds.catalogue import kind_named
from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError, did_you_mean

DATA_SETS = {
    "boucwen": ("oscillator", "state_network"),
    "seals": ("maxwell_slip", "maxwell_slip_rate", "auto", "bouc_wen", "pi", "play_kernel"),
    "rig": ("auto", "backlash", "pi", "maxwell_slip"),
}
"""Data sets, and the kinds of model that are tried on each where none is named."""

_STEPS = {"state_network": 60}
_QUICK_STEPS = 4


class PublicSettings(Settings):
    """Settings of the study `public`.

    Attributes:
        study: always `public`.
        dataset: name of the data set, see `DATA_SETS`.
        data: file that is identified from, or a folder of them.
        test: further files of the test.
        kinds: of model, by name; those of `DATA_SETS` where left out.
        seed: of everything drawn at random.
        quick: few steps, short tests: proves that everything runs, and nothing else.
    """

    study: Literal["public"] = "public"
    dataset: str
    data: str
    test: tuple[str, ...] = ()
    kinds: tuple[str, ...]
    seed: Annotated[int, Field(ge=0)] = 1
    quick: bool = False

    @classmethod
    def of(cls, **changes: Any) -> Self:
        """The study with some changes; a change that is None or empty keeps the default.

        Raises:
            ConfigError: on an unknown data set, or without a file.
            FitError: on an unknown kind of model.
        """
        if not changes.get("dataset") or not changes.get("data"):
            raise ConfigError(f"study public: expected a data set ({', '.join(DATA_SETS)}) and its file, --data FILE")
        given = {name: value for name, value in changes.items() if value not in (None, (), [])}
        given |= {"data": str(changes["data"]), "test": tuple(str(file) for file in changes.get("test") or ())}
        name = str(changes["dataset"])
        if name not in DATA_SETS:
            raise ConfigError(f"study public: no data set {name!r}, {did_you_mean(name, DATA_SETS)}")
        settings = cls.parse({"kinds": DATA_SETS[name]} | given, "study public")
        for kind in settings.kinds:
            kind_named(kind)
        return settings

    def steps(self, kind: str) -> int | None:
        """Greatest number of steps of a kind's fit; None for its own default."""
        return _QUICK_STEPS if self.quick else _STEPS.get(kind)
