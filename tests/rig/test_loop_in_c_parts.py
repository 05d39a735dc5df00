"""The loop in C alone, over a pair of sockets, with a controller that does as it is told: time, age, rate and lag."""

from __future__ import annotations

import ctypes
import math
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from hystmpc.codegen.compiler import EXPECTED, compiler, shared_library
from hystmpc.codegen.library import FLAGS
from hystmpc.rig.compiled.controller import CompiledLoop, available, source
from hystmpc.rig.transports.udp import Datagram, Kind, decode, encode

pytestmark = pytest.mark.slow

NS, DT_S, SESSION = 1_000_000_000, 0.01, 7
HEADER = """
#define HYSTMPC_REFERENCE 3
#define HYSTMPC_LEARNS 0
#define HYSTMPC_SUPERVISED 0
typedef struct { double u; int source, status, missing; double predicted_deg, departure_deg; } hystmpc_command;
typedef struct {
    double due, sleeps_s, u; /* a step that takes so long, once; and the command that it answers */
    int stopped, failures, hurried, at, steps;
    struct { int stalled; double angles[1]; } estimate;
} hystmpc_controller;
hystmpc_command hystmpc_step(hystmpc_controller *c, double angle, const double *reference);
void hystmpc_hurry(hystmpc_controller *c);
"""
CONTROLLER = """
#define _POSIX_C_SOURCE 200809L
#include "hystmpc.h"
#include <time.h>
hystmpc_command hystmpc_step(hystmpc_controller *c, double angle, const double *reference) {
    hystmpc_command answer = {0};
    (void)angle;
    (void)reference;
    if (c->steps++ == c->at) {
        const struct timespec t = {(time_t)c->sleeps_s, (long)(1e9 * (c->sleeps_s - (double)(long)c->sleeps_s))};
        nanosleep(&t, 0);
    }
    answer.u = c->u;
    return answer;
}
void hystmpc_hurry(hystmpc_controller *c) { c->hurried++; }
"""


class Controller(ctypes.Structure):
    """The struct above."""

    _fields_ = (
        *((name, ctypes.c_double) for name in ("due", "sleeps_s", "u")),
        *((name, ctypes.c_int) for name in ("stopped", "failures", "hurried", "at", "steps", "stalled")),
        ("angles", ctypes.c_double),
    )


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    command = compiler()
    if command is None or not available():
        pytest.skip(f"no C compiler ({EXPECTED}), or a system without sockets of POSIX")
    sources = {"hystmpc.h": HEADER, "controller.c": CONTROLLER, "loop.c": source()}
    path = tmp_path_factory.mktemp("loop") / "loop.so"
    path.write_bytes(shared_library(command, FLAGS, sources, "controller.c", "loop.c"))
    return path


# From the time of a sample [s] to the readings that come then: angle [deg] and how much later than the first [s].
Shows = Callable[[float], list[tuple[float, float]]]


@dataclass
class Ride:
    """A loop in C between two sockets, until it ends by itself or 2 s are over; each sample finds new readings."""

    library: Path
    shows: Shows = lambda t: [(30.0 + 0.01 * math.sin(1e3 * t), 0.0)]
    settings: dict[str, float] = field(default_factory=dict)
    controller: Controller = field(default_factory=lambda: Controller(at=-1, u=1.0))
    commands: list[float] = field(default_factory=list)

    def run(self, seconds: float = 2.0) -> tuple[str, Any]:
        """Why it has ended, and its struct."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        ours.setblocking(False)
        theirs.setblocking(False)
        with ours, theirs:
            loop = CompiledLoop(
                self.library, ctypes.addressof(self.controller), 3, {"dt_s": DT_S, "dt_ns": round(DT_S * NS)}
            )
            self._begin(loop, ours.fileno())
            asked, view = ctypes.c_int(0), loop.view
            run = ctypes.CDLL(str(self.library)).hystmpc_loop_run
            arguments = ctypes.byref(view), ctypes.byref(self.controller), ctypes.byref(asked)
            thread = threading.Thread(target=run, args=arguments, daemon=True)
            began, sequence, shown = time.monotonic(), 0, -1
            thread.start()
            while thread.is_alive() and time.monotonic() - began < seconds:
                now_s = view.written * DT_S
                for angle, late_s in self.shows(now_s) if view.written != shown else ():
                    sequence += 1
                    stamp = time.monotonic_ns() - round(late_s * NS)
                    theirs.send(encode(Datagram(Kind.READING, SESSION, sequence, stamp, angle, view.last)))
                view.read = shown = round(now_s / DT_S)
                self._taken(theirs)
                time.sleep(0.2 * DT_S)
            asked.value = 1
            thread.join(5.0)
            self._taken(theirs)
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
        numbers |= {"boot_ns": boot, "judged_ns": boot, "stall_ns": NS // 2, "gap_ns": NS // 10, "spin_ns": 0}
        numbers |= {"angle": 30.0, "rated": 30.0, "last": 1.0, "command": 1.0, "flight_ns": 0.0}
        numbers |= {"lower": 0.0, "upper": 6.0, "rate": 1000.0, "angle_factor": 1.0, "command_factor": 1.0}
        numbers |= {"angle_high": 120.0, "angle_rate": 400.0, "age_limit_s": 0.5, "tolerance": -1.0, "travel": -1.0}
        numbers |= {"lag_s": 0.5, "smooth_s": 0.2, "moves": 3.0, "departures_most": 1000, "departure_bound": math.inf}
        numbers |= {"recent_most": 10, "stop_after": 1000, "fed": 1 << 60, "end": 1 << 60}
        loop.begin(numbers | self.settings)
        loop.view.most_behind = 200


@pytest.fixture
def ride(library: Path) -> Ride:
    return Ride(library)


def test_a_calm_ride_goes_on(ride: Ride) -> None:
    reason, view = ride.run(0.5)
    assert reason == "asked"
    assert view.written > 30
    assert set(ride.commands) == {1.0}


def test_a_command_that_is_late_for_its_judgement_does_not_leave(ride: Ride) -> None:
    """The step takes longer than the time for which a judgement of the held command counts."""
    ride.controller.at, ride.controller.sleeps_s = 20, 0.15
    reason, view = ride.run()
    assert reason == "command not sent"
    assert len(ride.commands) == 20
    assert view.samples[(view.written - 1) % 256].sent == 0


def test_a_sample_that_ends_late_is_followed_by_one_without_a_plan(ride: Ride) -> None:
    """Its command leaves after its end, and before that of the next one: no sample has passed wholly."""
    ride.controller.at, ride.controller.sleeps_s = 20, 1.4 * DT_S
    reason, _ = ride.run(0.5)
    assert reason == "asked"
    assert ride.controller.hurried >= 1


def test_a_step_that_takes_longer_than_a_sample_is_followed_by_one_without_a_plan(ride: Ride) -> None:
    ride.controller.at, ride.controller.sleeps_s = 20, 0.035
    reason, view = ride.run(0.5)
    assert reason == "asked"
    assert ride.controller.hurried >= 1
    assert view.written < ride.controller.steps  # samples that passed wholly were stepped without a command


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


def test_travel_without_motion_counts_as_a_lag_follows_it(ride: Ride) -> None:
    """A step of twice the travel is implausible after ln 2 time constants, and not at once."""
    ride.settings = {"travel": 1.0, "lag_s": 0.5}
    ride.controller.u = 3.0
    reason, view = ride.run()
    assert reason == "motion or held command"
    assert 0.25 < view.written * DT_S < 0.6
