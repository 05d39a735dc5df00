"""Export of a simulator (a chain of operators) as a co-simulation FMU."""

from .export import FmuExport, FmuVersion, export_fmu

__all__ = ["FmuExport", "FmuVersion", "export_fmu"]
