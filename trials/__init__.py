"""Recorded trials: the Trial type, readers and writers, resampling, segments, quality checks, run folders, reports."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .check import CheckReport, Finding, Severity
    from .csv_files import write_csv
    from .errors import HystmpcError
    from .from_outside import allow_python
    from .read import read_trials
    from .tip import angles_from_bend, angles_from_tip, angles_from_tip_aside, tip_from_angles
    from .trial import Trial, Units, resample

__all__ = [
    "CheckReport",
    "Finding",
    "HystmpcError",
    "Severity",
    "Trial",
    "Units",
    "allow_python",
    "angles_from_bend",
    "angles_from_tip",
    "angles_from_tip_aside",
    "read_trials",
    "resample",
    "tip_from_angles",
    "write_csv",
]


def lazily(package: str, *names: tuple[str, str]) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package (PEP 562) that imports each module at the first use of one of its names.

    Args:
        package: `__name__` of the package; its `__all__` is `names` of the returned function.
        names: module and names in it, separated by blanks; `NAME=OTHER` makes the module's OTHER the package's NAME.
    """
    home = {entry.partition("=")[0]: (module, entry) for module, text in names for entry in text.split()}

    def getattribute(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module, entry = home[name]
        value = getattr(import_module(module), entry.rpartition("=")[2])
        setattr(import_module(package), name, value)  # stored for later access
        return value

    getattribute.names = list(home)  # type: ignore[attr-defined]  # for `__all__`
    return getattribute


if not TYPE_CHECKING:  # a type checker knows the names above and no others
    __getattr__ = lazily(
        __name__,
        ("hystmpc.trials.check", "CheckReport Finding Severity"),
        ("hystmpc.trials.csv_files", "write_csv"),
        ("hystmpc.trials.errors", "HystmpcError"),
        ("hystmpc.trials.from_outside", "allow_python"),
        ("hystmpc.trials.read", "read_trials"),
        ("hystmpc.trials.tip", "angles_from_bend angles_from_tip angles_from_tip_aside tip_from_angles"),
        ("hystmpc.trials.trial", "Trial Units resample"),
    )
