"""Findings of a quality check: severity, topic and message."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from .brief import in_brief


class Severity(StrEnum):
    """How much a finding matters, least first."""

    OK = "ok"
    NOTE = "note"  # worth knowing
    WARNING = "warning"  # the log can be used, results will suffer
    ERROR = "error"  # readers or identifications will refuse the log


@dataclass(frozen=True)
class Finding:
    """One line of a quality check.

    Attributes:
        severity: how much it matters.
        topic: what was looked at, such as `jitter` or `units`.
        message: what was found, with numbers and units.
    """

    severity: Severity
    topic: str
    message: str


@dataclass(frozen=True)
class CheckReport:
    """All findings on one log, in the order of the checks.

    Attributes:
        source: path of the log.
        layout: layout it was read with, empty for a trial from memory.
        findings: at least one per topic.
    """

    source: str
    layout: str
    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        return in_brief(self, f"{self.source}: {len(self.findings)} findings, worst {self.worst}")

    @property
    def worst(self) -> Severity:
        """The greatest severity among the findings."""
        order = list(Severity)
        return max((f.severity for f in self.findings), key=order.index, default=Severity.OK)

    def of(self, topic: str) -> tuple[Finding, ...]:
        """The findings on one topic."""
        return tuple(f for f in self.findings if f.topic == topic)

    def __str__(self) -> str:
        head = f"{self.source} ({self.layout})" if self.layout else self.source
        return "\n".join([head, *(f"{f.severity:8} {f.topic}: {f.message}" for f in self.findings)])

    def _repr_html_(self) -> str:
        from .report import Report, Table  # matplotlib takes longer to import than a log to check

        rows = [(str(f.severity), f.topic, f.message) for f in self.findings]
        return Report(self.source, (Table(("", "topic", "finding"), rows),), self.layout).fragment()
