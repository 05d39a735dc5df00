"""The whole diagnosis, for every caller: causes, verdict, tracking gap, and the folder that it leaves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hystmpc.models.model import LoadedModel
from hystmpc.models.simulator import Simulator
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress

from .decide.findings import Findings
from .diagnose import conclude, find_causes
from .diagnosis import Diagnosis
from .report.report_data import Evidence


@dataclass(frozen=True, eq=False)
class Diagnosed:
    """A diagnosis with all that it rests on.

    Attributes:
        findings: result of every step.
        evidence: what its report shows.
    """

    findings: Findings
    evidence: Evidence

    @property
    def diagnosis(self) -> Diagnosis:
        """The result."""
        return self.evidence.diagnosis


def diagnose_trials(
    trials: Sequence[Trial],
    simulator: Simulator | LoadedModel,
    *,
    out: Path | str | None = None,
    called: Mapping[str, Any] | None = None,
    model: Path | None = None,
    seed: int = 1,
    without: Sequence[str] = (),
    only: Sequence[str] | None = None,
    ordered: bool = True,
    skip_first_flexure: bool = False,
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> Diagnosed:
    """Diagnose trials as `hystmpc diagnose` does: the one way from logs to a verdict, a tracking gap and a folder.

    Args:
        trials: as recorded, of one device.
        simulator: a chain of operators or an exported model.
        out: folder for report, corrected simulator and next motion; nothing is written where left out.
        called: further facts of how it was called, kept in the folder beside the arguments below.
        model: file of the simulator; its SHA-256 is kept in the folder, its name stands in the report.
        seed, without, only, ordered, skip_first_flexure, progress, say: see `find_causes`.

    Raises:
        LogError, GapError, ModelError: see `find_causes`.
        ConfigError: if `out` holds anything but an older diagnosis, or cannot be written.
    """
    from .report.folder import require_free, save_diagnosis
    from .tracking.diagnosed import with_tracking

    if out is not None:
        require_free(out)
    findings = find_causes(
        trials,
        simulator,
        seed=seed,
        without=without,
        only=only,
        progress=progress,
        say=say,
        ordered=ordered,
        skip_first_flexure=skip_first_flexure,
    )
    evidence = with_tracking(conclude(findings, progress)[1], progress)
    if model is not None:
        evidence = replace(evidence, simulator=model.name)
    if out is not None:
        settings: dict[str, Any] = {
            "logs": [trial.source for trial in trials],
            **(called or {}),
            "seed": seed,
            "without": list(without),
            "only": None if only is None else list(only),
            "ordered": ordered,
            "skip_first_flexure": skip_first_flexure,
        }
        if progress is not None:
            progress(100, 100, "writing the report")
        save_diagnosis(evidence, out, settings, models=() if model is None else (model,))
    return Diagnosed(findings, evidence)
