"""Export of a controller as C99 source, and of a simulator as an FMU."""

from .controller import ControllerExport, export_controller
from .fmu import FmuExport, export_fmu

__all__ = ["ControllerExport", "FmuExport", "export_controller", "export_fmu"]
