"""A whole run in this process: latch, contact, order of things, and what is claimed at the end."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from hystmpc.cli.device import _end_of
from hystmpc.ctrl.loop import Plant
from hystmpc.rig.config import BenchSettings
from hystmpc.rig.experiment.experiment import tracking_phase
from hystmpc.rig.experiment.phases import CommandMotion, Decision, Past, Phase, PhaseInput
from hystmpc.rig.loop import RunOutcome
from hystmpc.rig.realtime import Clock, MonotonicClock, SimulatedClock
from hystmpc.rig.run import BenchResult, first_contact, run_bench
from hystmpc.rig.safety.ramp import waypoint_commands
from hystmpc.rig.safety.stop import StopFlag
from hystmpc.rig.transports.simulated import SimulatedSettings
from hystmpc.rig.transports.transport import Reading
from hystmpc.trials.errors import ConfigError

from .bench_parts import RAMPS, FakeClock, ListSink
from .test_processes import RUN, SIMULATED

DT = 0.01
SETTINGS: dict[str, Any] = {
    "name": "test",
    "rate_hz": 1 / DT,
    "command_unit": "mm",
    "limits": {"lower": 0, "upper": 6, "rate_per_s": 10},
    "safe_command": 0,
    "sensor": {"lower_deg": 0, "upper_deg": 120},
    "transport": {"kind": "simulated", "plant": {}},
}


class Straight:
    """A plant whose angle is ten times the command, and a little more each sample."""

    dt = DT

    def __init__(self) -> None:
        self.k = 0

    def reset(self) -> float:
        return 30.0

    def apply(self, u: float) -> float:
        self.k += 1
        return 30.0 + 10.0 * u + 1e-6 * self.k

    def stop(self) -> None:
        pass


def bench(
    folder: Path,
    phases: Sequence[Phase] = (),
    held: float = 0.0,
    sink: Callable[[], ListSink] = ListSink,
    clock: Clock | None = None,
    **more: Any,
) -> BenchResult:
    """A run on the simulated clock where none is given."""
    settings = BenchSettings.parse(SETTINGS | {"latch_file": str(folder / "latched.json")} | more)

    def plants(block: SimulatedSettings, dt_s: float) -> tuple[Plant, float]:
        del block, dt_s
        return Straight(), held

    return run_bench(settings, lambda: phases, sink, plants, folder=folder, clock=clock or SimulatedClock())


def short(to: float = 0.3) -> CommandMotion:
    """A small motion."""
    return CommandMotion("move", lambda held: waypoint_commands(held, [to], [0.05], RAMPS, DT))


def test_the_latch_is_set_before_anything_moves_and_released_at_the_end(tmp_path: Path) -> None:
    """A program that is killed leaves it set."""
    found: list[str] = []

    class Looking(Phase):
        name = "looking"

        def begin(self, now: PhaseInput, past: Past) -> None:
            del now, past

        def step(self, now: PhaseInput) -> Decision:
            found.append(json.loads((tmp_path / "latched.json").read_text())["cause"])
            return Decision(now.held, "looking", finished=True)

    result = bench(tmp_path, [Looking(), short()])
    assert found == ["the program was killed while it controlled the device"]
    assert result.outcome.cause == ""
    assert result.outcome.confirmed
    assert not (tmp_path / "latched.json").exists()


def test_a_stop_stays_latched_until_somebody_resets_it(tmp_path: Path) -> None:
    class Failing(Phase):
        name = "failing"

        def begin(self, now: PhaseInput, past: Past) -> None:
            del now, past

        def step(self, now: PhaseInput) -> Decision:
            return Decision(now.held, "failing", fault="it fails")

    assert bench(tmp_path, [short(), Failing()]).outcome.cause == "it fails"
    with pytest.raises(ConfigError, match="it fails; look at the device"):
        bench(tmp_path, [short()])


def test_a_recording_that_does_not_open_releases_only_its_own_latch(tmp_path: Path) -> None:
    def full() -> ListSink:
        raise ConfigError("no room")

    with pytest.raises(ConfigError, match="no room"):
        bench(tmp_path, sink=full)
    assert not (tmp_path / "latched.json").exists()
    (tmp_path / "latched.json").write_text('{"cause": "yesterday"}')
    with pytest.raises(ConfigError, match="yesterday"):
        bench(tmp_path, sink=full)
    assert json.loads((tmp_path / "latched.json").read_text())["cause"] == "yesterday"


@pytest.mark.parametrize(
    ("more", "held", "expected"),
    [
        ({}, 6.5, "the device holds command 6.5, expected one within 0.0 to 6.0"),
        ({}, -0.5, "the device holds command -0.5, expected one within 0.0 to 6.0"),
        ({"start_command": 1.0}, 2.0, "the device holds command 2, expected start_command 1"),
        ({}, math.nan, "the device does not tell its command, expected the key start_command"),
    ],
)
def test_a_device_that_holds_something_else_is_refused(
    more: dict[str, Any], held: float, expected: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=expected):
        bench(tmp_path, [short()], held=held, **more)
    assert not (tmp_path / "latched.json").exists()


@pytest.mark.slow
def test_a_recording_that_takes_long_to_open_does_not_age_what_the_device_holds(tmp_path: Path) -> None:
    """The first command is measured from what the device holds when the loop begins, not from the first contact."""
    sinks: list[ListSink] = []

    def slow() -> ListSink:
        time.sleep(0.3)
        sinks.append(ListSink())
        return sinks[0]

    assert bench(tmp_path, [short()], held=1.0, sink=slow, clock=MonotonicClock()).outcome.cause == ""
    rows = sinks[0].samples
    assert rows[0].source == "wait"
    first = next(row for row in rows if row.source != "wait")
    assert abs(first.command - 1.0) <= 10 * DT
    assert sinks[0].closed


class Elsewhere:
    """A device that listens to another controller."""

    counters: dict[str, int]

    def __init__(self, clock: FakeClock) -> None:
        self.clock, self.counters, self.k = clock, {}, 0

    def read(self) -> Reading:
        self.k, self.clock.ns = self.k + 1, self.clock.ns + 10_000_000
        return Reading(40.0, self.k, 1, self.clock.ns, self.clock.ns, 0.0, listens=False)

    def write(self, command: float) -> None:
        raise AssertionError(f"it must not be commanded, got {command}")

    def greet(self) -> None:
        pass

    def stop(self, goodbye: bool = False) -> None:
        del goodbye


def test_a_device_that_listens_to_another_controller_is_refused() -> None:
    clock, settings = FakeClock(), BenchSettings.parse(SETTINGS | {"transport": {"kind": "udp"}})
    with pytest.raises(ConfigError, match="the device listens to another controller"):
        first_contact(settings, Elsewhere(clock), clock, StopFlag())


@pytest.mark.parametrize(
    ("safe_s", "confirmed", "expected"),
    [
        (1.5, True, "safe command 0 mm held 0.50 s later"),
        (1.5, False, "safe command 0 mm sent 0.50 s later, the device has not said that it holds it"),
        (math.nan, False, "safe command 0 mm not sent: the device's own watchdog has to act, look at the device"),
    ],
)
def test_no_more_is_claimed_than_the_device_has_said(safe_s: float, confirmed: bool, expected: str) -> None:
    outcome = RunOutcome("SIGTERM", 100, 1.0, safe_s, confirmed, 0, 0, 0, {})
    assert _end_of(BenchSettings.parse(SETTINGS), outcome) == expected


@pytest.mark.parametrize(("bound", "cause"), [(2.0, "implausible: the device is"), (90.0, "")])
def test_a_device_that_leaves_its_model_stops_the_run(bound: float, cause: str, tmp_path: Path) -> None:
    """A sensor that is 10 deg off what the model says, against a bound below it and one above."""
    from hystmpc.bench.device import plants_in
    from hystmpc.rig.config import load_run

    class Off:
        def __init__(self, plant: Plant) -> None:
            self._plant, self.dt, self._k = plant, plant.dt, 0

        def reset(self) -> float:
            return self._plant.reset()

        def apply(self, u: float) -> float:
            self._k += 1
            return self._plant.apply(u) + min(0.2 * self._k, 10.0)

        def stop(self) -> None:
            self._plant.stop()

    (tmp_path / "run.yaml").write_text(SIMULATED + RUN)
    settings = load_run(tmp_path / "run.yaml", [f"plausibility.model_error_deg={bound}"])
    make = plants_in(tmp_path, "mm")

    def plants(block: SimulatedSettings, dt_s: float) -> tuple[Plant, float]:
        plant, held = make(block, dt_s)
        return Off(plant), held

    tracking = tracking_phase(settings, threaded=False)
    result = run_bench(settings, lambda: [tracking], ListSink, plants, clock=SimulatedClock())
    assert result.outcome.cause.startswith(cause)
    assert bool(result.outcome.cause) == bool(cause)
    assert result.outcome.confirmed
