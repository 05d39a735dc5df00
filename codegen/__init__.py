"""Controllers for other machines: a predictive controller as C99."""

from .controller import ControllerExport, export_controller

__all__ = ["ControllerExport", "export_controller"]
