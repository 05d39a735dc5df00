"""Packages that are installed only where an extra was asked for."""

from __future__ import annotations

import importlib.util

from .errors import LogError


def require(package: str, extra: str, purpose: str) -> None:
    """Say in one line what to install where an optional package is missing.

    Args:
        package: import name.
        extra: extra of hystmpc that brings it.
        purpose: what it is needed for, such as `reading ROS 2 bags`.

    Raises:
        LogError: if the package is not installed.
    """
    if importlib.util.find_spec(package) is None:
        raise LogError(f"{purpose} needs the package {package}: pip install 'hystmpc[{extra}]'")
