"""Controllers and simulators for other machines and tools: a controller as C99, a simulator as an FMU."""

from .controller import ControllerExport, export_controller
from .fmu import FmuExport, export_fmu

__all__ = ["ControllerExport", "FmuExport", "export_controller", "export_fmu"]
