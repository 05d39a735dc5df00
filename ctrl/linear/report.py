"""Analysis of a set of controllers: table, Bode and Nyquist figures, page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hystmpc.models.model import LoadedModel
from hystmpc.trials.brief import in_brief
from hystmpc.trials.report import (
    DASHES,
    PALETTE,
    REFERENCE,
    Heading,
    KeyValues,
    Paragraph,
    Piece,
    Plot,
    Points,
    Report,
    Table,
    new_figure,
)
from hystmpc.trials.types import Vec

from ..command import CommandLimits
from ..config import AnyControllerSettings
from .analysis import ControllerAnalysis, DeviceModel, analyse_controllers, delay_of

COLUMNS = (
    "controller",
    "gain margin",
    "phase [deg]",
    "disk margin",
    "peak Ms",
    "delay survived [samples]",
    "lag to Ms 2 [s]",
    "cycle [deg]",
    "cycle [Hz]",
    "in a hold",
)
TOLERANCE_DEG = 0.5
"""Oscillation that a hold may have, where nothing else is given: the tolerance of a tip's target [deg]."""

_POINTS, _SHOWN = 600, 3.0  # of a curve; half the side of a Nyquist plot
_AMPLITUDES = 80


@dataclass(frozen=True, eq=False)
class LoopsAnalysis:
    """Analysis of the controllers of a configuration before the device moves.

    Attributes:
        source: of the model.
        unit: of the command.
        device: the model at its operating point.
        controllers: what each will do.
    """

    source: str
    unit: str
    device: DeviceModel
    controllers: tuple[ControllerAnalysis, ...]

    def __repr__(self) -> str:
        return in_brief(self, "; ".join(f"{one.name}: {one.rest}" for one in self.controllers))

    def rows(self) -> list[tuple[object, ...]]:
        """One row for each controller, by `COLUMNS`; the delay is that with the hysteresis where it is known."""
        return [_row(one) for one in self.controllers]

    def summary(self) -> tuple[Piece, ...]:
        """Table with a warning and notes, for a page on something else; nothing without controllers."""
        return tuple(_summary(self)) if self.controllers else ()

    def report(self) -> Report:
        """Page with table, notes and figures."""
        pieces = (Heading("What the loops will do"), *self.summary(), *_figures(self))
        return Report("Analysis of the loops", pieces, f"model {self.source}")

    def plot(self) -> Figure:
        """Nyquist curve of every loop that is analysed, with -1/DF where it has a PID."""
        return nyquist_figure([one for one in self.controllers if one.margins is not None])


def loops_of(
    model: LoadedModel,
    source: str,
    controllers: Mapping[str, AnyControllerSettings],
    limits: CommandLimits,
    lag_s: float = 0.0,
    *,
    command: float | None = None,
    tolerance_deg: float = TOLERANCE_DEG,
) -> LoopsAnalysis:
    """Analyse controllers around one model; the further delay is the longest that one of them is given.

    Args:
        model: opened conditioned.
        source: of the model, for the page.
        controllers: settings by name.
        limits: of the command.
        lag_s: lag of the command that the model does not contain [s].
        command: operating point; the middle of the limits where left out.
        tolerance_deg: oscillation that a hold may have [deg].

    Raises:
        ControllerError: if the operating point is not within the limits.
    """
    delay = max((delay_of(settings) for settings in controllers.values()), default=0)
    middle = 0.5 * (limits.lower + limits.upper) if command is None else command
    device = DeviceModel(model, lag_s, delay, middle)
    done = analyse_controllers(device, limits, list(controllers.items()), tolerance_deg)
    return LoopsAnalysis(source, model.metadata.command_unit, device, done)


def _row(one: ControllerAnalysis) -> tuple[object, ...]:
    m, cycle = one.margins, one.cycle
    if m is None:
        return (one.name, *("-",) * (len(COLUMNS) - 2), "; ".join(one.notes))
    survived = "over 200" if one.delay_samples is None else "none" if one.delay_samples < 0 else one.delay_samples
    sizes = ("-", "-") if cycle is None else (cycle.angle_deg, cycle.frequency_hz)
    lag = "over 20" if math.isinf(m.lag_s) else m.lag_s
    return one.name, m.gain, m.phase_deg, m.disk, m.sensitivity, survived, lag, *sizes, one.rest


def _summary(analysis: LoopsAnalysis) -> Iterator[Piece]:
    device, shown = analysis.device, [one for one in analysis.controllers if one.margins is not None]
    too_great = [one.name for one in shown if one.too_great]
    if too_great:
        yield Paragraph(
            f"Do not run {', '.join(too_great)} with these settings: the predicted oscillation exceeds the "
            f"{shown[0].tolerance_deg:g} deg of a hold, or the loop is unstable."
        )
    marked = {(i, len(COLUMNS) - 1) for i, one in enumerate(analysis.controllers) if one.too_great}
    caption = (
        "Margins of the linearised loop where all plays move: its highest gain. Delay survived: with the describing "
        "function of the hysteresis for a PID, of the linear loop for a plan. Cycle: half the peak-to-peak angle of "
        "the stable limit cycle. Bold: greater than a hold may be."
    )
    yield Table(COLUMNS, analysis.rows(), caption, marked)
    notes = [f"{one.name}: {note}" for one in analysis.controllers for note in one.notes]
    if notes:
        yield Points(tuple(notes))
    yield KeyValues(
        {
            "operating point": f"{device.command:.4g} {analysis.unit}, reached from below",
            "lag that the model does not contain": f"{device.lag_s:g} s",
            "delay that it does not contain": f"{device.delay_samples} samples",
            "sample time": f"{device.model.dt:g} s",
        }
    )


def _figures(analysis: LoopsAnalysis) -> Iterator[Piece]:
    device, shown = analysis.device, [one for one in analysis.controllers if one.margins is not None]
    if shown:
        yield Heading("Frequency responses")
        yield Plot(bode_figure(device, shown), "Device, linearised, and loops; dotted: gain 1 and -180 degrees.")
        words = "Nyquist curves of the loops; cross: -1. Dashed: -1/N(A) of the hysteresis, scaled as the caption says"
        yield Plot(nyquist_figure(shown), f"{words}: N over its greatest value. A crossing is a limit cycle.")


def _frequencies(dt_s: float) -> Vec:
    return np.asarray(np.geomspace(2e-3 / dt_s, math.pi / dt_s, _POINTS))


def bode_figure(device: DeviceModel, shown: Sequence[ControllerAnalysis]) -> Figure:
    """Magnitude and phase of the linearised device and of every loop."""
    dt = device.model.dt
    omega = _frequencies(dt)
    curves: list[tuple[str, Any, str]] = [("device [deg/command]", device.linear, REFERENCE)]
    curves += [(one.name, one.loop, _colour(k)) for k, one in enumerate(shown)]
    with new_figure(7.0, 4.6) as figure:
        gains, phases = figure.subplots(2, 1, sharex=True)
        lowest = -190.0
        for k, (label, system, colour) in enumerate(curves):
            response, dashes = system(np.exp(1j * omega * dt)), DASHES[k % len(DASHES)]
            hertz, phase = omega / (2.0 * math.pi), np.degrees(np.unwrap(np.angle(response)))
            gains.plot(hertz, np.abs(response), color=colour, linestyle=dashes, label=label)
            phases.plot(hertz, phase, color=colour, linestyle=dashes)
            lowest = max(min(lowest, float(phase.min()) - 10.0), -720.0)
        gains.axhline(1.0, color=REFERENCE, linewidth=0.8, linestyle=":")
        phases.axhline(-180.0, color=REFERENCE, linewidth=0.8, linestyle=":")
        gains.set(xscale="log", yscale="log", ylabel="gain")
        phases.set(xscale="log", ylabel="phase [deg]", xlabel="frequency [Hz]", ylim=(lowest, 30.0))
        gains.legend(loc="best")
    return figure


def nyquist_figure(shown: Sequence[ControllerAnalysis]) -> Figure:
    """Nyquist curve of each loop, and -1/N(A) of the hysteresis of a PID, N relative to its greatest value."""
    with new_figure(7.0, 0.6 + 3.2 * -(-len(shown) // 2)) as figure:
        axes: list[Axes] = list(figure.subplots(-(-len(shown) // 2), 2, squeeze=False).ravel())
        for k, (one, axis) in enumerate(zip(shown, axes, strict=False)):
            dt = float(one.loop.dt)
            response = one.loop(np.exp(1j * _frequencies(dt) * dt))
            axis.plot(response.real, response.imag, color=_colour(k))
            if one.pid is not None:
                curve = _describing_curve(one)
                axis.plot(curve.real, curve.imag, color=REFERENCE, linestyle="--", linewidth=1.0)
            axis.plot(-1.0, 0.0, marker="+", color=REFERENCE, markersize=9)
            axis.set(title=one.name, xlim=(-_SHOWN, 1.0), ylim=(-_SHOWN, 1.0), xlabel="real", ylabel="imaginary")
        for axis in axes[len(shown) :]:
            axis.set_visible(False)
    return figure


def _describing_curve(one: ControllerAnalysis) -> Any:
    """-N_greatest / N(A) (A,) at the frequency of the limit cycle, or where the loop gain is 1."""
    assert one.pid is not None
    assert one.margins is not None
    model = one.pid.model
    hertz = one.cycle.frequency_hz if one.cycle else one.margins.crossover_hz
    wanted = 2.0 * math.pi * (hertz if math.isfinite(hertz) and hertz > 0 else 1.0)
    k = int(np.argmin(np.abs(np.log(model.frequencies / wanted))))
    amplitudes = one.pid.reach * np.geomspace(4e-3, 1.0, _AMPLITUDES)
    values = model.response(amplitudes)[k]
    values = values[np.abs(values) > 1e-3 * np.abs(values).max()]
    return -np.abs(values[-1]) * np.exp(1j * np.angle(values[-1])) / values


def _colour(k: int) -> str:
    return PALETTE[k % (len(PALETTE) - 1)]
