"""Contract tests of the control loop with a transport that raises, hangs or returns invalid readings.

Limits, ramps, stop and latch belong to the loop and do not depend on the transport. If the connection is lost, the run
ends and reports that the safe command was not sent; the device's watchdog has to act.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import NoReturn, final

from hystmpc.rig.config import BenchSettings
from hystmpc.rig.experiment.phases import CommandMotion
from hystmpc.rig.recording.sample import Sample
from hystmpc.rig.run import BenchResult, run_bench
from hystmpc.rig.safety.ramp import waypoint_commands
from hystmpc.rig.transports.transport import Reading, Transport
from hystmpc.trials.types import Vec

from .wire import Connected, Wired, require

_UPPER, _RATE, _RATE_HZ, _SILENCE_S = 6.0, 10.0, 50.0, 0.3
_AWAY = 1.0  # command to which the tests move, far from the safe one


@final
@dataclass
class _Dropped:
    """Recorder that counts samples and stores none."""

    samples: int = 0

    def put(self, sample: Sample) -> None:
        del sample
        self.samples += 1

    def close(self) -> None:
        """Close nothing: no file is open."""


@final
@dataclass
class _Failing(Transport):
    """Transport that fails once a command has come near the target of the run."""

    inner: Transport
    reads: Callable[[Reading | None], object] = lambda reading: reading
    writes: Callable[[], object] = lambda: None
    wrote: list[float] = field(default_factory=list)

    @property
    def counters(self) -> Mapping[str, int]:
        return self.inner.counters

    @property
    def fails(self) -> bool:
        """Whether the failure has begun."""
        return max(self.wrote, default=0.0) > 0.8 * _AWAY

    def read(self) -> Reading | None:
        reading = self.inner.read()
        return self.reads(reading) if self.fails else reading  # type: ignore[return-value]  # invalid on purpose

    def write(self, command: float) -> None:
        if self.fails:
            self.writes()
        self.inner.write(command)
        self.wrote.append(command)

    def greet(self) -> None:
        self.inner.greet()

    def stop(self, goodbye: bool = False) -> None:
        self.inner.stop(goodbye)


class LoopContract(Wired):
    """Contract tests of short runs over a transport in degrees and command units, on a device that follows at once."""

    def test_a_run_ends_at_the_safe_command(self) -> None:
        """An undisturbed run ends at the safe command."""
        with self.connected() as c:
            outcome = self._run(c, c.transport, silence_s=1.0).outcome
            got = list(c.heard())
            require(outcome.cause == "", f"stopped: {outcome.cause}; {outcome.faults}")
            require(self.near(max(got), _AWAY), f"the run leads to {_AWAY}, the device got at most {max(got)}")
            self._is_safe(got)

    def test_a_read_that_raises_ends_in_a_stop(self) -> None:
        """An exception of a driver stops the run."""
        self._stops(True, reads=_raise(RuntimeError("a driver's own")))

    def test_a_read_that_ends_the_program_ends_in_a_stop(self) -> None:
        """A driver that calls `sys.exit` stops the run and does not end the program."""
        self._stops(True, reads=_raise(SystemExit(1)))

    def test_a_read_that_returns_nonsense_ends_in_a_stop(self) -> None:
        """A reading of a wrong type stops the run."""
        self._stops(True, reads=lambda reading: "30.0")

    def test_a_reading_without_numbers_ends_in_a_stop(self) -> None:
        """Text in place of the angle stops the run."""

        def spoilt(reading: Reading | None) -> Reading | None:
            return reading and replace(reading, angle_deg="30.0", held=None)  # type: ignore[arg-type]  # invalid on purpose

        self._stops(True, reads=spoilt)

    def test_a_reading_from_the_future_ends_in_a_stop(self) -> None:
        """A time stamp in the future stops the run: with it stale angles would pass as fresh."""

        def ahead(reading: Reading | None) -> Reading | None:
            return reading and replace(reading, received_ns=reading.received_ns + 10**15)

        self._stops(True, reads=ahead)

    def test_a_read_that_repeats_itself_ends_in_a_stop(self) -> None:
        """A measurement that is repeated for ever stops the run."""
        kept: list[Reading] = []

        def same(reading: Reading | None) -> Reading | None:
            kept.extend([reading] if reading else [])
            return kept[0] if kept else None

        self._stops(True, reads=same)

    def test_a_write_that_raises_ends_the_run(self) -> None:
        """A run ends if no command can be sent."""
        self._stops(False, writes=_raise(RuntimeError("a driver's own")))

    def test_a_read_that_hangs_ends_the_run(self) -> None:
        """A run ends if reading blocks for ever."""
        self._stops(False, hangs="reads")

    def test_a_write_that_hangs_ends_the_run(self) -> None:
        """A run ends if writing blocks for ever."""
        self._stops(False, hangs="writes")

    def _stops(self, reached: bool, hangs: str = "", **how: Callable[..., object]) -> None:
        """Run the loop over a failing transport; it has to stop and to report the sent commands correctly."""
        with self.connected() as c, TemporaryDirectory() as folder, _hanging() as hang:
            how |= {hangs: hang} if hangs else {}
            transport = _Failing(c.transport, **how)  # type: ignore[arg-type]  # names of its fields
            outcome = self._run(c, transport, _SILENCE_S, Path(folder)).outcome
            latched = json.loads((Path(folder) / "latch.json").read_text())["cause"]
            got = list(c.heard())
        require(transport.fails, "the run ended before the transport failed")
        require(outcome.cause != "", "the run has to be stopped")
        require(latched == outcome.cause, f"latched {latched!r}, stopped for {outcome.cause!r}")
        require(math.isfinite(outcome.safe_s) == reached, f"safe command at {outcome.safe_s}, {outcome.cause}")
        self._is_within(got)
        if reached:
            self._is_safe(got)
        else:
            require(not outcome.confirmed, "nobody can know that the device holds the safe command")

    def _is_within(self, got: list[float]) -> None:
        slack = 2 * self.resolution
        require(min(got) >= -slack and max(got) <= _UPPER + slack, f"beyond the limits: {min(got)} to {max(got)}")
        step = max(abs(b - a) for a, b in pairwise([0.0, *got]))
        require(step <= _RATE / _RATE_HZ + slack, f"a step of {step}, at most {_RATE / _RATE_HZ} in a sample")

    def _is_safe(self, got: list[float]) -> None:
        self._is_within(got)
        require(self.near(got[-1], 0.0), f"the last command has to be the safe one, 0; the device got {got[-1]}")

    def _run(self, c: Connected, transport: Transport, silence_s: float, folder: Path | None = None) -> BenchResult:
        with TemporaryDirectory() as spare:
            settings = BenchSettings.parse(
                {
                    "name": "contract",
                    "rate_hz": _RATE_HZ,
                    "command_unit": "mm",
                    "limits": {"lower": 0, "upper": _UPPER, "rate_per_s": _RATE},
                    "ramps": {"velocity_per_s": 5, "acceleration_per_s2": 50, "jerk_per_s3": 1000},
                    "start_command": 0,
                    "safe_command": 0,
                    "sensor": {
                        "lower_deg": 0,
                        "upper_deg": 120,
                        "age_limit_s": silence_s,
                        "dead_after_s": silence_s,
                        "frozen_samples": None,
                    },
                    "transport": {"python": "contract:Given"},
                    "latch_file": str((folder or Path(spare)) / "latch.json"),
                }
            )

            def work() -> list[CommandMotion]:
                def way(held: float) -> Vec:
                    return waypoint_commands(held, [_AWAY], [0.3], settings.ramps, settings.dt_s)

                return [CommandMotion("away", way)]

            with _following(c):
                return run_bench(settings, work, _Dropped, _no_plants, transport=transport)


@contextmanager
def _following(c: Connected) -> Iterator[None]:
    """Context with a simulated device, 100 samples per second, that holds the last command and follows at once."""
    over = Event()

    def go() -> None:
        while not over.wait(0.01):
            held = (list(c.heard()) or [0.0])[-1]
            c.tell(30.0 + 10.0 * held, held)

    thread = Thread(target=go, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def _hanging() -> Iterator[Callable[..., None]]:
    over = Event()

    def hang(*reading: object) -> None:
        del reading
        over.wait()

    try:
        yield hang
    finally:
        over.set()
        time.sleep(0.01)


def _raise(error: BaseException) -> Callable[..., object]:
    def fail(*reading: object) -> object:
        del reading
        raise error

    return fail


def _no_plants(block: object, dt_s: float) -> NoReturn:
    del block, dt_s
    raise AssertionError("a transport from outside computes no device")
