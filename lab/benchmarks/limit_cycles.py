"""Predicted against simulated limit cycles, and delay margins, of PID loops around drawn devices.

    python lab/benchmarks/limit_cycles.py [--seed 1] [--devices 40] [--json FILE] [--rows]

A device is a play or a Prandtl-Ishlinskii sum behind a lag of 0 to 0.2 s and a delay of 0 to 4 samples; a PID, and an
inverse with PID, hold an angle after a square wave of a third of the range on the reading. Most random gains either
rest or saturate. So every second device is drawn until its simulated PID loop ends in an oscillation within the limits;
the prediction has no part in that. It is the harmonic balance of `hystmpc analyse`. The exit code is 1 where a bar is
missed. A seed that was used during a repair proves nothing: draw with another.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from kit import asked, save, show
from numpy.typing import NDArray

from hystmpc.ctrl.build import build_controller
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.config import parse_controller
from hystmpc.ctrl.feedback import PidSettings
from hystmpc.ctrl.linear.limit_cycles import LoopAnalysis, PidLoop
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.linear.harmonic import HarmonicModel
from hystmpc.models.operators.dynamics import Delay, Lag
from hystmpc.models.operators.hysteresis import Backlash
from hystmpc.models.operators.operator import Operator
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.operators.static_curves import Line
from hystmpc.models.prediction.build import controller_model, predictor_for
from hystmpc.models.simulator import ChainModel, Identification, Simulator

Vec = NDArray[np.float64]

CENTRE, KINDS = 3.0, ("pid", "inverse_pid")
AMPLITUDE, FREQUENCY, EXISTENCE, SHARE = 0.15, 0.10, 0.95, 0.90
_SAMPLES, _SCREENED = 6000, 2000
_KICKED, _TURN = 320, 20
_LASTS = 0.85  # share of the earlier amplitude that an oscillation keeps
_LEAST_DEG = 0.02
_DELAYS = 60


@dataclass(frozen=True)
class Drawn:
    """One device and its gains."""

    core: Operator
    lag_s: float
    delay_samples: int
    dt_s: float
    gains: PidSettings

    def simulator(self, more: int = 0) -> Simulator:
        """The device with a longer delay."""
        delay = self.delay_samples + more
        before: list[Operator] = [Delay(delay * self.dt_s, delay)] if delay else []
        before += [Lag(self.lag_s)] if self.lag_s else []
        wide = Range(lower=0.0, upper=6.0)
        return Simulator(
            Chain(self.core, tuple(before)), self.dt_s, "mm", wide, 100.0, wide, Range(lower=0.0, upper=200.0), 100.0,
            Identification(method="drawn"),
        )  # fmt: skip


def drawn(random: np.random.Generator) -> Drawn:
    """Draw a device, the time kp / ki of its PID, and a gain margin on the moving branch of 0.95 to 6."""
    gain, dt = float(np.exp(random.uniform(np.log(3.0), np.log(20.0)))), float(random.choice([0.02, 0.04]))
    if random.uniform() < 0.5:
        half = random.uniform(0.05, 0.5)
        core: Operator = Backlash(gain, gain, 2.0 + half, 2.0 - half)
    else:
        shares = random.dirichlet(np.ones(5))
        core = PrandtlIshlinskii(
            max(gain * shares[0], 1e-3), tuple(gain * shares[1:]), random.uniform(0.03, 0.15), 0.0, 20.0
        )
    lag = random.uniform(0.0, 0.2)
    kp = float(np.exp(random.uniform(np.log(0.005), np.log(0.3))))
    dead = 0.0 if random.uniform() < 0.5 else random.uniform(0.05, 0.3)
    margin = np.exp(random.uniform(np.log(0.95), np.log(6.0)))
    delay = int(random.integers(0, 5))

    def scaled(factor: float) -> Drawn:
        gains = PidSettings(kp_per_deg=factor * kp / gain, ki_per_deg_s=factor / gain, dead_zone_deg=dead)
        return Drawn(core, lag, delay, dt, gains)

    line = Drawn(Line(gain, 0.0), lag, delay, dt, scaled(1.0).gains.model_copy(update={"dead_zone_deg": 0.0}))
    return scaled(1.0 / (loop_of(line).analyse().gain * margin))


LIMITS = CommandLimits(0.0, 6.0, 100.0)


def loop_of(device: Drawn) -> PidLoop:
    """Its loop for the harmonic balance."""
    simulator = device.simulator()
    predictor = predictor_for(ChainModel(simulator, "conditioned"))
    return PidLoop(HarmonicModel(predictor, simulator.chain.operators, CENTRE), device.gains, LIMITS)


def simulated(device: Drawn, kind: str, more: int = 0, samples: int = _SAMPLES) -> tuple[Vec, Vec]:
    """Angles [deg] and commands of a loop that holds an angle, after a square wave either way."""
    simulator = device.simulator(more)
    block = {"estimator": {"outlier_deg": 1e3}} if kind == "inverse_pid" else {}  # the wave counts as measured
    settings = parse_controller({"kind": kind, "gains": device.gains.model_dump(), **block}, "study")
    known = controller_model(ChainModel(device.simulator(), "conditioned"))
    predictor, inverse = known.feedforward
    controller = build_controller(settings, predictor, inverse, LIMITS)
    plant = predictor_for(ChainModel(simulator, "conditioned"))
    low, high = (float(plant.rollout(plant.initial(0.0, u), np.full((1, 300), u))[0, -1]) for u in (0.0, 6.0))
    middle = float(plant.rollout(plant.initial(0.0, CENTRE), np.full((1, 300), CENTRE))[0, -1])
    state, y, memory = plant.initial(middle, CENTRE), middle, controller.init(middle, CENTRE)
    holds, wave = np.full(controller.horizon, middle), (high - low) / 3.0
    angles, commands = np.empty(samples), np.empty(samples)
    for k in range(samples):
        side = 0.0 if k >= _KICKED else 1.0 if (k // _TURN) % 2 else -1.0
        command, memory = controller.step(memory, y + side * wave, holds)
        y, state = plant.advance(state, command.u)
        angles[k], commands[k] = y, command.u
    return angles, commands


@dataclass(frozen=True)
class Seen:
    """What a simulated loop does in the end."""

    lasts: bool
    angle_deg: float
    frequency_hz: float
    saturates: bool


def seen(angles: Vec, commands: Vec, dt_s: float) -> Seen:
    """Measure the last third: half the peak-to-peak angle, and the frequency of upward crossings of the mean."""
    third = angles.size // 3
    earlier, last = angles[third : 2 * third], angles[-third:]
    amplitude, before = 0.5 * float(np.ptp(last)), 0.5 * float(np.ptp(earlier))
    up = np.flatnonzero((last[:-1] < last.mean()) & (last[1:] >= last.mean()))
    lasts = up.size > 2 and amplitude > _LEAST_DEG and amplitude > _LASTS * before
    frequency = (up.size - 1) / ((up[-1] - up[0]) * dt_s) if up.size > 2 else 0.0
    low, high = commands[-third:].min(), commands[-third:].max()
    return Seen(lasts, amplitude, float(frequency), bool(low <= 1e-6 or high >= 6.0 - 1e-6))


@dataclass(frozen=True)
class Row:
    """One loop: prediction, simulation, and both delay margins [samples]."""

    device: int
    core: str
    kind: str
    predicted: str
    doubts: str
    predicted_lasts: bool
    lasts: bool
    saturates: bool
    angle_ratio: float
    frequency_ratio: float
    margin: int
    simulated_margin: int


def chosen(random: np.random.Generator, number: int) -> Drawn:
    """Draw a device; every second one until its simulated PID loop ends in an oscillation within the limits."""
    while True:
        device = drawn(random)
        if number % 2 == 0:
            return device
        found = seen(*simulated(device, "pid", samples=_SCREENED), device.dt_s)
        if found.lasts and not found.saturates:
            return device


def margin_of(device: Drawn, kind: str, guess: int) -> int:
    """Greatest further delay at which the simulated loop does not oscillate; -1 if it does already."""

    def lasts(more: int) -> bool:
        return seen(*simulated(device, kind, more), device.dt_s).lasts

    more = max(guess, 0)
    while more >= 0 and lasts(more):
        more -= 1
    if more < max(guess, 0):
        return more
    while more < _DELAYS and not lasts(more + 1):
        more += 1
    return more


def row_of(number: int, device: Drawn, kind: str, analysis: LoopAnalysis, margin: int) -> Row:
    """Simulate one loop and compare."""
    found, cycle = seen(*simulated(device, kind), device.dt_s), analysis.cycle
    both = found.lasts and cycle is not None
    nan = float("nan")
    return Row(
        number,
        device.core.name,
        kind,
        str(analysis),
        "; ".join(cycle.doubts) if cycle else "grows to the command limits" if analysis.diverges else "",
        analysis.oscillates,
        found.lasts,
        found.saturates,
        cycle.angle_deg / found.angle_deg if both and cycle else nan,
        cycle.frequency_hz / found.frequency_hz if both and cycle and found.frequency_hz else nan,
        margin,
        margin_of(device, kind, margin),
    )


def judge(rows: Sequence[Row]) -> list[tuple[str, float, float, str]]:
    """Each figure, its bar, and of how many loops."""
    existence = [row.predicted_lasts == row.lasts for row in rows]
    pairs = [row for row in rows if np.isfinite(row.angle_ratio)]
    clear = [row for row in pairs if not row.doubts]
    figures = [("existence right", existence, EXISTENCE)]
    for name, chosen in (("of all", pairs), ("without a doubt", clear)):
        amplitude = [abs(row.angle_ratio - 1) <= AMPLITUDE for row in chosen]
        frequency = [abs(row.frequency_ratio - 1) <= FREQUENCY for row in chosen]
        figures += [
            (f"amplitude within 15 %, {name}", amplitude, SHARE),
            (f"frequency within 10 %, {name}", frequency, SHARE),
        ]
    margins = [abs(row.margin - row.simulated_margin) <= 1 for row in rows]
    figures.append(("delay margin within a sample", margins, SHARE))
    return [(name, float(np.mean(right)), bar, f"{sum(right)} of {len(right)}") for name, right, bar in figures]


def main() -> None:
    """Draw, predict, simulate, print; exit 1 where a bar is missed."""
    options = asked(__doc__, seed=1, devices=40, json={"type": Path, "default": None}, rows=(False, "print every loop"))
    random, rows = np.random.default_rng(options.seed), list[Row]()
    for number in range(options.devices):
        device = chosen(random, number)
        loop = loop_of(device)
        analysis, margin = loop.analyse(), loop.delay_margin()
        rows += [row_of(number, device, kind, analysis, _DELAYS if margin is None else margin) for kind in KINDS]
        if options.rows:
            for row in rows[-len(KINDS) :]:
                print(row, flush=True)
    figures = judge(rows)
    show(
        ("figure", "share", "bar", "loops"), [(n, f"{100 * v:.1f} %", f"{100 * b:.0f} %", c) for n, v, b, c in figures]
    )
    save(options.json, {"rows": [asdict(row) for row in rows], "figures": figures})
    sys.exit(any(value < bar for name, value, bar, _ in figures if "of all" not in name))


if __name__ == "__main__":
    main()
