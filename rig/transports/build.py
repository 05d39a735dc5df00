"""From settings to a transport."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable

from hystmpc.ctrl.protocols import Plant
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.run_folder import RunFolder

from .reading import Transport
from .settings import DdsSettings, ReplaySettings, SimulatedSettings, TransportSettings, UdpSettings
from .simulated import SimulatedTransport, recorded_plant
from .udp import UdpTransport
from .units import Conversion

# Makes the device of `kind: simulated`: settings and sample time to a plant and the command that it holds.
PlantFactory = Callable[[SimulatedSettings, float], tuple[Plant, float]]


def build_transport(
    settings: TransportSettings, conversion: Conversion, dt_s: float, now_ns: Callable[[], int], plants: PlantFactory
) -> Transport:
    """The transport that `settings` describe, open.

    Args:
        settings: of any kind.
        conversion: of the wire's units.
        dt_s: sample time of the loop [s].
        now_ns: monotonic clock.
        plants: makes the simulated device; given by the program, since this room knows no simulator.

    Raises:
        ConfigError: if the wire cannot be opened, or a package is missing for it.
        LogError: if a run to replay cannot be read.
    """
    if isinstance(settings, SimulatedSettings):
        plant, held = plants(settings, dt_s)
        return SimulatedTransport(plant, dt_s, held, now_ns)
    if isinstance(settings, ReplaySettings):
        recorded, held = recorded_plant(RunFolder.open(settings.run), dt_s)
        return SimulatedTransport(recorded, dt_s, held, now_ns)
    if isinstance(settings, UdpSettings):
        return UdpTransport(settings, conversion)
    return _dds(settings, conversion)


def _dds(settings: DdsSettings, conversion: Conversion) -> Transport:
    require_dds()
    from .dds_ import DdsTransport

    return DdsTransport(settings, conversion)


def require_dds() -> None:
    """Say how to get DDS where it is not installed.

    Raises:
        ConfigError: if `cyclonedds` is not installed.
    """
    if importlib.util.find_spec("cyclonedds") is None:
        raise ConfigError("dds: the package cyclonedds is not installed, expected `pip install hystmpc[rig]`")
