"""Bouc-Wen benchmark: its records, tests simulated from the published system, the published figures.

Source: Noel and Schoukens, Hysteretic benchmark with a dynamic nonlinearity, Workshop on Nonlinear System
Identification Benchmarks, Brussels (2016); data doi 10.4121/12967592.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import final

import numpy as np
from scipy.signal import firwin

from hystmpc.models.chain import Chain
from hystmpc.models.identify.free_run import StagedChain
from hystmpc.models.operators.oscillator import Oscillator
from hystmpc.trials.errors import LogError
from hystmpc.trials.layouts import LOG_TIME
from hystmpc.trials.mat_ import open_mat
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

from .records import Case, PublicData, PublicSettings, Published, ScoredRecord

RATE_HZ = 750.0
PERIOD = 8192
"""Samples of a period of the multisine, at `RATE_HZ`."""

UNITS = Units("N", "m")
COLUMNS = ("force_N", "displacement_m")
# m, c, k, alpha, beta gamma, beta delta; the noise of the training record is 8e-6 m before its low-pass.
PUBLISHED_SYSTEM = (2.0, 10.0, 5e4, 5e4, 1e3 * 0.8, 1e3 * -1.1)
PUBLISHED = tuple(
    Published(model, "multisine, official", rmse)
    for model, rmse in (
        ("structured neural state space", 7.53e-6),
        ("polynomial nonlinear state space (PNLSS)", 1.21e-5),
        ("polynomial state space", 1.34e-5),
        ("Koopman", 1.43e-5),
        ("linear", 1.6e-4),
    )
)
"""RMSE on the official multisine test [m], as their authors print them."""

_FINE = 20  # steps of the simulation a sample: 15 kHz, as the authors had it
_BAND_HZ, _FORCE_N = (5.0, 150.0), 50.0
_SWEEP_HZ, _SWEEP_HZ_PER_S, _SWEEP_N = (20.0, 50.0), 10 / 60, 40.0
_PERIODS = 3


@final
class BoucWenData(PublicData):
    """Benchmark data: one training record, official test records if given, and tests simulated here."""

    title = "A public benchmark: Bouc-Wen"
    about = """The Bouc-Wen benchmark: a force in N moves a mass on a spring with a hysteretic force behind it. Its
displacement in m is to be predicted from the force alone. Models are identified from the training record and run
freely over the test, from rest; over one period of a steady state they run three times, and the third counts. RMSE is
over all samples. Tests that are simulated here are the published system (Runge-Kutta at 15 kHz, no noise): a
multisine of another realisation and a sine sweep."""
    units = UNITS
    published = PUBLISHED
    note = (
        "The published figures are of the official multisine. An error on a test simulated here is no official score."
    )

    def files(self, settings: PublicSettings) -> tuple[Path, ...]:
        return (Path(settings.data), *map(Path, settings.test))

    def cases(self, settings: PublicSettings) -> Sequence[Case]:
        training = read_record(settings.data)
        noise = noise_of_periods(training)
        known = "unknown" if np.isnan(noise) else f"{noise:.3g} m, from what differs between its periods"
        tests = [*given_tests(settings.test), *simulated_tests(settings.seed, settings.quick)]
        return [Case("", [training], tests, {"noise of the training record": known})]


def read_record(path: Path | str) -> Trial:
    """Read a record of two columns, `force_N` and `displacement_m`, at 750 Hz.

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
    """Standard deviation of the difference between the periods of a periodic record after its first [m].

    Not-a-number of a record of fewer than three periods, or whose force is not periodic.
    """
    count = len(trial) // PERIOD
    forces, found = (signal[: count * PERIOD].reshape(count, PERIOD)[1:] for signal in (trial.command, trial.angle))
    if count < 3 or np.ptp(forces, axis=0).max() > 1e-6 * np.ptp(forces):
        return float("nan")
    return float(np.sqrt(np.mean(np.var(found, axis=0, ddof=1))))


def given_tests(paths: tuple[str, ...]) -> list[ScoredRecord]:
    """Read test records from files; one of exactly a period is periodic.

    Of MATLAB files together every pair `uval_NAME` and `yval_NAME` is a record: the official ones hold a signal a file.

    Raises:
        LogError: if a file cannot be used, or a signal is without its partner.
    """
    tables = [path for path in paths if Path(path).suffix.lower() != ".mat"]
    found = [(Path(path).stem, read_record(path)) for path in tables]
    signals: dict[str, tuple[str, Vec]] = {}
    for path in sorted(set(paths) - set(tables)):
        log = open_mat(path)
        own = [name for name in log.names() if name[:5] in ("uval_", "yval_")]
        if not own:
            raise LogError(f"{path}: no variable uval_... or yval_..., available: {', '.join(log.names()) or 'none'}")
        signals |= {name: (path, log.series([name], LOG_TIME)[0].values) for name in own}
    for record in sorted({name[5:] for name in signals}):
        pair = [signals.get(f"{letter}val_{record}") for letter in "uy"]
        (path, force), (_, displacement) = (one or _alone(record, signals) for one in pair)
        found.append((record, _record(force, displacement, path)))
    return [ScoredRecord(f"{name}, given", trial, 0.0, periodic=len(trial) == PERIOD) for name, trial in found]


def _alone(record: str, signals: Mapping[str, tuple[str, Vec]]) -> tuple[str, Vec]:
    name = next(name for name in signals if name[5:] == record)
    other = f"{'y' if name.startswith('u') else 'u'}val_{record}"
    raise LogError(
        f"{signals[name][0]}: {name} without {other}, expected both; name the file that holds it with --test"
    )


def simulated_tests(seed: int, quick: bool = False) -> list[ScoredRecord]:
    """Response of the published system, simulated here, to another multisine realisation and a sine sweep.

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
    return [
        ScoredRecord("multisine, simulated", multisine, 0.0, periodic=True, simulated=True),
        ScoredRecord("sine sweep, simulated", sweep, 0.0, simulated=True),
    ]


def _answer(force: Vec) -> Vec:
    """Displacement of the published system, from rest."""
    staged = StagedChain(Chain(Oscillator(*PUBLISHED_SYSTEM, hold=1, steps=1)))
    start = staged.rest(np.zeros(1), np.zeros(1))
    return staged.simulate(force[:, None], 1 / (RATE_HZ * _FINE), start)[0][:, 0]


def _record(force: Vec, displacement: Vec, source: str) -> Trial:
    return Trial(np.arange(force.size) / RATE_HZ, force, displacement, units=UNITS, source=source)
