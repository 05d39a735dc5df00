"""Recorded trials: the Trial type, readers and writers, resampling, segments, quality checks, run folders, reports."""

from .errors import HystmpcError
from .trial import Trial, Units

__all__ = ["HystmpcError", "Trial", "Units"]
