"""Check of recorded logs before their use."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hystmpc.trials.brief import in_brief
from hystmpc.trials.check import Severity
from hystmpc.trials.check import check as check_log
from hystmpc.trials.findings import CheckReport
from hystmpc.trials.read import AnyLayout, Log, expand_logs, read_trials
from hystmpc.trials.types import Progress

from .inputs import Logs, Model, as_list, chain_or_model

if TYPE_CHECKING:
    from hystmpc.gap.diagnosis import DetectableSizes


@dataclass(frozen=True, eq=False)
class LogsCheck:
    """Findings on logs.

    Attributes:
        detectable: smallest detectable size of each effect in a diagnosis; None without a simulator, or with an
            unusable log.
    """

    reports: tuple[CheckReport, ...]
    detectable: DetectableSizes | None = None

    @property
    def worst(self) -> Severity:
        """The greatest severity among the findings."""
        order = list(Severity)
        return max((report.worst for report in self.reports), key=order.index, default=Severity.OK)

    def __len__(self) -> int:
        return len(self.reports)

    def __iter__(self) -> Iterator[CheckReport]:
        return iter(self.reports)

    def __getitem__(self, k: int) -> CheckReport:
        return self.reports[k]

    def __repr__(self) -> str:
        findings = sum(len(report.findings) for report in self.reports)
        return in_brief(self, f"{len(self)} logs: {findings} findings, worst {self.worst}")

    def __str__(self) -> str:
        return "\n\n".join(map(str, self.reports))

    def _repr_html_(self) -> str:
        return "".join(report._repr_html_() for report in self.reports)


def check(
    logs: Logs,
    *,
    layout: AnyLayout = "auto",
    sampled_hz: float | None = None,
    simulator: Model | None = None,
    show: Callable[[CheckReport], object] | None = None,
    progress: Progress | None = None,
) -> LogsCheck:
    """Check time base, jitter, gaps, duplicates, values, units, sign, excitation, segments and first flexure.

    Faults for which `read_trials` would refuse a file or frame become findings.

    Args:
        logs: logs, data frames or trials.
        layout: layout of the logs: auto, canonical, two-axes, tendons, tendon-catheter, or a mapping file *.yaml.
        sampled_hz: rate [Hz] of logs sampled evenly; stands in for a broken or missing clock.
        simulator: simulator of a diagnosis: smallest detectable effects, from the commands alone.
        show: called with the findings on each log as soon as they are there.
        progress: called with the logs done and their number.

    Raises:
        LogError: if a log cannot be read, or lacks a column or signal.
        ConfigError: on an unknown layout or a wrong mapping file.
        ModelError: if the simulator cannot be opened.
    """
    chain = None if simulator is None else chain_or_model(simulator)
    several, reports = as_list(logs), list[CheckReport]()
    single: list[Log] = []
    for log in several or expand_logs([]):
        single += expand_logs([log]) if isinstance(log, Path | str) else [log]
    for log in single:
        reports.append(check_log(log, layout, sampled_hz))
        if show is not None:
            show(reports[-1])
        if progress is not None:
            progress(len(reports), len(single))
    checked = LogsCheck(tuple(reports))
    if chain is None or checked.worst is Severity.ERROR:
        return checked
    from hystmpc.gap.diagnose import detectable_in_logs  # scipy takes long to import

    if progress is not None:
        progress(len(single), len(single), "what the logs would show")
    trials = read_trials(several, layout, sampled_hz=sampled_hz)
    return LogsCheck(checked.reports, detectable_in_logs(trials, chain))
