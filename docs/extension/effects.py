"""The library of effects: equation, parameters and picture of each, from the catalogue."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hystmpc.models.effects.catalogue import EFFECTS
from hystmpc.models.effects.pictures import effect_figure, parameter_rows
from hystmpc.models.effects.place import sides_text
from hystmpc.trials.report import style

from .tables import anchor, sentence, table

FOLDER = Path(__file__).resolve().parents[1] / "reference" / "drawn"


def text() -> str:
    """A section for each effect."""
    parts = []
    for effect in EFFECTS.values():
        rows = [[f"`{name}`", *numbers, sentence(str(meaning))] for name, *numbers, meaning in parameter_rows(effect)]
        parts += [
            anchor(f"effect-{effect.name}"),
            f"### `{effect.name}`",
            f"```text\n{effect.equation}\n```",
            f"Sides: {sides_text(effect)}. What separates it from others: {effect.apart.rstrip('.')}.",
            table(("parameter", "unit", "lowest", "highest", "neutral", "meaning"), rows),
            f"![Loop and hold of a plain device (grey) and with {effect.name}](drawn/{effect.name}.svg)",
        ]
    return "\n\n".join(parts)


def draw(_app: Any) -> None:
    """Draw every effect that is not drawn yet, or was drawn before the equations last changed."""
    FOLDER.mkdir(exist_ok=True)
    newest = max(path.stat().st_mtime for path in (Path(__file__).parents[2] / "models").rglob("*.py"))
    for name in EFFECTS:
        file = FOLDER / f"{name}.svg"
        if not file.exists() or file.stat().st_mtime < newest:
            with style():
                effect_figure(name).savefig(file, metadata={"Date": None})
