"""Verbs of the laboratory for the program `hystmpc`."""

from collections.abc import Mapping
from types import MappingProxyType

VERBS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "study": ("hystmpc_lab.verbs.study:study", "Do all jobs of a study and write its report."),
        "data": ("hystmpc_lab.verbs.data:data", "Make the papers' data sets on simulated devices."),
        "gap": ("hystmpc_lab.verbs.gap:gap", "Put the diagnosis to the test."),
        "faults": (
            "hystmpc_lab.verbs.faults:faults",
            "Break sensor, wire, processes and disk; judge what the device did.",
        ),
        "bench": ("hystmpc_lab.verbs.bench:bench", "Time the controllers and their peers on this machine."),
    }
)
"""Every verb: MODULE:NAME of its function or group, and its line in `hystmpc --help`."""
