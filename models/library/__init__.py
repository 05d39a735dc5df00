"""Small identified models that ship with the package, and how to find them; none of them has seen real data."""

from .files import library_file, library_names, model_path

__all__ = ["library_file", "library_names", "model_path"]
