"""A fatigue rig with slow dynamics and little hysteresis: voltage of the valve to displacement.

Source: github.com/decargroup/system_norm_koopman (MIT).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import final

from hystmpc.trials.layouts import LogMapping
from hystmpc.trials.read import read_trials
from hystmpc.trials.trial import Trial, Units

from .records import Case, PublicData, ScoredRecord, files_in, unsettled, withheld_end
from .settings import PublicSettings

LAYOUT = LogMapping.parse(
    {"command": {"signal": "u", "unit": "V"}, "angle": {"signal": "d", "unit": "mm"}, "time": "t"}, "rig"
)
RATE_HZ, _SEEN = 25.0, 2 / 3


@final
class RigData(PublicData):
    """Each log alone: its first two thirds are fitted, its last third is scored, and every test file whole."""

    title = "A fatigue rig"
    about = """A beam in a hydraulic rig: the voltage of the valve in V to the displacement in mm, at 25 Hz. The first
two thirds of a log are identified from. A free run begins with the log, and its last third is scored. Files of --test
are scored whole but for their first 5 s, by free runs from their first samples."""
    units = Units("V", "mm")
    note = "We know of no published figure for this prediction."

    def files(self, settings: PublicSettings) -> tuple[Path, ...]:
        return (*files_in(settings.data, "*.csv"), *map(Path, settings.test))

    def cases(self, settings: PublicSettings) -> Sequence[Case]:
        given = [
            ScoredRecord(Path(part.source).name, part, float(part.angle[0]), first=unsettled(part))
            for parts in map(_read, map(Path, settings.test))
            for part in parts
        ]
        found = []
        for path in files_in(settings.data, "*.csv"):
            seen, left = withheld_end(_read(path), _SEEN, "last third")
            found.append(Case(path.stem, seen, [*left, *given]))
        return found


def _read(path: Path) -> list[Trial]:
    return read_trials(path, LAYOUT, rate_hz=RATE_HZ)
