"""Transports from outside the package: how they are named, what is refused in one line, and what they cannot do."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hystmpc.rig.config import BenchSettings
from hystmpc.rig.run import first_contact, run_bench
from hystmpc.rig.safety.stop import StopFlag
from hystmpc.rig.transports import from_outside
from hystmpc.rig.transports.from_outside import GuardedTransport, PythonSettings, reading_fault
from hystmpc.rig.transports.transport import Conversion, Reading, RunContext
from hystmpc.trials.errors import ConfigError

from .bench_parts import ListSink
from .test_run import SETTINGS

BUS = """
from hystmpc.rig import Reading

class Bus:
    counters = {}
    def __init__(self, port, baud=115200):
        self.port, self.baud, self.k = port, baud, 0
    def read(self):
        self.k += 1
        return Reading.now(40.0, self.k, 0.0)
    def write(self, command):
        raise AssertionError("nothing may move")
    def greet(self): pass
    def stop(self, goodbye=False): pass

class Deaf:
    counters = {}
    def read(self): return None
    def greet(self): pass
    def stop(self, goodbye=False): pass

class Broken(Bus):
    def __init__(self, port):
        raise PermissionError(13, "Permission denied", port)
"""
CONTEXT = RunContext(Conversion(1.0, 0.0, 1.0), 0.01, time.monotonic_ns, lambda block, dt_s: None)  # type: ignore[arg-type,return-value]


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A working folder with a class of the lab."""
    (tmp_path / "mylab").mkdir()
    (tmp_path / "mylab" / "bus.py").write_text(BUS)
    (tmp_path / "mylab" / "syntax.py").write_text("def f(:")
    (tmp_path / "mylab" / "wants.py").write_text("import no_such_driver")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield tmp_path
    for name in [name for name in sys.modules if name.partition(".")[0] == "mylab"]:
        del sys.modules[name]


def bench(transport: dict[str, Any]) -> BenchSettings:
    return BenchSettings.parse(SETTINGS | {"transport": transport})


def test_a_class_of_the_working_folder_gets_the_further_keys(lab: Path) -> None:
    settings = bench({"python": "mylab.bus:Bus", "port": "line 7", "baud": 9600})
    assert BenchSettings.parse(settings.model_dump(mode="json")) == settings  # as a run folder keeps it
    transport = settings.transport.open(CONTEXT)
    assert isinstance(transport, GuardedTransport)
    assert (transport._device.port, transport._device.baud) == ("line 7", 9600)
    reading = transport.read()
    assert reading is not None
    assert reading.angle_deg == 40.0
    transport.stop()


def test_an_entry_point_makes_a_kind_known(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed = EntryPoints([EntryPoint("maxon", "mylab.bus:Bus", "hystmpc.transports")])
    monkeypatch.setattr("hystmpc.trials.from_outside.entry_points", lambda group: installed.select(group=group))
    assert bench({"kind": "maxon", "port": "a"}) == bench({"python": "mylab.bus:Bus", "port": "a"})
    with pytest.raises(ConfigError, match=r"unknown kind 'maxn', available: .*udp; did you mean 'maxon'"):
        bench({"kind": "maxn"})
    with pytest.raises(ConfigError, match="got neither kind nor python, expected kind: simulated"):
        bench({"port": "a"})


@pytest.mark.parametrize(
    ("block", "expected"),
    [
        ({"python": "mylab.bis:Bus"}, "no module 'mylab.bis' is installed or in the working folder"),
        ({"python": "yourlab.bus:Bus"}, "no module 'yourlab' is installed or in the working folder"),
        ({"python": "mylab.wants:Bus"}, "its module needs 'no_such_driver', which is not installed"),
        ({"python": "mylab.syntax:Bus"}, "cannot be imported \\(SyntaxError"),
        ({"python": "mylab.bus:Buss"}, "no class 'Buss' in .*bus.py, available: Broken, Bus, Deaf; did you mean 'Bus'"),
        ({"python": "mylab.bus:Deaf"}, "lacks write, expected the methods read, write, greet, stop and"),
        ({"python": "mylab.bus:Bus"}, "missing a required argument: 'port', expected arguments: port, baud"),
        ({"python": "mylab.bus:Bus", "prot": "a"}, "argument.*available: baud, port; did you mean 'port'"),
        (
            {"python": "mylab.bus:Broken", "port": "a"},
            "cannot be opened \\(PermissionError: .*Permission denied: 'a'\\)",
        ),
    ],
)
def test_a_class_that_does_not_fit_is_refused_in_one_line(block: dict[str, Any], expected: str, lab: Path) -> None:
    with pytest.raises(ConfigError, match=expected) as refused:
        bench(block).transport.open(CONTEXT)
    assert "\n" not in str(refused.value)


def test_a_name_that_is_no_class_is_refused_when_the_file_is_read() -> None:
    with pytest.raises(ConfigError, match=r"transport\.python"):
        bench({"python": "mylab/bus.py"})


class Bus:
    """A device in this process that does what a test wants."""

    def __init__(self, read: Callable[[], Any] = lambda: None, write: Callable[[float], Any] = lambda u: None) -> None:
        self.counters = {"lost": 2}
        self.read, self.write, self.stops = read, write, 0

    def greet(self) -> None:
        pass

    def stop(self, goodbye: bool = False) -> None:
        del goodbye
        self.stops += 1


def guard(bus: Any, conversion: Conversion = CONTEXT.conversion) -> GuardedTransport:
    return GuardedTransport(lambda: bus, "test:Bus", replace(CONTEXT, conversion=conversion))


@given(st.floats(-100, 100), st.floats(-5, 5), st.sampled_from([1.0, -57.3]), st.sampled_from([1e-2, 1.0, 1e3]))
def test_the_class_speaks_the_units_of_the_wire(angle: float, held: float, factor: float, command: float) -> None:
    got: list[float] = []
    wire = guard(Bus(lambda: Reading.now(angle, 1, held), got.append), Conversion(factor, 3.0, command))
    reading = wire.read()
    assert reading is not None
    assert (reading.angle_deg, reading.held) == (factor * angle + 3.0, command * held)
    wire.write(reading.held)
    assert got == [pytest.approx(held)]
    wire.stop()


@given(
    st.one_of(
        st.text(),
        st.integers(),
        st.tuples(st.floats(), st.floats()),
        st.builds(
            Reading,
            angle_deg=st.one_of(st.none(), st.text(), st.sampled_from([math.inf, -math.inf])),
            sequence=st.just(1),
            session=st.just(0),
            sent_ns=st.just(0),
            received_ns=st.just(0),
            held=st.floats(),
        ),
        st.builds(
            Reading,
            angle_deg=st.floats(),
            sequence=st.one_of(st.none(), st.floats()),
            session=st.just(0),
            sent_ns=st.just(0),
            received_ns=st.just(0),
            held=st.floats(),
        ),
    )
)
def test_nonsense_is_named(found: object) -> None:
    assert reading_fault(found, 0)


GOOD = Reading(30.0, 1, 0, 5, 5, 1.0)
WHOLE = ("sequence", "session", "sent_ns", "received_ns")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name in WHOLE for value in (None, 1.0, True, "1", [1], np.arange(2), 10**30, -(10**30))),
        *((name, value) for name in ("angle_deg", "held") for value in (None, True, "1", np.ones(2), 10**400, 1j)),
        *((name, sign * math.inf) for name in ("angle_deg", "held") for sign in (-1, 1)),
        *(("listens", value) for value in (None, 1, 0, "yes", np.array([True, False]), math.nan)),
    ],
)
def test_every_field_is_looked_at(name: str, value: Any) -> None:
    assert name in reading_fault(replace(GOOD, **{name: value}), 10)
    wire = guard(Bus(lambda: replace(GOOD, **{name: value})))
    with pytest.raises(ValueError, match=name):
        wire.read()
    wire.stop()


@pytest.mark.parametrize(
    ("name", "factor"), [("held", Conversion(1.0, 0.0, 1e3)), ("angle_deg", Conversion(57.3, 0, 1))]
)
def test_a_number_that_is_none_in_the_units_of_the_run_is_nonsense(name: str, factor: Conversion) -> None:
    wire = guard(Bus(lambda: replace(GOOD, **{name: 1e308})), factor)
    with pytest.raises(ValueError, match=f"no number as {name} in the units of the run"):
        wire.read()
    wire.stop()


@pytest.mark.parametrize("kind", [np.int8, np.uint8, np.int32, np.uint32, np.int64, np.uint64])
def test_numbers_of_numpy_become_those_of_python(kind: Any) -> None:
    """Else a difference of two sequence numbers would overflow."""
    found = Reading(np.float32(30.5), kind(7), kind(3), kind(5), kind(5), np.float64(1.5), np.bool_(False))  # type: ignore[arg-type]
    wire = guard(Bus(lambda: found))
    reading = wire.read()
    assert reading == Reading(30.5, 7, 3, 5, 5, 1.5, False)
    assert [type(getattr(reading, name)) for name in (*WHOLE, "held", "listens")] == [int] * 4 + [float, bool]
    wire.stop()


@given(st.lists(st.sampled_from(["reading", "text", "error"]), max_size=20))
def test_what_is_fetched_several_at_a_time_comes_one_by_one_and_in_order(script: list[str]) -> None:
    """A reading, nonsense or an error each at its turn, and None at the end."""
    left = list(enumerate(script))

    def read() -> Any:
        if not left:
            return None
        k, what = left.pop(0)
        if what == "error":
            raise OSError(str(k))
        return replace(GOOD, sequence=k) if what == "reading" else str(k)

    wire, got = guard(Bus(read)), list[str]()
    for _ in script:
        try:
            reading = wire.read()
            assert reading is not None
            got.append("reading")
        except ValueError:
            got.append("text")
        except OSError:
            got.append("error")
    assert got == script
    assert wire.read() is None
    wire.stop()


def test_a_reading_that_comes_late_is_kept_and_a_command_goes_before_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(from_outside, "PATIENCE_S", 0.02)
    free, got, reads = threading.Event(), list[float](), [0]

    def read() -> Reading:
        reads[0] += 1
        free.wait()
        return replace(GOOD, sequence=reads[0])

    wire = guard(Bus(read, got.append), replace(CONTEXT.conversion))
    with pytest.raises(TimeoutError):
        wire.read()
    monkeypatch.setattr(from_outside, "_AT_ONCE", 1)
    free.set()
    monkeypatch.setattr(from_outside, "PATIENCE_S", 5.0)
    end = time.monotonic() + 5
    while not wire._worker.idle and time.monotonic() < end:
        time.sleep(0.001)
    count = reads[0]
    for sequence in range(1, count + 1):
        reading = wire.read()
        assert reading is not None
        assert reading.sequence == sequence
    assert wire.read() is None
    assert reads[0] == count
    wire.write(1.0)
    assert got == [1.0]
    assert wire.read() is not None
    wire.stop()


def test_what_is_refused_is_counted_beside_what_the_class_counts() -> None:
    wire = guard(Bus(lambda: "30 deg"))
    for _ in range(3):
        with pytest.raises(ValueError, match="read returned str, expected Reading or None"):
            wire.read()
    assert dict(wire.counters) == {"lost": 2, "read returned str, expected Reading or None": 3}
    wire.stop()


@pytest.mark.parametrize("error", [SystemExit(3), KeyboardInterrupt(), GeneratorExit()])
def test_a_driver_ends_no_program(error: BaseException) -> None:
    def fails() -> None:
        raise error

    wire = guard(Bus(fails))
    with pytest.raises(OSError, match=f"it raised {type(error).__name__}"):
        wire.read()
    wire.stop()


def test_counters_that_hang_hold_up_nothing_and_the_device_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are asked for after a run, beside a device that has to be let go."""
    monkeypatch.setattr(from_outside, "PATIENCE_S", 0.05)
    free, hangs = threading.Event(), threading.Event()

    class Slow(Bus):
        @property
        def counters(self) -> dict[str, int]:
            if hangs.is_set():
                free.wait()
            return {"lost": 3}

        @counters.setter
        def counters(self, value: dict[str, int]) -> None:
            """Set by `Bus`."""

    bus = Slow()
    wire = guard(bus)
    assert wire.counters == {"lost": 3}
    hangs.set()
    wire.stop()
    assert bus.stops == 1
    assert wire.counters == {"counters cannot be read": 1}
    free.set()


def test_what_was_counted_up_to_the_end_is_told_after_it() -> None:
    bus = Bus()
    wire = guard(bus)
    bus.counters["lost"] = 5
    wire.stop()
    assert wire.counters == {"lost": 5}


def test_a_call_that_hangs_raises_and_every_other_one_at_once_until_it_is_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """One command at most can come late: none waits behind one that hangs."""
    monkeypatch.setattr(from_outside, "PATIENCE_S", 0.02)
    monkeypatch.setattr(from_outside, "_CLOSES_S", 0.02)
    free, got = threading.Event(), list[float]()

    def write(u: float) -> None:
        free.wait()
        got.append(u)

    bus = Bus(write=write)
    wire = guard(bus)
    with pytest.raises(TimeoutError, match=r"it has not come back within 0\.02 s"):
        wire.write(1.0)
    for u in (2.0, 3.0):
        with pytest.raises(TimeoutError, match="still hangs"):
            wire.write(u)
    with pytest.raises(TimeoutError):
        wire.stop()
    assert bus.stops == 0
    free.set()
    end = time.monotonic() + 5
    while not bus.stops and time.monotonic() < end:
        time.sleep(0.001)
    assert (got, bus.stops) == ([1.0], 1)
    with pytest.raises(OSError, match="closed"):
        wire.write(4.0)


def test_a_transport_that_never_opens_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(from_outside, "_OPENS_S", 0.02)
    free = threading.Event()
    with pytest.raises(ConfigError, match=r"cannot be opened \(TimeoutError: it has not come back within 0.02 s\)"):
        GuardedTransport(free.wait, "test:Bus", CONTEXT)
    free.set()


def test_a_driver_that_only_fails_is_refused_before_anything_moves() -> None:
    def fails() -> None:
        raise RuntimeError("bus off")

    settings = BenchSettings.parse(SETTINGS | {"transport": {"python": "test:Bus"}, "connect_timeout_s": 0.1})

    class Now:
        now_ns = staticmethod(time.monotonic_ns)

        def wait_until(self, deadline_ns: int) -> None:
            del deadline_ns
            time.sleep(0.001)

    with pytest.raises(
        ConfigError, match=r"got no angle from transport test:Bus within 0\.1 s.*read raised RuntimeError"
    ):
        first_contact(settings, guard(Bus(fails)), Now(), StopFlag())  # type: ignore[arg-type]  # a clock


def test_an_instance_takes_the_place_of_the_block(tmp_path: Path) -> None:
    bus = Bus(lambda: None)
    settings = BenchSettings.parse(SETTINGS | {"latch_file": str(tmp_path / "latch.json"), "connect_timeout_s": 0.05})
    with pytest.raises(ConfigError, match=r"got no angle from transport .*test_from_outside:Bus within"):
        run_bench(settings, list, ListSink, lambda block, dt_s: None, transport=bus)  # type: ignore[arg-type,return-value]
    assert bus.stops == 1
    assert PythonSettings.of(bus).python.endswith("test_from_outside:Bus")  # type: ignore[arg-type]  # by its methods
