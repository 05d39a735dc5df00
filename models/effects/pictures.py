"""Figures and a page of the effects: hysteresis loop and hold of a plain device with each effect."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.trials.report import (
    MEASURED,
    MODEL,
    REFERENCE,
    Heading,
    KeyValues,
    Paragraph,
    Piece,
    Plot,
    Report,
    Table,
    new_figure,
    style,
)
from hystmpc.trials.types import Vec

from ..chain import Chain
from ..operators.prandtl_ishlinskii import PrandtlIshlinskii
from .catalogue import EFFECTS
from .effect import Effect, unit_on
from .place import PlacedEffect, effect_from, parameters_of, sides_text, with_effect

DT_S = 0.02
REST = 22.0
DEVICE = Chain(PrandtlIshlinskii(3.0, (2.5, 2.0, 1.5, 1.2), 0.15, 0.0, REST))
"""A tendon catheter: 0 to 6 mm, 22 to 80 deg, four plays."""


@dataclass(frozen=True)
class _ShownCommands:
    """Commands [cmd] over time [s]."""

    time_s: Vec
    command: Vec


def effect_figure(name: str) -> Figure:
    """Figure of loop and hold, for the plain device and for the device with the effect.

    Raises:
        ModelError: on an unknown effect.
    """
    loop, hold = _loop(), _hold()
    with new_figure(7.0, 2.9) as figure:
        left, right = figure.subplots(1, 2)
        plain = _plain()
        left.plot(loop.command, plain[0], color=REFERENCE, linewidth=0.9, label="plain")
        right.plot(hold.time_s, plain[1], color=REFERENCE, linewidth=0.9)
        for k in range(len(EFFECTS[name].shown)):
            _with_effect(left, right, name, k)
        left.set(xlabel="command [mm]", ylabel="angle [deg]", title="loop")
        right.set(xlabel="time [s]", ylabel="angle [deg]", title="hold")
        left.legend(loc="upper left")
    return figure


def run(chain: Chain, commands: Vec, dt_s: float = DT_S) -> Vec:
    """Angles (T,) [deg] of a free run over commands (T,) from rest at the first command and an angle of 22 deg."""
    x, u = ca.SX.sym("x", chain.state_size), ca.SX.sym("u")
    theta, following = chain.bound(dt_s)(x, u)
    step = ca.Function("step", [x, u], [following, theta])
    rest = chain.rest(REST, float(commands[0]), chain.values)
    _, angles = step.mapaccum(commands.size)(rest, commands[None])
    return np.asarray(angles).ravel()


def effects_report(figures: Mapping[str, Figure]) -> Report:
    """Page of the effects that have a figure: equation, parameters, figure."""
    pieces: list[Piece] = [
        Paragraph(
            "A simulator is a chain: effects on the command, a hysteresis core, effects on the output. Grey: the plain "
            "device, a Prandtl-Ishlinskii model of a tendon catheter; coloured: with the effect on its first side."
        )
    ]
    for name, figure in figures.items():
        effect = EFFECTS[name]
        pieces += [
            Heading(name),
            KeyValues({"equation": effect.equation, "sides": sides_text(effect), "what separates it": effect.apart}),
            Table(("parameter", "unit", "lowest", "highest", "neutral", "meaning"), parameter_rows(effect)),
            Plot(figure, _caption(name)),
        ]
    return Report("Effects", tuple(pieces), "what a device does beyond its simulator")


def write_pictures(folder: Path) -> Path:
    """Write a PNG of every effect and the page `effects.html` into a folder, and return the path of the page."""
    folder.mkdir(parents=True, exist_ok=True)
    figures = {name: effect_figure(name) for name in EFFECTS}
    for name, figure in figures.items():
        with style():
            figure.savefig(folder / f"{name}.png", dpi=120, metadata={"Software": None})
    return effects_report(figures).save(folder / "effects.html")


def parameter_rows(effect: Effect) -> list[tuple[object, ...]]:
    """Name, unit, bounds, neutral value and meaning of every parameter on the effect's first side."""
    side = effect.sides[0]
    return [
        (p.name, unit_on(p.unit, side), p.lower, p.upper, effect.neutral.get(p.name, "any"), p.meaning)
        for p in parameters_of(effect)
    ]


def shown_effect(name: str, k: int = 0) -> PlacedEffect:
    """Effect with the parameter values of the figures."""
    return effect_from({"effect": name, "parameters": dict(EFFECTS[name].shown[k])}, DT_S)


def _with_effect(left: Axes, right: Axes, name: str, k: int) -> None:
    loop, hold, placed = _loop(), _hold(), shown_effect(name, k)
    chain = with_effect(DEVICE, placed.operator, placed.side)
    colour = (MODEL, MEASURED)[k % 2]
    label = f"with {name}" if len(EFFECTS[name].shown) == 1 else f"trial {k + 1}"
    left.plot(loop.command, run(chain, loop.command), color=colour, label=label, linewidth=1.1)
    right.plot(hold.time_s, run(chain, hold.command), color=colour, linewidth=1.1)


def _caption(name: str) -> str:
    placed = shown_effect(name)
    numbers = ", ".join(
        f"{p.name} {value:g} {unit_on(p.unit, placed.side)}".removesuffix(" 1")
        for p, value in zip(placed.operator.parameters, placed.operator.values, strict=True)
    )
    return f"On the {placed.side} side: {numbers}."


@cache
def _plain() -> tuple[Vec, Vec]:
    return run(DEVICE, _loop().command), run(DEVICE, _hold().command)


def _loop() -> _ShownCommands:
    """Commands from rest twice through 0 to 6 mm, then 1.5 to 4.5 mm and back, all at up to 4.7 mm/s."""
    t = np.arange(0.0, 8.0, DT_S)
    whole = 3.0 - 3.0 * np.cos(2 * np.pi * 0.25 * t)
    part = np.concatenate([np.linspace(0, 4.5, 75), np.linspace(4.5, 1.5, 50), np.linspace(1.5, 4.5, 50)])
    command = np.concatenate([whole, part])
    return _ShownCommands(DT_S * np.arange(command.size, dtype=np.float64), command)


def _hold() -> _ShownCommands:
    """Commands up to 5 mm in 1.5 s and held for 5 s, down to 2 mm and held for 5 s."""
    ways = ((0.0, 5.0, 1.5), (5.0, 5.0, 5.0), (5.0, 2.0, 1.0), (2.0, 2.0, 5.0))
    command = np.concatenate([np.linspace(a, b, round(s / DT_S), endpoint=False) for a, b, s in ways])
    return _ShownCommands(DT_S * np.arange(command.size, dtype=np.float64), command)
