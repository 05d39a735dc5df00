"""Laws of the loop in C: over a real socket, what it takes is as expected, and all else is Python's."""

from __future__ import annotations

import itertools
import math
import random
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from hystmpc.models.load import library_file
from hystmpc.models.simulator import load_simulator, save_simulator
from hystmpc.rig.compiled.loop import available
from hystmpc.rig.config import RunSettings
from hystmpc.rig.experiment.experiment import run_experiment
from hystmpc.rig.live.desk import E_STOP, Desk, LiveSettings
from hystmpc.rig.loop import ControlLoop
from hystmpc.rig.recording.sample import Sample
from hystmpc.rig.run import BenchResult
from hystmpc.rig.transports.udp import Datagram, Kind, decode, encode

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not available(), reason="a system without sockets of POSIX"),
]

RATE_HZ, RATE_PER_S = 200.0, 30.0
SPOILT = 200  # the message from which on something is wrong: a second after the first, in the middle of a run
SESSION = 7
# One message of the device to what arrives in its place.
Spoil = Callable[[Datagram], list[bytes]]


def whole(message: Datagram) -> list[bytes]:
    return [encode(message)]


@dataclass
class Tip:
    """A device behind a socket: a tip with a play, that tells what its drive holds."""

    spoil: Spoil = whole
    noise_deg: float = 0.05
    commands: list[float] = field(default_factory=list)  # as they came
    _ended: threading.Event = field(default_factory=threading.Event)

    @contextmanager
    def listening(self) -> Iterator[int]:
        """Its port, while the block lasts."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
            wire.bind(("127.0.0.1", 0))
            wire.setblocking(False)
            thread = threading.Thread(target=self._live, args=(wire,), daemon=True)
            thread.start()
            try:
                yield int(wire.getsockname()[1])
            finally:
                self._ended.set()
                thread.join(5.0)

    def _live(self, wire: socket.socket) -> None:
        held = play = 0.0
        drawn, peer, sent = random.Random(3), None, 0
        while not self._ended.wait(1.0 / RATE_HZ):
            while True:
                try:
                    data, peer = wire.recvfrom(64)
                except BlockingIOError:
                    break
                said = decode(data)
                assert isinstance(said, Datagram)
                if said.kind is Kind.COMMAND:
                    held = said.value
                    self.commands.append(held)
            play = min(max(play, held - 0.2), held + 0.2)
            angle = 30.0 + 11.0 * play + drawn.gauss(0.0, self.noise_deg)
            if peer is None:
                continue
            sent += 1
            for bytes_ in self.spoil(Datagram(Kind.READING, SESSION, sent, time.monotonic_ns(), angle, held)):
                with suppress(OSError):  # nobody listens any more
                    wire.sendto(bytes_, peer)


@dataclass
class Kept:
    """Samples of a run, and something to do at one of them."""

    at: int = -1
    do: Callable[[], object] = lambda: None
    samples: list[Sample] = field(default_factory=list)

    def put(self, sample: Sample) -> None:
        self.samples.append(sample)
        if len(self.samples) == self.at:
            self.do()

    def close(self) -> None:
        """Nothing to do."""


def run(
    tip: Tip, folder: Path, kept: Kept, desk: Desk | None = None, cycles: int = 2, hz: float = 1.0, **changes: Any
) -> BenchResult:
    """A sine with the loop in C; a device that a busy machine slows down has the second cycle too."""
    with tip.listening() as port:
        settings = RunSettings.parse(
            {
                "name": "tip",
                "rate_hz": RATE_HZ,
                "command_unit": "mm",
                "limits": {"lower": 0, "upper": 6, "rate_per_s": RATE_PER_S, "beyond_model": True},
                "safe_command": 0,
                "ramps": {"velocity_per_s": 8, "acceleration_per_s2": 80, "jerk_per_s3": 2000},
                "latch_file": str(folder / "latched.json"),
                "sensor": {"lower_deg": 0, "upper_deg": 120, "rate_limit_deg_s": 2000.0},
                "transport": {"kind": "udp", "port": port},
                "controller": controller(),
                "realtime": {"backend": "c"},
                "reference": {
                    "kind": "scan_sinusoid",
                    "start_deg": 40,
                    "centre_deg": 55,
                    "amplitude_deg": 10,
                    "frequency_hz": hz,
                    "cycles": cycles,
                },
                "plausibility": {"model_error_deg": 60.0},
                **changes,
            }
        )
        return run_experiment(settings, lambda: kept, no_plants, folder=folder, desk=desk)


@cache
def models() -> tempfile.TemporaryDirectory[str]:
    """One folder for all runs."""
    folder = tempfile.TemporaryDirectory()
    save_simulator(load_simulator(library_file("pi")).at_sample_time(1 / RATE_HZ), Path(folder.name) / "pi.yaml")
    return folder


def controller(**changes: Any) -> dict[str, Any]:
    """Plays without learning, at the rate of these runs."""
    law = {"kind": "linearised_mpc", "adaptation": None, "horizon": 10, **changes}
    return {"model": str(Path(models().name) / "pi.yaml"), "controller": law}


def no_plants(block: Any, dt_s: float) -> Any:
    raise AssertionError("there is a device")


def within_limits(tip: Tip) -> bool:
    """Whether no command that came to the device is beyond the limits; none may jump further than a sample allows."""
    reach = RATE_PER_S / RATE_HZ + 1e-9
    moves = [abs(b - a) for a, b in itertools.pairwise(tip.commands)]
    return all(0.0 <= u <= 6.0 for u in tip.commands) and max(moves) <= reach


@pytest.fixture(autouse=True)
def taken(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """What was wrong with the samples that were taken in C, by Python's rules: nothing may be, in any of these runs."""
    wrong: list[str] = []
    book = ControlLoop._book

    def booked(self: ControlLoop, done: Any, raw: list[tuple[bytes, int]], decision: Any) -> None:
        faults, intake, gate = self.faults.copy(), self._intake, self._gate
        cause, last, elapsed_s = self._flag.cause, gate.last, gate._elapsed_s(done.checked_ns)
        book(self, done, raw, decision)
        wrong.extend(set((self.faults - faults).elements()) - {"no-angle", "deadline-missed"})
        wrong.extend(str(said) for said in map(decode, (bytes_ for bytes_, _ in raw)) if isinstance(said, str))
        if self._flag.cause not in (cause, E_STOP):
            wrong.append(self._flag.cause)
        if done.woke_ns - intake._angles[0].accepted_ns > 1e8:
            wrong.append("silent")
        if abs(done.u - last) > gate._limits[0].rate * elapsed_s + 1e-12:
            wrong.append("beyond the rate")

    monkeypatch.setattr(ControlLoop, "_book", booked)
    yield wrong
    assert wrong == []


def test_a_calm_run_is_taken_in_c(tmp_path: Path) -> None:
    tip, kept = Tip(), Kept()
    result = run(tip, tmp_path, kept, cycles=1)
    planned = [sample for sample in kept.samples if sample.source == "mpc"]
    assert not result.outcome.cause
    assert result.outcome.confirmed
    assert result.outcome.in_c > 0.5 * len(planned) > 100
    assert result.outcome.left_c["no further reference"] == 1
    assert [sample.sequence for sample in kept.samples] == sorted({sample.sequence for sample in kept.samples})
    assert within_limits(tip)
    assert tip.commands[-1] == 0.0
    late = kept.samples[len(kept.samples) // 2 :]
    errors = [abs(s.measured_deg - s.reference_deg) for s in late if math.isfinite(s.measured_deg - s.reference_deg)]
    assert sum(errors) / len(errors) < 2.0


def spoiler(share: float) -> Spoil:
    """Of so many messages something is wrong, one thing after the other."""
    drawn, old, turn = random.Random(11), [b""], itertools.count()

    def spoil(m: Datagram) -> list[bytes]:
        good = encode(m)
        old[0] = old[0] or good
        if drawn.random() >= share or m.sequence < 100:
            return [good]
        ways: list[list[bytes]] = [
            [good[:25] + bytes([good[25] ^ 8]) + good[26:]],
            [encode(Datagram(m.kind, m.session, m.sequence, m.stamp_ns, math.nan, m.held))],
            [encode(Datagram(m.kind, m.session, m.sequence, m.stamp_ns, 170.0, m.held))],
            [encode(Datagram(m.kind, m.session, m.sequence, m.stamp_ns, m.value + 40.0, m.held))],
            [encode(Datagram(m.kind, m.session, m.sequence, m.stamp_ns - 10**9, m.value, m.held))],
            [encode(Datagram(m.kind, m.session, m.sequence, m.stamp_ns, m.value, m.held + 4.0))],
            [encode(Datagram(Kind.COMMAND, m.session, m.sequence, m.stamp_ns, m.value, m.held))],
            [good[:43]],
            [good + b"\0" * 20],
            [old[0], good],
            [good, good],
            [b"", good],
            [],
        ]
        return ways[next(turn) % len(ways)]

    return spoil


def test_python_finds_nothing_wrong_with_what_c_has_taken(tmp_path: Path) -> None:
    tip, kept = Tip(spoiler(0.03)), Kept()
    result = run(tip, tmp_path, kept, cycles=3)
    assert result.outcome.in_c > 50
    assert result.outcome.left_c["reading"] > 3
    seen = {"not-a-number", "out-of-range", "jump", "stale", "replayed-or-reordered"}
    assert len(seen & result.outcome.faults.keys()) >= 3  # they were Python's
    assert {"wrong checksum", "wrong size", "not a reading"} <= result.wire.keys()
    assert within_limits(tip)


def test_silence_is_left_to_python(tmp_path: Path) -> None:
    result = run(Tip(lambda m: [] if 300 < m.sequence < 335 else [encode(m)]), tmp_path, Kept())
    assert result.outcome.left_c["reading"] >= 1
    assert not result.outcome.cause


def test_an_angle_out_of_range_is_left_to_python(tmp_path: Path) -> None:
    result = run(Tip(), tmp_path, Kept(), cycles=1, hz=0.5, sensor={"lower_deg": 0, "upper_deg": 58.0})
    assert result.outcome.faults["out-of-range"] > 0
    assert result.outcome.left_c["reading"] >= 1


def test_at_the_greatest_rate_the_last_check_limits_what_leaves(tmp_path: Path) -> None:
    tip, limits = Tip(), {"lower": 0, "upper": 6, "rate_per_s": 4.0}
    result = run(tip, tmp_path, Kept(), limits=limits, ramps={"velocity_per_s": 4.0})
    assert result.outcome.clipped > 0
    assert result.outcome.in_c > 50
    moves = [abs(b - a) for a, b in itertools.pairwise(tip.commands)]
    assert max(moves) <= 4.0 / RATE_HZ + 1e-9


def test_a_controller_about_to_stop_is_left_to_python(tmp_path: Path) -> None:
    result = run(Tip(), tmp_path, Kept(), controller=controller(ladder={"stop_after_failures": 1}))
    assert result.outcome.in_c == 0
    assert set(result.outcome.left_c) <= {"controller"}
    assert result.outcome.left_c or result.outcome.cause  # one late sample, on a busy machine, ends such a run before


def test_a_frozen_sensor_is_found(tmp_path: Path) -> None:
    last: list[float] = []

    def freezing(m: Datagram) -> list[bytes]:
        last.append(m.value)
        frozen = last[SPOILT] if len(last) > SPOILT else m.value
        return [encode(Datagram(m.kind, m.session, m.sequence, m.stamp_ns, frozen, m.held))]

    result = run(Tip(freezing), tmp_path, Kept())
    assert result.outcome.cause.startswith(("sensor dead", "controller stopped: no usable measurement"))
    assert result.outcome.faults["frozen"] > 0
    assert result.outcome.in_c > 20


def test_a_blocked_tip_is_found(tmp_path: Path) -> None:
    drawn, last = random.Random(5), list[float]()

    def blocked(m: Datagram) -> list[bytes]:
        last.append(m.value)
        angle = last[SPOILT] + drawn.gauss(0.0, 0.05) if len(last) > SPOILT else m.value
        return [encode(Datagram(m.kind, m.session, m.sequence, m.stamp_ns, angle, m.held))]

    result = run(Tip(blocked), tmp_path, Kept(), plausibility={"model_error_deg": 60.0, "travel": 1.0})
    assert result.outcome.cause.startswith("implausible: the command went")
    assert result.outcome.in_c > 20


def test_a_model_that_is_off_ends_the_run(tmp_path: Path) -> None:
    def shifted(m: Datagram) -> list[bytes]:
        shift = min(0.2 * max(m.sequence - SPOILT, 0), 15.0)
        return [encode(Datagram(m.kind, m.session, m.sequence, m.stamp_ns, m.value + shift, m.held))]

    settings = {"model_error_deg": 8.0, "model_error_s": 0.2, "watch_motion": False}
    result = run(Tip(shifted), tmp_path, Kept(), plausibility=settings)
    assert result.outcome.cause.startswith("implausible: the device is")
    assert result.outcome.left_c["controller"] >= 1


@pytest.mark.parametrize("action", ["estop", "stop"])
def test_no_sample_begins_after_a_stop_was_asked_for(action: str, tmp_path: Path) -> None:
    desk, asked = Desk(LiveSettings(control=True)), list[int]()

    def ask() -> None:
        desk.ask(action)
        asked.append(time.time_ns())

    kept = Kept(SPOILT, ask)
    result = run(Tip(), tmp_path, kept, desk)
    assert bool(result.outcome.cause) == (action == "estop")
    began = [s.wall_ns - 1e9 * dict(s.stages_s)["execution"] for s in kept.samples if s.source == "mpc"]
    assert max(began) < asked[0] + 1e9 / RATE_HZ / 5
    assert result.outcome.confirmed


def test_a_target_from_elsewhere_is_tracked_until_stop(tmp_path: Path) -> None:
    desk = Desk(LiveSettings(control=True))
    kept = Kept()

    def lead() -> None:
        while len(kept.samples) < 400:
            time.sleep(0.01)
        assert desk.ask("target", 62.0).done
        time.sleep(2.5)
        desk.ask("stop")

    leader = threading.Thread(target=lead, daemon=True)
    leader.start()
    result = run(Tip(), tmp_path, kept, desk)
    leader.join(5.0)
    tracked = [sample.reference_deg for sample in kept.samples if sample.source == "mpc"]
    assert tracked[-1] == pytest.approx(62.0, abs=1e-6)
    assert result.outcome.left_c["asked"] >= 2
    assert not result.outcome.cause


def test_where_python_does_not_keep_up_it_takes_the_samples_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    book, count = ControlLoop._book, itertools.count()

    def slow(self: ControlLoop, *arguments: Any) -> None:
        book(self, *arguments)
        if next(count) == 100:
            time.sleep(0.15)

    monkeypatch.setattr(ControlLoop, "_book", slow)
    tip = Tip()
    result = run(tip, tmp_path, Kept())
    assert result.outcome.left_c["Python did not keep up"] == 1
    assert not result.outcome.cause
    assert within_limits(tip)


def test_a_watch_that_fails_ends_the_run_safely(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    book, count = ControlLoop._book, itertools.count()

    def failing(self: ControlLoop, *arguments: Any) -> None:
        if next(count) == 100:
            raise ArithmeticError("no such number")
        book(self, *arguments)

    monkeypatch.setattr(ControlLoop, "_book", failing)
    tip, begun = Tip(), threading.active_count()
    result = run(tip, tmp_path, Kept())
    assert result.outcome.cause == "ArithmeticError: no such number"
    assert result.outcome.confirmed
    assert tip.commands[-1] == 0.0
    assert within_limits(tip)
    assert threading.active_count() == begun


def test_a_reference_that_fails_leaves_the_samples_to_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hystmpc.ctrl.planner.reference import GivenReference

    at, begun = GivenReference.at, time.monotonic()

    def failing(self: GivenReference, t: Any) -> Any:
        if len(t) > 100 and float(t[0]) > 0.5:
            raise RuntimeError("no preview")
        return at(self, t)

    monkeypatch.setattr(GivenReference, "at", failing)
    result = run(Tip(), tmp_path, Kept())
    assert result.outcome.left_c["no further reference"] >= 1
    assert not result.outcome.cause
    assert time.monotonic() - begun < 60.0
