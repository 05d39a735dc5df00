"""All generators, by the effect they stand for."""

from __future__ import annotations

from hystmpc.trials.errors import ConfigError, did_you_mean

from .drive_effects import DRIVE_EFFECTS
from .foreign_effects import FOREIGN_EFFECTS
from .generator import Generator
from .sensor_effects import SENSOR_EFFECTS
from .slow_effects import SLOW_EFFECTS
from .tip_effects import TIP_EFFECTS

GENERATORS: tuple[Generator, ...] = (
    *DRIVE_EFFECTS,
    *TIP_EFFECTS,
    *SLOW_EFFECTS,
    *SENSOR_EFFECTS,
    *FOREIGN_EFFECTS,
)
UNKNOWN = "unknown"
LABELS: tuple[str, ...] = tuple(dict.fromkeys(g.label for g in GENERATORS if g.label != UNKNOWN))


def generator_named(name: str) -> Generator:
    """The generator of that name.

    Raises:
        ConfigError: if there is none.
    """
    for generator in GENERATORS:
        if generator.name == name:
            return generator
    raise ConfigError(f"no generator {name!r}, {did_you_mean(name, [g.name for g in GENERATORS])}")


def generators_of(label: str) -> tuple[Generator, ...]:
    """Generators of one effect.

    Raises:
        ConfigError: on an unknown effect.
    """
    found = tuple(g for g in GENERATORS if g.label == label)
    if not found:
        raise ConfigError(f"no effect {label!r}, {did_you_mean(label, (*LABELS, UNKNOWN))}")
    return found
