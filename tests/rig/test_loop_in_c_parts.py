"""The loop in C alone, over a pair of sockets, with a controller that does as it is told: time, age, rate and lag."""

from __future__ import annotations

import ctypes
import math
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hystmpc.core.structs import constants, layout, struct
from hystmpc.ctrl.command import CommandLimits
from hystmpc.ctrl.estimation.observer import Observer
from hystmpc.ctrl.guarded import GuardedController
from hystmpc.ctrl.planner.settings import TipSettings, assemble
from hystmpc.rig.compiled.loop import CompiledLoop, available
from hystmpc.rig.experiment.experiment import LATE
from hystmpc.rig.transports.udp import Datagram, Kind, decode, encode
from hystmpc.trials.types import Vec

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not available(), reason="a system without sockets of POSIX"),
]

NS, DT_S, SESSION = 1_000_000_000, 0.01, 7
HURRIED = constants()["HYSTMPC_NO_TIME"]
REFERENCE: Vec = 45.0 + 12.0 * np.sin(0.15 * np.arange(constants()["HYSTMPC_REFERENCES"]))


@dataclass
class Law:
    """A law that does as it is told, without a model: its command, and a step that takes so long, once."""

    u: float = 1.0
    at: int = -1
    sleeps_s: float = 0.0
    steps: int = 0

    def __call__(self, given: int, proposal: int) -> int:
        del given
        if self.steps == self.at:
            time.sleep(self.sleeps_s)
        self.steps += 1
        layout("hystmpc_proposal").from_address(proposal).u = self.u
        return 0


def controller_of(law: Law) -> GuardedController:
    """A controller around it that limits nothing and never stops."""
    codes = constants()
    observer = Observer(struct("hystmpc_sensing", sensor=codes["HYSTMPC_NEWEST"], forgets=1.0))
    problem = struct(
        "hystmpc_problem",
        dt_s=DT_S,
        lower=0.0,
        upper=6.0,
        reach=10.0,
        safe=math.nan,
        stop_after=1000,
        most_missing=1000,
        sensing=observer.part,
        law=struct("hystmpc_control_law", kind=codes["HYSTMPC_PROPOSED"], horizon=3, propose=law),
    )
    return GuardedController(problem, CommandLimits(0.0, 6.0, 1000.0), observer, None)


# From the time of a sample [s] to the readings that come then: angle [deg] and how much later than the first [s].
Shows = Callable[[float], list[tuple[float, float]]]


@dataclass
class Ride:
    """A loop in C between two sockets, until it ends by itself or 2 s are over; each sample finds new readings."""

    shows: Shows = lambda t: [(30.0 + 0.01 * math.sin(1e3 * t), 0.0)]
    settings: dict[str, float] = field(default_factory=dict)
    law: Law = field(default_factory=Law)
    commands: list[float] = field(default_factory=list)
    controller: GuardedController | None = None  # in place of one around the law
    before: Any = None  # its states at both ends
    after: Any = None
    hurried: int = 0  # samples without a plan
    skipped: int = 0  # samples that had passed wholly
    changes: dict[str, Any] = field(default_factory=dict)  # fields of the messages from the 20th on

    def run(self, seconds: float = 2.0) -> tuple[str, Any]:
        """Why it has ended, and its struct; where the machine itself stood still, nothing is tested: once more."""
        for _ in range(3):
            self.commands, self.law.steps = [], 0
            reason, view = self._run(seconds)
            if reason != "the loop stood still":
                break
        return reason, view

    def _run(self, seconds: float) -> tuple[str, Any]:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        ours.setblocking(False)
        theirs.setblocking(False)
        with ours, theirs:
            controller = self.controller or controller_of(self.law)
            loop, self.before = CompiledLoop(controller), controller.init(30.0, 1.0)
            loop.take_up(self.before)
            self._begin(loop, ours.fileno())
            loop.view.reference[:] = REFERENCE.tolist()
            asked, view = ctypes.c_int(0), loop.view
            thread = threading.Thread(target=loop.run, args=(asked,), daemon=True)
            began, sequence, shown = time.monotonic(), 0, -1
            thread.start()
            while thread.is_alive() and time.monotonic() - began < seconds:
                now_s = view.written * DT_S
                for angle, late_s in self.shows(now_s) if view.written != shown else ():
                    sequence += 1
                    stamp = time.monotonic_ns() - round(late_s * NS)
                    message = Datagram(Kind.READING, SESSION, sequence, stamp, angle, view.last)
                    theirs.send(encode(replace(message, **self.changes) if sequence > 20 else message))
                view.read = shown = round(now_s / DT_S)
                self._taken(theirs)
                time.sleep(0.2 * DT_S)
            asked.value = 1
            thread.join(5.0)
            self._taken(theirs)
            self.after = loop.after(self.before)
            samples = view.samples[: view.written]
            self.hurried = sum(sample.answer.status == HURRIED for sample in samples)
            self.skipped = sum(sample.skipped for sample in samples)
        return loop.reason, view

    def _taken(self, wire: socket.socket) -> None:
        while True:
            try:
                said = decode(wire.recv(64))
            except BlockingIOError:
                return
            assert isinstance(said, Datagram)
            self.commands.append(said.value)

    def _begin(self, loop: CompiledLoop, descriptor: int) -> None:
        now = time.monotonic_ns()
        boot = time.clock_gettime_ns(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))
        numbers: dict[str, float] = dict.fromkeys(("smooth", "lagged", "low", "high", "least", "most"), math.nan)
        numbers |= dict.fromkeys(("gate_ns", "accepted_ns", "rated_ns", "heard_ns", "watched_ns"), now)
        numbers |= {"descriptor": descriptor, "session": SESSION, "own_session": 3, "deadline_ns": now + 20_000_000}
        numbers |= {"dt_ns": round(DT_S * NS)}
        numbers |= {"boot_ns": boot, "judged_ns": boot, "stall_ns": NS // 2, "gap_ns": NS // 10, "spin_ns": 0}
        numbers |= {"angle": 30.0, "rated": 30.0, "last": 1.0, "command": 1.0, "flight_ns": 0.0}
        numbers |= {"lower": 0.0, "upper": 6.0, "rate": 1000.0, "angle_factor": 1.0, "command_factor": 1.0}
        numbers |= {"angle_high": 120.0, "angle_rate": 400.0, "age_limit_s": 0.5, "tolerance": -1.0, "travel": -1.0}
        numbers |= {"lag_s": 0.5, "smooth_s": 0.2, "moves": 3.0, "departures_most": 1000, "departure_bound": math.inf}
        numbers |= {"recent_most": 10, "fed": 1 << 60, "end": 1 << 60}
        loop.begin(numbers | self.settings)
        loop.view.most_behind = 200


@pytest.fixture
def ride() -> Ride:
    return Ride()


def test_a_calm_ride_goes_on(ride: Ride) -> None:
    reason, view = ride.run(0.5)
    assert reason == "asked"
    assert view.written > 30
    assert set(ride.commands) == {1.0}


def test_a_command_that_is_late_for_its_judgement_does_not_leave(ride: Ride) -> None:
    """The step takes longer than the time for which a judgement of the held command counts."""
    ride.law.at, ride.law.sleeps_s = 20, 0.15
    reason, view = ride.run()
    assert reason == "command not sent"
    assert len(ride.commands) == 20
    assert view.samples[(view.written - 1) % 256].sent == 0


def test_a_sample_that_ends_late_is_followed_by_one_without_a_plan(ride: Ride) -> None:
    """Its command leaves after its end, and before that of the next one: no sample has passed wholly."""
    ride.law.at, ride.law.sleeps_s = 20, 1.4 * DT_S
    reason, _ = ride.run(0.5)
    assert reason == "asked"
    assert ride.hurried >= 1


def test_a_step_that_takes_longer_than_a_sample_is_followed_by_one_without_a_plan(ride: Ride) -> None:
    ride.law.at, ride.law.sleeps_s = 20, 0.035
    reason, view = ride.run(0.5)
    assert reason == "asked"
    assert ride.hurried >= 1
    assert ride.skipped >= 1
    assert view.steps == view.written + ride.skipped  # those that passed wholly were stepped without a command


def test_a_delay_that_grows_ends_the_ride(ride: Ride) -> None:
    """Readings later by .2 s a second: the one that is .1 s old is Python's."""
    ride.shows = lambda t: [(30.0 + 0.01 * math.sin(1e3 * t), 0.2 * t)]
    ride.settings = {"age_limit_s": 0.1}
    reason, view = ride.run()
    assert reason == "reading"
    assert 20 < view.written < 75


@pytest.mark.parametrize(("noise_deg", "reason"), [(1.5, "asked"), (25.0, "reading")])
def test_noise_of_a_fast_stream_is_no_jump_and_an_outlier_is(ride: Ride, noise_deg: float, reason: str) -> None:
    """Two readings less than a millisecond apart, at 400 deg/s at most."""
    ride.shows = lambda t: [(30.0 + 1e-3 * math.sin(1e3 * t), 0.0), (30.0 + (noise_deg if t > 0.2 else 0.1), 0.0)]
    assert ride.run(0.6)[0] == reason


@pytest.mark.parametrize(
    "changes", [{"session": SESSION + 1}, {"kind": Kind.COMMAND}, {"held": math.nan}, {"value": math.nan}]
)
def test_a_message_that_is_none_of_this_device_is_left_to_python(ride: Ride, changes: dict[str, Any]) -> None:
    ride.changes = changes
    reason, view = ride.run(1.0)
    assert reason == "reading"
    assert view.written > 5


def test_travel_without_motion_counts_as_a_lag_follows_it(ride: Ride) -> None:
    """A step of twice the travel is implausible after ln 2 time constants, and not at once."""
    ride.settings = {"travel": 1.0, "lag_s": 0.5}
    ride.law.u = 3.0
    reason, view = ride.run()
    assert reason == "motion or held command"
    assert 0.25 < view.written * DT_S < 0.6


CONTROLLERS: dict[str, dict[str, Any]] = {
    "learning, supervised": {"kind": "linearised_mpc"},
    "with a delay": {"kind": "linearised_mpc", "adaptation": None, "estimator": {"delay_samples": 2}},
    "random plans": {"kind": "sampling_mpc"},
    "inverse and PID": {"kind": "inverse_pid"},
    "PID": {"kind": "pid"},
}


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_samples_in_c_are_steps_of_the_controller_of_python(kind: str, ride: Ride) -> None:
    """Command, words and memory to the last bit: also of samples without an angle, late ones, skipped ones."""
    settings = TipSettings.parse({"model": "builtin:pi", "controller": CONTROLLERS[kind]})
    controller = assemble(settings, Path()).controller
    ride.controller, ride.settings = controller, {"dt_s": DT_S, "skipped": 2}
    ride.shows = lambda t: [] if 0.1 < t < 0.14 else [(40.0 - 10.0 * math.cos(4.0 * t), 0.0)]
    _, view = ride.run(0.7)
    state, steps, stalled, hurried = ride.before, 0, 0, False
    assert view.written > 20
    for sample in view.samples[: view.written]:
        for _ in range(sample.skipped):
            state = controller.step(state, math.nan, np.empty(0))[1]
        steps += sample.skipped
        wanted = REFERENCE[np.arange(steps + 1, steps + 1 + controller.horizon) % REFERENCE.size]
        refusal = LATE if hurried or sample.skipped else ""
        command, state = controller.step(replace(state, refusal=refusal), sample.angle_deg, wanted)
        same = CompiledLoop.command(sample, stalled, LATE)
        assert (same.u, same.source, same.status) == (command.u, command.source, command.status)
        assert same.disturbance == command.disturbance
        assert (sample.due_deg, sample.failures) == (state.due, state.head.failures)
        steps, stalled = steps + 1, sample.stalled
        hurried = sample.done_ns > sample.deadline_ns + view.dt_ns
    assert bytes(ride.after.memory) == bytes(state.memory)
