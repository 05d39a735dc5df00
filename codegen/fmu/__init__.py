"""Export of a simulator (a chain of operators, or two axes of them) as a co-simulation FMU."""

from .device import DeviceInPlane
from .export import FmuExport, FmuVersion, export_fmu, export_fmu_in_plane

__all__ = ["DeviceInPlane", "FmuExport", "FmuVersion", "export_fmu", "export_fmu_in_plane"]
