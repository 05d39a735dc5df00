"""Public logs as data sets: friction of the seals of 3D-printed pneumatic pistons, and a fatigue rig.

Sources: github.com/EvaZillen/3D-printed-pneumatic-actuator (CC0), github.com/decargroup/system_norm_koopman (MIT).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import final

import numpy as np

from hystmpc.models.identify.chain_kinds import branch
from hystmpc.trials.errors import LogError
from hystmpc.trials.layouts import LogMapping
from hystmpc.trials.read import read_trials
from hystmpc.trials.segments import Motion
from hystmpc.trials.trial import Trial, Units

from .records import Case, PublicData, PublicSettings, ScoredRecord, files_in, unsettled, withheld_end

SEAL_LAYOUT = LogMapping.parse(
    {
        "command": {"signal": "[4]", "unit": "mm"},
        "angle": {"signal": "[6]", "unit": "N"},
        "channels": {"pressure_bar": {"signal": "[5]"}},
        "time": "[0]",
        "time_unit": "ms",
    },
    "seals",
)
RATE_HZ, _SEEN_STROKES, _LAW = 25.0, 0.6, 2  # least number of pressures for an extrapolation of friction
_NAME = re.compile(r"(.+)_([0-9.]+)bar")


@final
class SealData(PublicData):
    """Seal friction: each file alone with its last strokes held out, or other pressures or files as the test.

    For a seal of several pressures the highest one, or a test file, is predicted.
    """

    title = "Friction of the seals of pneumatic pistons"
    about = """The displacement of a piston in mm to the force at its rod in N, ten strokes a file at a constant
pressure, at 25 Hz. The first 60 % of a file are identified from, and the rest is scored. Where a seal was recorded at
three pressures or more, models of the others predict the highest: as they are, and multiplied by the friction that a
line over the pressure foretells. Files of --test are predicted from all files of their seal in the same two ways. There
the mean of each file is taken off. Compare the errors less their mean: the offset of the force sensor is not known."""
    units = Units("mm", "N")
    note = "We know of no published figure for this prediction."

    def files(self, settings: PublicSettings) -> tuple[Path, ...]:
        return (*files_in(settings.data, "*bar.tsv"), *map(Path, settings.test))

    def cases(self, settings: PublicSettings) -> Sequence[Case]:
        logs = {path: _seal_log(path) for path in self.files(settings)}
        given = {Path(path) for path in settings.test}
        seen = [path for path in logs if path not in given]
        found = [_strokes(path, logs[path]) for path in seen]
        for seal in sorted({_named(path)[0] for path in logs}):
            own = sorted((path for path in seen if _named(path)[0] == seal), key=lambda path: _named(path)[1])
            tests = [path for path in given if _named(path)[0] == seal]
            if len(own) > _LAW:
                found += _pressures({path: logs[path] for path in own}, own[:-1], own[-1])
            for test in tests:
                found += _pressures({path: logs[path] for path in (*own, test)}, own, test)
        return found[:1] if settings.quick else found


def _named(path: Path) -> tuple[str, float]:
    """Seal, and pressure [bar], from a file's name; `LogError` if it has another form."""
    if (match := _NAME.fullmatch(path.stem)) is None:
        raise LogError(f"{path}: expected a name like O-ring_3bar.tsv: seal and pressure")
    return match[1], float(match[2])


def _seal_log(path: Path) -> list[Trial]:
    _named(path)
    return read_trials(path, SEAL_LAYOUT, rate_hz=RATE_HZ)


def half_height(trials: Sequence[Trial]) -> float:
    """Half the distance of the branches at the middle of the stroke [N], which is the friction force."""
    command = np.concatenate([trial.command for trial in trials])
    middle = 0.5 * float(command.max() + command.min())
    rise, fall = (np.polyval(branch(trials, way, rises=False), middle) for way in (Motion.LOADING, Motion.UNLOADING))
    return 0.5 * float(rise - fall)


def _strokes(path: Path, parts: Sequence[Trial]) -> Case:
    """Case with the first strokes of a file for the fit, and the last for the score."""
    seen, left = withheld_end(parts, _SEEN_STROKES, "last strokes")
    facts = {"friction [N]": half_height(parts), "spread of the force [N]": _spread(parts)}
    return Case(path.stem, seen, left, facts)


def _spread(parts: Sequence[Trial]) -> float:
    return float(np.std(np.concatenate([part.angle for part in parts])))


def _pressures(logs: Mapping[Path, Sequence[Trial]], own: Sequence[Path], test: Path) -> Iterator[Case]:
    """Case with a fit to some files of a seal and a score on another; friction unscaled, or linear in the pressure."""
    if not own:
        raise LogError(f"{test}: no file of the same seal in --data, expected one or more")
    parts = {path: _centred(found) for path, found in logs.items()}
    heights = {path: half_height(found) for path, found in parts.items()}
    name, (seal, pressure) = f"{test.stem} from {len(own)} other", _named(test)
    seen = [_named(path)[1] for path in own]
    facts: dict[str, float | str] = {"friction [N]": heights[test], "spread of the force [N]": _spread(parts[test])}
    yield Case(name, [t for path in own for t in parts[path]], _scored(parts[test], 1.0), facts)
    if len(set(seen)) < _LAW:
        return
    slope, offset = np.polyfit(seen, [heights[path] for path in own], 1)
    law = float(offset + slope * pressure)
    facts |= {"law": f"{seal}: {offset:.3g} N + {slope:.3g} N/bar, {law:.3g} N at {pressure:g} bar"}
    scaled = [replace(t, angle=t.angle / heights[path]) for path in own for t in parts[path]]
    yield Case(f"{name}, scaled", scaled, _scored(parts[test], law), facts)


def _centred(parts: Sequence[Trial]) -> list[Trial]:
    mean = float(np.concatenate([part.angle for part in parts]).mean())
    return [replace(part, angle=part.angle - mean) for part in parts]


def _scored(parts: Sequence[Trial], height: float) -> list[ScoredRecord]:
    found = []
    for k, part in enumerate(parts, 1):
        divided, name = replace(part, angle=part.angle / height), "whole" if len(parts) == 1 else f"part {k}"
        start, first = float(divided.angle[0]), unsettled(part)
        found.append(ScoredRecord(name, divided, start, first=first, height=height))
    return found


RIG_LAYOUT = LogMapping.parse(
    {"command": {"signal": "u", "unit": "V"}, "angle": {"signal": "d", "unit": "mm"}, "time": "t"}, "rig"
)
_SEEN_OF_RIG = 2 / 3


@final
class RigData(PublicData):
    """Fatigue rig: the first two thirds of each log for the fit, its last third and every test file for the score."""

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
            for parts in map(_rig_log, map(Path, settings.test))
            for part in parts
        ]
        found = []
        for path in files_in(settings.data, "*.csv"):
            seen, left = withheld_end(_rig_log(path), _SEEN_OF_RIG, "last third")
            found.append(Case(path.stem, seen, [*left, *given]))
        return found


def _rig_log(path: Path) -> list[Trial]:
    return read_trials(path, RIG_LAYOUT, rate_hz=RATE_HZ)
