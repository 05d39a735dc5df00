"""Settings of a study: models, duration of training, data."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator

from hystmpc.models.kinds.catalogue import all_kinds, kind_names
from hystmpc.trials.errors import ConfigError, did_you_mean

from ..study import StudySettings

NotNegative = Annotated[float, Field(ge=0)]
StudyName = Literal["s1", "s2", "real"]
DirectionName = Literal["forward", "inverse"]

# In the order of the papers' tables.
S2_KINDS = ("fnn", "backlash", "pi", "lstm", "gru", "fnn_hib", "hb1", "hb2")
S1_KINDS = ("drdpi", "svr", "lstm")
# Trained by gradient on windows in the papers: what `epochs_scale` and the constant-in, constant-out term are for.
PAPER_PRESETS = ("paper", "s1")
NETWORKS = frozenset({"fnn", "fnn_hib", "lstm", "gru", "hb1", "hb2"})

STAGES: dict[str, tuple[str, ...]] = {
    "s1": ("main", "reconstruction"),
    "s2": ("main", "cross", "window"),
    "real": ("main",),
}
QUICK_SCALE = 0.01

_DEFAULTS: dict[str, dict[str, Any]] = {
    "s1": {"kinds": S1_KINDS, "presets": ("paper",), "directions": ("forward",), "stages": STAGES["s1"]},
    "s2": {"kinds": S2_KINDS, "presets": ("paper",), "stages": ("main", "cross"), "epochs_scale": 0.08},
    "real": {"presets": ("paper", "best"), "directions": ("forward",), "stages": STAGES["real"], "betas": (None,)},
}


class PaperSettings(StudySettings):
    """Settings of a study; `for_study` adds each study's own defaults.

    Attributes:
        study: `s1` and `s2` on the simulated devices of the two papers, `real` on recorded logs.
        kinds: kinds of model by their names in the catalogue; those that it does not hold are left out and named.
        presets: of the training; a kind that lacks one is trained with its own first.
        directions: command to angle, angle to command.
        stages: parts of the study, see `STAGES`.
        betas: weights of the constant-in, constant-out term (S2 eq. (12)) that networks are trained with, the better
            reported; None for the preset's own.
        epochs_scale: share of the papers' epochs that networks are trained for with the preset `paper`. 0.08 for S2,
            where all 100 would take hours on two cores; the report says so.
        logs: recorded trials or folders of them, for `real`.
        rate_hz: rate to which logs are resampled [Hz].
        parts: equal parts that each log is cut into.
    """

    study: StudyName
    kinds: tuple[str, ...]
    presets: Annotated[tuple[str, ...], Field(min_length=1)]
    directions: Annotated[tuple[DirectionName, ...], Field(min_length=1)] = ("forward", "inverse")
    stages: Annotated[tuple[str, ...], Field(min_length=1)]
    betas: Annotated[tuple[NotNegative | None, ...], Field(min_length=1)] = (0.0, 1e-4)
    epochs_scale: Annotated[float, Field(gt=0, le=10)] = 1.0
    logs: tuple[str, ...] = ()
    layout: str = "auto"
    rate_hz: Annotated[float, Field(gt=0)] = 25.0
    parts: Annotated[int, Field(ge=1)] = 1

    @field_validator("kinds", "presets", "directions", "stages", "betas")
    @classmethod
    def _each_once(cls, names: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(dict.fromkeys(names))

    @classmethod
    def for_study(cls, study: str, **changes: Any) -> Self:
        """Settings of a study with its defaults and some changes; None or an empty change keeps the default.

        Raises:
            ConfigError: on an unknown study, kind, preset or stage, logs for a simulated study or none for `real`.
        """
        if study not in _DEFAULTS:
            raise ConfigError(f"no study {study!r}, {did_you_mean(study, _DEFAULTS)}")
        known = kind_names()
        data = {"study": study, "kinds": known} | _DEFAULTS[study]
        data |= {name: value for name, value in changes.items() if value not in (None, (), [])}
        settings = cls.parse(data, f"study {study}")
        settings._check(known, asked=bool(changes.get("kinds")))
        return settings

    def _check(self, known: tuple[str, ...], asked: bool) -> None:
        wrong = [name for name in self.kinds if name not in known] if asked else []
        if wrong:
            raise ConfigError(f"no kind of model {wrong[0]!r}, {did_you_mean(wrong[0], known)}")
        presets = {preset for kind in all_kinds() for preset in kind.trainings}
        for name, available in ((self.presets, presets), (self.stages, STAGES[self.study])):
            for text in name:
                if text not in available:
                    raise ConfigError(f"study {self.study}: got {text!r}, {did_you_mean(text, available)}")
        if (self.study == "real") != bool(self.logs):
            raise ConfigError(
                f"study {self.study}: got {len(self.logs)} logs, "
                + ("expected at least two with --logs" if self.study == "real" else "expected none: it is simulated")
            )

    @property
    def left_out(self) -> tuple[str, ...]:
        """Kinds of the study that the catalogue does not hold."""
        known = {*kind_names()}
        return tuple(name for name in self.kinds if name not in known)
