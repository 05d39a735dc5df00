"""Recordings: check that a trial is a recording, and the order in which trials were recorded."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from .axes import require_one_axis
from .check import require_sound
from .config import Settings, dump_yaml, read_yaml
from .errors import LogError
from .files import write_atomically
from .read import AnyLayout, Log, read_trials
from .trial import Trial

SEPARATION_COLUMN = "separation_deg"
"""Column that only motions proposed by a diagnosis have, and no recording."""


def require_recorded(trial: Trial) -> None:
    """Refuse a trial that is no recording: a motion proposed by a diagnosis, or wrong signals.

    Raises:
        LogError: if its angle is the expected angle of a proposed motion, or as `require_sound`.
    """
    if SEPARATION_COLUMN in trial.channels:
        raise LogError(f"{trial.source}: is a motion proposed by a diagnosis, expected what was recorded on it")
    require_sound(trial)


def recorded_trials(
    logs: Log | Iterable[Log], layout: AnyLayout = "auto", sampled_hz: float | None = None, most_axes: int = 1
) -> list[Trial]:
    """Read logs as recorded, see `read_trials`; refuse what is no recording.

    Args:
        most_axes: 2 where a log may have a second axis in channels, see `both_axes`.

    Raises:
        LogError: if a log cannot be read, is a proposed motion, its signals are misread, or it has too many axes.
        ConfigError: on an unknown layout, or a rate that is no positive number.
    """
    trials = read_trials(logs, layout, sampled_hz=sampled_hz)
    for trial in trials:
        require_recorded(trial)
        if most_axes == 1:
            require_one_axis(trial)
    return trials


MANIFEST = "manifest.yaml"
FORMAT: Final = "hystmpc-recording/1"
WALL_CLOCK = "wall_ns"  # column of a bench's log: time since 1970 [ns]


class RecordingManifest(Settings):
    """Manifest of a session, `manifest.yaml` in the folder of its logs: the recorded trials in their order.

    Attributes:
        recorded: names of the files in the order of recording.
        start: of the session; orders sessions of several folders.
    """

    format: Literal["hystmpc-recording/1"] = FORMAT
    recorded: tuple[str, ...]
    start: datetime | None = None


def write_manifest(folder: Path, files: Sequence[Path], start: datetime | None = None) -> Path:
    """Write the manifest of a session: logs of a folder in recording order, and the start (default: now)."""
    begun = (start or datetime.now(UTC)).isoformat()
    content = {"format": FORMAT, "start": begun, "recorded": [file.name for file in files]}
    return write_atomically(folder / MANIFEST, dump_yaml(content))


def by_clock(trials: Sequence[Trial]) -> list[int] | None:
    """Indices of the trials in the order of their time stamps; None if these do not define one.

    Time stamps define an order if all logs share one clock, so that no two trials overlap in time. The wall clock of a
    bench's log has precedence, since its time stamps restart in each log.
    """
    spans = [_span(trial) for trial in trials]
    order = sorted(range(len(spans)), key=lambda k: spans[k])
    apart = all(spans[a][1] < spans[b][0] for a, b in itertools.pairwise(order))
    same_clock = len({WALL_CLOCK in trial.channels for trial in trials}) == 1
    return order if apart and same_clock else None


def by_manifest(sources: Sequence[str]) -> list[int] | None:
    """Indices of the logs in manifest order, folders by the starts of their sessions; None if a log is not listed."""
    places: list[tuple[str, int]] = []
    manifests = {folder: _manifest(folder) for folder in {Path(source).parent for source in sources}}
    starts = [manifest.start for manifest in manifests.values() if manifest is not None]
    if len(starts) < len(manifests) or (len(manifests) > 1 and len(set(starts) - {None}) < len(manifests)):
        return None
    for path in map(Path, sources):
        manifest = manifests[path.parent]
        if manifest is None or path.name not in manifest.recorded:
            return None
        begun = manifest.start.astimezone(UTC).isoformat() if manifest.start and len(manifests) > 1 else ""
        places.append((begun, manifest.recorded.index(path.name)))
    return sorted(range(len(places)), key=lambda k: places[k]) if len(set(places)) == len(places) else None


def _span(trial: Trial) -> tuple[float, float]:
    wall = trial.channels.get(WALL_CLOCK)
    if wall is not None and np.isfinite(wall).all():
        return 1e-9 * float(wall[0]), 1e-9 * float(wall[-1])
    return float(trial.t[0]), float(trial.t[-1])


def _manifest(folder: Path) -> RecordingManifest | None:
    file = folder / MANIFEST
    if not file.is_file():
        return None
    data: Any = read_yaml(file)
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        return None
    return RecordingManifest.parse(data, str(file))
