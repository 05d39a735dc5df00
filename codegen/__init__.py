"""Export of a controller as C99 source, and of a simulator as an FMU."""

from .controller import ControllerExport, export_controller
from .fmu import DeviceInPlane, FmuExport, export_fmu, export_fmu_in_plane

__all__ = [
    "ControllerExport",
    "DeviceInPlane",
    "FmuExport",
    "export_controller",
    "export_fmu",
    "export_fmu_in_plane",
]
