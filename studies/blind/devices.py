"""Kinds of device that a blind case may have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hystmpc.trials.errors import ConfigError, did_you_mean

from .core import Core
from .cores import CapstanCore, DahlCore
from .rod_core import RodCore

DEVICES: tuple[type[CapstanCore] | type[DahlCore] | type[RodCore], ...] = (CapstanCore, DahlCore, RodCore)
"""None of them is made of play operators."""


def core_of(numbers: Mapping[str, Any]) -> Core:
    """The core of these numbers; see `Core.numbers`.

    Raises:
        ConfigError: on an unknown kind of device.
    """
    kinds = {kind.__name__: kind for kind in DEVICES}
    own = dict(numbers)
    name = str(own.pop("core", ""))
    if name not in kinds:
        raise ConfigError(f"no device core {name!r}, {did_you_mean(name, kinds)}")
    return kinds[name](**own)
