"""Stages of a commissioning on disk: a folder each, begun with a fingerprint, complete with its result."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar, final

from pydantic import BeforeValidator, TypeAdapter

from hystmpc.sim.jobs.runner import resumed_folder
from hystmpc.trials.errors import ConfigError, LogError
from hystmpc.trials.files import write_atomically
from hystmpc.trials.run_folder import require_vacant

FORMAT = "hystmpc-commissioning/1"
RESULT, BEGUN = "result.json", "begun.json"
NAMES = ("1-range", "2-record", "3-check", "4-fit", "5-diagnose", "6-controller", "7-verify")

Figure = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
"""A number that JSON shows as null where it is none."""

R = TypeVar("R")


@final
@dataclass(frozen=True)
class StageStore:
    """The stages in a folder, each with the fingerprint of all that it depends on.

    Attributes:
        root: of the commissioning.
        mark: fingerprint of settings and results up to here.
        closed: whether a stage without a result is an error, instead of being done.
    """

    root: Path
    mark: str
    closed: bool = False

    def complete(self, name: str, kind: type[R], do: Callable[[Path], R]) -> tuple[R, StageStore]:
        """The result of a stage, kept or done now, and the store for the next stage.

        Args:
            name: of its folder under `root`, such as one of `NAMES`.
            kind: dataclass of the result.
            do: does the stage in its folder; where it raises, the folder keeps what is there.

        Raises:
            ConfigError: if the folder holds the stage of other settings or results.
            LogError: if its result is damaged, or missing from a closed store.
        """
        folder, adapter = self.root / name, TypeAdapter(kind)
        begun = folder / BEGUN
        if begun.exists() and self._begun(begun) != self.mark:
            raise ConfigError(
                f"{folder}: was begun after other results than those that lie before it now, expected the same; "
                "remove this folder and those after it to have them done again"
            )
        if (folder / RESULT).exists():
            result = self._load(folder / RESULT, adapter)
        elif self.closed:
            raise LogError(
                f"{folder}: has no {RESULT}, expected a complete commissioning; the same `hystmpc commission` goes on"
            )
        else:
            write_atomically(begun, json.dumps({"format": FORMAT, "fingerprint": self.mark}) + "\n")
            result = do(folder)
            data = {"format": FORMAT, "stage": name, "result": plain_numbers(adapter.dump_python(result, mode="json"))}
            write_atomically(folder / RESULT, json.dumps(data, indent=1, allow_nan=False) + "\n")
        told = json.dumps(plain_numbers(adapter.dump_python(result, mode="json")), sort_keys=True)
        return result, replace(self, mark=fingerprint([self.mark, name, told]))

    def _begun(self, file: Path) -> str:
        try:
            return str(json.loads(file.read_text(encoding="utf-8"))["fingerprint"])
        except (OSError, ValueError, KeyError, TypeError):
            raise LogError(f"{file}: cannot be read, expected what a stage writes; remove its folder") from None

    def _load(self, file: Path, adapter: TypeAdapter[R]) -> R:
        try:
            data = json.loads(file.read_text(encoding="utf-8"))
            if data["format"] != FORMAT:
                raise ValueError(f"format {data['format']!r}")
            return adapter.validate_python(data["result"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            reason = " ".join(str(error).split())
            raise LogError(f"{file}: not the result of a stage ({reason}); remove its folder to repeat it") from None


def begun_folder(out: Path | str, kind: str, plain: Mapping[str, Any], seed: int) -> Path:
    """The folder of a commissioning or investigation: new, or the one in which the same was begun.

    Args:
        kind: `commissioning` or `investigation`.
        plain: settings.

    Raises:
        ConfigError: if it holds something else, or was begun with other settings.
    """
    plain = {kind: 1, **plain}

    def refusal(earlier: Any) -> str:
        if not isinstance(earlier, Mapping) or kind not in earlier:
            return f"holds another kind of run, expected a new, empty or {kind} folder"
        text = differing(earlier, plain)
        return f"{text}; expected equal settings, or another --out" if text else ""

    folder = Path(out)
    if not (folder / "meta.json").exists():
        require_vacant(folder)
    return resumed_folder(folder, plain, seed, refusal).path


def fingerprint(parts: object) -> str:
    """SHA-256 of plain data."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def differing(before: Any, now: Mapping[str, Any], at: str = "") -> str:
    """The first key whose value differs, with both values; empty where all are equal."""
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


def plain_numbers(value: Any) -> Any:
    """Plain data with null for numbers that are none, as JSON has it."""
    if isinstance(value, dict):
        return {key: plain_numbers(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_numbers(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
