"""Kinds of model over several devices: the study on recorded logs of each, side by side; which kind to try first."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from hystmpc.models.kinds.catalogue import kind_names
from hystmpc.trials.config import Settings, read_yaml
from hystmpc.trials.errors import ConfigError
from hystmpc.trials.report import Heading, Paragraph, Piece, Report

from ..study import NOTHING, Cell, StudyTable
from .real import RealCandidate, candidates
from .result import PaperOutcome
from .settings import PaperSettings

DEVICES_KINDS = tuple(name for name in kind_names() if name not in ("oscillator", "state_network"))
"""All kinds but those for devices that ring."""


class DeviceLogs(Settings):
    """Logs of one device.

    Attributes:
        logs: files, beside the file that names them; each is left out once.
        layout: layout of the logs, or a mapping file beside that file.
        rate_hz: rate to which they are resampled [Hz].
        parts: equal parts that each log is cut into, for devices of which one log is all there is.
    """

    logs: Annotated[tuple[str, ...], Field(min_length=1)]
    layout: str = "auto"
    rate_hz: Annotated[float, Field(gt=0)] = 25.0
    parts: Annotated[int, Field(ge=1, le=20)] = 1


def device_settings(file: Path, **changes: Any) -> dict[str, PaperSettings]:
    """Settings of the study on the logs of each device that a file lists.

    Raises:
        ConfigError: if the file is no list of devices, or a device's settings are wrong.
    """
    content = read_yaml(file)
    if not isinstance(content, dict) or not content:
        raise ConfigError(f"{file}: expected devices by name, each with its logs")
    found = {}
    for name, own in content.items():
        device, beside = DeviceLogs.parse(own, f"{file}: {name}"), file.parent
        layout = beside / device.layout
        found[str(name)] = PaperSettings.for_study(
            "real",
            logs=[str(beside / log) for log in device.logs],
            layout=str(layout) if layout.is_file() else device.layout,
            rate_hz=device.rate_hz,
            parts=device.parts,
            **{"kinds": DEVICES_KINDS, "presets": ("best",)} | {k: v for k, v in changes.items() if v},
        )
    return found


def kinds_report(outcomes: Mapping[str, PaperOutcome]) -> tuple[Report, list[StudyTable]]:
    """The page and all tables that are written as CSV."""
    found = {name: candidates(outcome, "forward")[0] for name, outcome in outcomes.items()}
    tables = [errors_table(found), drift_table(found), cost_table(found)]
    failed = [f"{name}: {r.job.kind}: {r.message}" for name, o in outcomes.items() for r in o.failed]
    pieces: list[Piece] = [Paragraph(try_first(found)), *(table.piece for table in tables)]
    pieces += [Heading("Failed fits"), *map(Paragraph, failed)] if failed else []
    return Report("Kinds of model over devices", tuple(pieces), f"real logs of {', '.join(outcomes)}"), tables


Found = Mapping[str, Sequence[RealCandidate]]
"""By device: kinds with a score for every log."""


def error_percent(candidate: RealCandidate) -> float:
    """Offset-free RMSE, mean over the logs that were left out [% of the range of each]."""
    return float(np.mean(_of_range(candidate, "offset_free_rmse_deg")))


def _of_range(candidate: RealCandidate, name: str) -> list[float]:
    """A figure of every log in per cent of its measured range; the RMSE over the range is known."""
    rmse, share = (candidate.figures(figure, "later") for figure in ("rmse_deg", "nrmse"))
    return np.divide(100 * candidate.figures(name, "later") * share, rmse, where=rmse > 0, out=0 * rmse).tolist()


def ratios(found: Found) -> dict[str, dict[str, float]]:
    """By kind and device: error over that of the best kind on that device."""
    kinds = dict.fromkeys(candidate.kind for own in found.values() for candidate in own)
    errors = {name: {c.kind: error_percent(c) for c in own} for name, own in found.items()}
    return {
        kind: {name: own[kind] / max(min(own.values()), 1e-12) for name, own in errors.items() if kind in own}
        for kind in kinds
    }


def ranked(found: Found) -> list[tuple[str, float, float]]:
    """Kinds, those that fit more devices first, then by the mean ratio (geometric): name, mean and worst ratio."""
    own = ratios(found)
    means = {kind: math.exp(float(np.mean(np.log(list(of.values()))))) for kind, of in own.items()}
    order = sorted(own, key=lambda kind: (-len(own[kind]), means[kind]))
    return [(kind, means[kind], max(own[kind].values())) for kind in order]


def try_first(found: Found) -> str:
    """Which kind to try first, in one sentence."""
    if not any(found.values()):
        return "No kind could be fitted."
    (kind, mean, worst), devices = ranked(found)[0], len(found)
    return (
        f"Try {kind} first: over {devices} devices its error is {mean:.2f} times that of the best kind of each in the "
        f"mean, {worst:.2f} times at worst."
    )


def errors_table(found: Found) -> StudyTable:
    """Kinds by devices."""
    rows: list[list[Cell]] = [
        [kind, *_cells(found, kind, error_percent), mean, worst] for kind, mean, worst in ranked(found)
    ]
    columns = ("kind", *found, "over the best, mean", "over the best, worst")
    caption = (
        "Real logs: offset-free RMSE in per cent of the measured range, from the first reversal on, mean over "
        "logs each of which was left out once. Over the best: ratio to the best kind of a device, geometric mean and "
        "worst."
    )
    return StudyTable("kinds_errors", columns, rows, caption)


def drift_table(found: Found) -> StudyTable:
    """Movement of each kind's output while the command rests."""
    rows: list[list[Cell]] = [
        [kind, *_cells(found, kind, lambda c: max(_of_range(c, "hold_drift_deg")))] for kind, _, _ in ranked(found)
    ]
    caption = (
        "Real logs: greatest range of the model's output while the command rests, from 1 s after it came to rest, in "
        "per cent of the measured range. The last command of each log is held for 10 s."
    )
    return StudyTable("kinds_drift", ("kind", *found), rows, caption)


def cost_table(found: Found) -> StudyTable:
    """Time to fit and size of each kind."""
    rows: list[list[Cell]] = []
    for kind, _, _ in ranked(found):
        seconds = _cells(found, kind, lambda c: float(np.median([r.seconds for r in c.results])))
        sizes = sorted({r.numbers for own in found.values() for c in own if c.kind == kind for r in c.results})
        rows.append([kind, *seconds, "-".join(dict.fromkeys(str(n) for n in (sizes[0], sizes[-1])))])
    caption = "Median time of a fit with its export and scores [s], one thread, and numbers in a model: least-most."
    return StudyTable("kinds_cost", ("kind", *found, "numbers"), rows, caption)


def _cells(found: Found, kind: str, value: Any) -> list[Cell]:
    """A cell for each device; of several presets the one with the lowest error."""
    cells: list[Cell] = []
    for own in found.values():
        best = min((c for c in own if c.kind == kind), key=error_percent, default=None)
        cells.append(NOTHING if best is None else value(best))
    return cells
