"""The public data sets by name."""

from __future__ import annotations

from .boucwen import BoucWenData
from .records import PublicData
from .rig import RigData
from .seals import SealData
from .settings import PublicSettings


def data_set(settings: PublicSettings) -> PublicData:
    """The data set of these settings."""
    known: dict[str, type[PublicData]] = {"boucwen": BoucWenData, "seals": SealData, "rig": RigData}
    return known[settings.dataset]()
