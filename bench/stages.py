"""Runner of stages: each has a folder, a fingerprint of its inputs, and a result that is loaded on resume."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, TypeVar, final

from pydantic import BeforeValidator, PlainSerializer, PlainValidator, TypeAdapter

from hystmpc.rig.axes import PerAxis, together, trial_columns
from hystmpc.rig.config import BenchSettings
from hystmpc.trials.csv_files import format_table, write_csv
from hystmpc.trials.errors import ConfigError, HystmpcError, LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.json_text import canonical, file_text, json_hash, plain
from hystmpc.trials.run_folder import alone_in, require_vacant, resumed_folder
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Progress, Vec

from .device import DeviceStoppedError, MovableDevice, Open
from .motions import prepare_seconds, run_seconds

FORMAT = "hystmpc-commissioning/1"
RESULT, BEGUN, DIAGNOSIS = "result.json", "begun.json", "diagnosis"
_COMPUTED = 0.05  # seconds that a computed device takes for one of device time, for the bar

Figure = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
"""A number, NaN where JSON has null."""


def _per_axis(value: Any) -> PerAxis:
    values = value if isinstance(value, list | tuple) else [value]
    return together(math.nan if one is None else float(one) for one in values)


AxisFigures = Annotated[PerAxis, PlainValidator(_per_axis), PlainSerializer(lambda value: value, return_type=Any)]
"""A number of one axis, or a pair of two axes; NaN where JSON has null."""

R = TypeVar("R")


class EndedEarlyError(HystmpcError):
    """Error of a stage that cannot be completed after the device has moved; recordings are kept."""


@final
class Stages:
    """Stages of one folder in order: executed, or loaded if complete with the same settings and earlier results.

    Device time and computing time add up to one progress bar; a computed device counts with 5 % of its time.

    Args:
        settings: plain data that all results depend on.
        opens: opens the device; None where nothing is moved.
        progress: called with the time passed, the time expected [s], and a note.
        closed: whether a stage without a result is an error.
    """

    def __init__(
        self,
        root: Path,
        settings: Mapping[str, Any],
        opens: Open | None = None,
        progress: Progress | None = None,
        closed: bool = False,
    ) -> None:
        self.root, self._mark, self._progress, self._closed = root, fingerprint(settings), progress, closed
        self._device_s = self._expected_s = 0.0
        self._computed_s = self._stage_s = self._computing_s = 0.0  # of complete stages, of this one, and done of it
        self._spared_s = 0.0  # device time that complete stages needed less than planned
        self._note = self._prepared = ""
        self._device = None if opens is None else opens(root, self.tick)

    @property
    def device(self) -> MovableDevice:
        """Device under test.

        Raises:
            ConfigError: if everything is made from recordings.
        """
        if self._device is None:
            raise ConfigError(f"{self.root}: got recordings alone, expected a device")
        return self._device

    @property
    def used_s(self) -> float:
        """Device time used, interrupted motions included [s]."""
        return 0.0 if self._device is None else self._device.used_s

    @property
    def left_s(self) -> float:
        """Remaining device time [s]."""
        return self._device_s - self.used_s

    def expect(self, device_s: float, computing_s: float) -> None:
        """Set the device time and the computing time that the progress bar expects [s]."""
        self._device_s, self._expected_s = device_s, computing_s

    def complete(
        self, name: str, kind: type[R], do: Callable[[Path], R], computing_s: float = 0.0, device_s: float = 0.0
    ) -> R:
        """Result of a stage: loaded if it is complete, otherwise computed by `do`.

        Args:
            name: of its folder under `root`.
            do: executes the stage in its folder; where it raises, the folder keeps its files.
            computing_s, device_s: expected computing and device time, for the progress bar [s].

        Raises:
            ConfigError: if the folder holds the stage of other settings or results.
            LogError: if its result is damaged, or missing in a closed folder.
        """
        folder, adapter, used_s = self.root / name, TypeAdapter(kind), self.used_s
        begun = folder / BEGUN
        if begun.exists() and _begun_after(begun) != self._mark:
            raise ConfigError(
                f"{folder}: was begun after other results than those that lie before it now, expected the same; "
                "remove this folder and those after it to have them done again"
            )
        self._stage_s, self._computing_s = computing_s, 0.0
        if (folder / RESULT).exists():
            result = _loaded(folder / RESULT, adapter)
        elif self._closed:
            raise LogError(
                f"{folder}: has no {RESULT}, expected a complete commissioning; the same `hystmpc commission` goes on"
            )
        else:
            write_atomically(begun, json.dumps({"format": FORMAT, "fingerprint": self._mark}) + "\n")
            result = do(folder)
            data = {"format": FORMAT, "stage": name, "result": plain(adapter.dump_python(result, mode="json"))}
            write_atomically(folder / RESULT, file_text(data))
            self._spared_s += max(device_s - (self.used_s - used_s), 0.0)
        self._computed_s, self._computing_s = self._computed_s + computing_s, 0.0
        dumped = canonical(plain(adapter.dump_python(result, mode="json")))
        self._mark = fingerprint([self._mark, name, dumped])
        return result

    def record(self, runs: Mapping[str, Vec], bench: BenchSettings, folder: Path, limited: bool = False) -> list[str]:
        """Play commands and write each recording into `folder/trials`; return the recordings' names in order.

        Commands are (N,), of two axes (N, 2). Existing recordings are kept.

        Args:
            limited: whether a motion that might not end within the device time is left out, with those after it.

        Raises:
            DeviceStoppedError: if a motion was stopped safely; complete recordings are kept.
            LogError: if the device time suffices for none.
        """
        part, names = folder.relative_to(self.root).parts[0], list[str]()
        for name, commands in runs.items():
            file = folder / "trials" / f"{name}.csv"
            if not file.exists():
                prepare_s = 0.0 if part == self._prepared else prepare_seconds(bench)
                if limited and run_seconds(bench, len(commands)) + prepare_s > self.left_s:
                    break
                self.say(f"{part}: {name}")
                trial = self.device.play(f"{part}/{name}", commands, bench)
                self._prepared = part
                write_recording(trial, file)
            names.append(name)
        if not names:
            raise LogError(
                f"{part}: {self.left_s:.0f} s of device time are left, motions that were cut short included, which is "
                "too little for what was planned, expected more; another --out begins anew"
            )
        return names

    def say(self, note: str, moving_s: float = 0.0) -> None:
        """Report the progress with a note, `moving_s` seconds after the present motion began."""
        self._note = note
        if self._progress is None:
            return
        pace = _COMPUTED if self._device is None or not self._device.in_real_time else 1.0
        computed_s = self._computed_s + self._computing_s
        total = pace * self._device_s + max(self._expected_s, computed_s)
        passed = pace * (self.used_s + self._spared_s + moving_s) + computed_s
        self._progress(min(passed, total), total, note)

    def tick(self, moving_s: float) -> None:
        """Report the progress within a motion."""
        self.say(self._note, moving_s)

    def computing(self, what: str) -> Progress:
        """Progress callback of the present stage's computation, as part of the whole."""

        def report(done: float, total: float, note: str = "", /) -> None:
            self._computing_s = self._stage_s * min(done / max(total, 1e-9), 1.0)
            self.say(f"{what} {note}".strip())

        report(0, 1)
        return report


def write_recording(trial: Trial, file: Path) -> Path:
    """Write a trial of one axis or of two as CSV, whole or not at all."""
    if trial.commands.shape[1] == 1:
        return write_csv(trial, file)
    columns = trial_columns(trial.t, trial.commands, trial.angles, trial.units.command)
    return write_atomically(file, format_table(columns))


@contextmanager
def begun(
    out: Path | str,
    kind: str,
    settings: Mapping[str, Any],
    seed: int,
    opens: Open | None = None,
    progress: Progress | None = None,
) -> Iterator[Stages]:
    """Begin or resume the stages of a commissioning or an investigation in a folder.

    Args:
        kind: `commissioning` or `investigation`.
        settings: plain data.

    Raises:
        ConfigError: if the folder holds something else, was begun with other settings, or another process works in it.
        EndedEarlyError: in place of another error after the device has moved.
    """
    plain = {kind: 1, **settings}

    def refusal(earlier: Any) -> str:
        if not isinstance(earlier, Mapping) or kind not in earlier:
            return f"holds another kind of run, expected a new, empty or {kind} folder"
        text = differing(earlier, plain)
        return f"{text}; expected equal settings, or another --out" if text else ""

    if not (Path(out) / "meta.json").exists():
        require_vacant(Path(out))
    root = resumed_folder(Path(out), plain, seed, refusal).path
    with alone_in(root):
        stages = Stages(root, settings, opens, progress)
        before_s = stages.used_s
        try:
            yield stages
        except (DeviceStoppedError, EndedEarlyError):
            raise
        except HystmpcError as error:
            if stages.used_s > before_s:
                raise EndedEarlyError(f"{error} (what was recorded is kept in {root})") from error
            raise


def _begun_after(file: Path) -> str:
    """Fingerprint of settings and results before a stage, read from its file."""
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["fingerprint"])
    except (OSError, ValueError, KeyError, TypeError):
        raise LogError(f"{file}: cannot be read, expected what a stage writes; remove its folder") from None


def _loaded(file: Path, adapter: TypeAdapter[R]) -> R:
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        if data["format"] != FORMAT:
            raise ValueError(f"format {data['format']!r}")
        return adapter.validate_python(data["result"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise LogError(f"{file}: not the result of a stage ({reason}); remove its folder to repeat it") from None


def fingerprint(parts: object) -> str:
    """SHA-256 of plain data."""
    return json_hash(parts, default=str)


def differing(before: Any, now: Mapping[str, Any], at: str = "") -> str:
    """First key whose values differ, with both values, in words; empty if all are equal."""
    if not isinstance(before, Mapping):
        return f"holds {at or 'settings'} {before!r}, now {now!r}"
    for key in dict.fromkeys((*before, *now)):
        old, new, name = before.get(key), now.get(key), f"{at}{key}"
        if isinstance(old, Mapping) and isinstance(new, Mapping):
            if text := differing(old, new, f"{name}."):
                return text
        elif old != new:
            return f"was begun with {name} {old!r}, now it is {new!r}"
    return ""
