"""The Bouc-Wen benchmark: its records, tests simulated from the published system, the published figures.

Source: Noel and Schoukens, Hysteretic benchmark with a dynamic nonlinearity, Workshop on Nonlinear System
Identification Benchmarks, Brussels (2016); data doi 10.4121/12967592.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import firwin

from hystmpc.models.chain import Chain
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.operators.oscillator import Oscillator
from hystmpc.trials.errors import LogError
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

RATE_HZ = 750.0
PERIOD = 8192
"""Samples of a period of the multisine, at `RATE_HZ`."""

UNITS = Units("N", "m")
COLUMNS = ("force_N", "displacement_m")
# m, c, k, alpha, beta gamma, beta delta; the noise of the training record is 8e-6 m before its low-pass.
PUBLISHED_SYSTEM = (2.0, 10.0, 5e4, 5e4, 1e3 * 0.8, 1e3 * -1.1)
PUBLISHED: tuple[tuple[str, float], ...] = (
    ("structured neural state space", 7.53e-6),
    ("polynomial nonlinear state space (PNLSS)", 1.21e-5),
    ("polynomial state space", 1.34e-5),
    ("Koopman", 1.43e-5),
    ("linear", 1.6e-4),
)
"""RMSE on the official multisine test [m], as their authors print them."""

_FINE = 20  # steps of the simulation a sample: 15 kHz, as the authors had it
_BAND_HZ, _FORCE_N = (5.0, 150.0), 50.0
_SWEEP_HZ, _SWEEP_HZ_PER_S, _SWEEP_N = (20.0, 50.0), 10 / 60, 40.0
_PERIODS = 3


@dataclass(frozen=True, eq=False)
class ScoredRecord:
    """A record of the test.

    Attributes:
        periodic: one period of a steady state: a model runs over it several times, and the last time counts. Else the
            device rests without load at its start.
        simulated: whether it was simulated here.
    """

    name: str
    trial: Trial
    periodic: bool
    simulated: bool


def read_record(path: Path | str) -> Trial:
    """A record of two columns, `force_N` and `displacement_m`, at 750 Hz.

    Raises:
        LogError: if the file is missing, or has other columns or numbers that are not finite.
    """
    file = Path(path)
    if not file.is_file():
        raise LogError(f"{file}: no such file, expected the columns {', '.join(COLUMNS)}")
    with file.open(encoding="utf-8") as lines:
        header = tuple(name.strip() for name in lines.readline().split(","))
        if header != COLUMNS:
            raise LogError(f"{file}: columns {', '.join(header)[:80]!r}, expected {', '.join(COLUMNS)}")
        try:
            values = np.loadtxt(lines, delimiter=",", ndmin=2)
        except ValueError as error:
            raise LogError(f"{file}: {' '.join(str(error).split())}, expected two numbers a row") from None
    if values.shape[1:] != (2,):
        raise LogError(f"{file}: {values.shape[0]} rows, expected two numbers in each")
    return _record(values[:, 0], values[:, 1], str(file))


def noise_of_periods(trial: Trial) -> float:
    """Standard deviation of what differs between the periods of a periodic record behind its first [m].

    Not-a-number of a record of fewer than three periods, or whose force is not periodic.
    """
    count = len(trial) // PERIOD
    forces, found = (signal[: count * PERIOD].reshape(count, PERIOD)[1:] for signal in (trial.command, trial.angle))
    if count < 3 or np.ptp(forces, axis=0).max() > 1e-6 * np.ptp(forces):
        return float("nan")
    return float(np.sqrt(np.mean(np.var(found, axis=0, ddof=1))))


def given_tests(paths: tuple[str, ...]) -> list[ScoredRecord]:
    """Test records from files; one of exactly a period is periodic."""
    trials = [(Path(path).stem, read_record(path)) for path in paths]
    return [ScoredRecord(name, trial, len(trial) == PERIOD, simulated=False) for name, trial in trials]


def simulated_tests(seed: int, quick: bool = False) -> list[ScoredRecord]:
    """A multisine of another realisation, and a sine sweep, answered by the published system as we simulate it.

    Runge-Kutta at 15 kHz, low-pass without delay, every twentieth sample. No noise.
    """
    rng = np.random.default_rng(seed)
    lines = np.arange(*(int(np.ceil(f * PERIOD / RATE_HZ)) for f in _BAND_HZ))
    spectrum = np.zeros(PERIOD * _FINE // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(lines.size))
    force = np.fft.irfft(spectrum)
    force *= _FORCE_N / force.std()
    steady = _answer(np.tile(force, _PERIODS))[-force.size :]
    # A period has a discrete spectrum: what lies above half the sample rate is left out exactly.
    kept = np.fft.rfft(steady)[: PERIOD // 2 + 1] / _FINE
    kept[-1] = 0.0
    multisine = _record(force[::_FINE], np.fft.irfft(kept, PERIOD), "multisine, simulated here")
    seconds = 10.0 if quick else (_SWEEP_HZ[1] - _SWEEP_HZ[0]) / _SWEEP_HZ_PER_S
    t = np.arange(round(seconds * RATE_HZ * _FINE)) / (RATE_HZ * _FINE)
    swept = np.sqrt(2) * _SWEEP_N * np.sin(2 * np.pi * (_SWEEP_HZ[0] * t + 0.5 * _SWEEP_HZ_PER_S * t * t))
    low_pass = np.asarray(firwin(_FINE * _FINE + 1, 0.95 / _FINE), dtype=np.float64)
    filtered = np.convolve(_answer(swept), low_pass, "same")
    sweep = _record(swept[::_FINE], filtered[::_FINE], "sine sweep, simulated here")
    return [ScoredRecord("multisine", multisine, True, True), ScoredRecord("sine sweep", sweep, False, True)]


def _answer(force: Vec) -> Vec:
    """Displacement of the published system, from rest."""
    staged = StagedChain(Chain(Oscillator(*PUBLISHED_SYSTEM, hold=1, steps=1)))
    start = staged.rest(np.zeros(1), np.zeros(1))
    return staged.simulate(force[:, None], 1 / (RATE_HZ * _FINE), start)[0][:, 0]


def _record(force: Vec, displacement: Vec, source: str) -> Trial:
    return Trial(np.arange(force.size) / RATE_HZ, force, displacement, units=UNITS, source=source)
