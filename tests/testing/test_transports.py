"""The contract of transports, run against those of the package and against the template of `hystmpc new`."""

from __future__ import annotations

import importlib.util
import itertools
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from typer.testing import CliRunner

from hystmpc.cli.main import app
from hystmpc.rig.experiment.record import load_record
from hystmpc.rig.transports.dds import DdsSettings
from hystmpc.rig.transports.transport import Conversion, DeviceLink, Outgoing, Transport
from hystmpc.rig.transports.udp import UdpLink, UdpSettings, UdpTransport
from hystmpc.testing import Connected, LoopContract, TransportContract
from hystmpc.testing.templates import write_template
from hystmpc.trials.errors import ConfigError

from .test_wires import IN_THE_LOOP

SAME = Conversion(1.0, 0.0, 1.0)
RUN = CliRunner()


@contextmanager
def over(link: DeviceLink, transport: Transport) -> Iterator[Connected]:
    """A transport of the package and the device's end of it."""
    count, got = itertools.count(1), list[float]()

    def heard() -> list[float]:
        while (message := link.receive()) is not None:
            got.extend([message.command] if message.says == "command" else [])
        return got

    def tell(angle: float, held: float) -> None:
        heard()
        link.send(Outgoing(angle, held, next(count), time.monotonic_ns()))

    try:
        yield Connected(transport, tell, heard)
    finally:
        transport.stop()
        link.close()


class Udp:
    """Over the loopback."""

    def connected(self) -> AbstractContextManager[Connected]:
        link = UdpLink("127.0.0.1", 0, 0.3)
        return over(link, UdpTransport(UdpSettings(kind="udp", port=link.port), SAME))


class TestUdp(Udp, TransportContract):
    """44-byte datagrams."""


@pytest.mark.slow
class TestUdpInTheLoop(Udp, LoopContract):
    """44-byte datagrams."""


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("cyclonedds") is None, reason="cyclonedds (extra rig)")
class TestDds(TransportContract):
    """Stamped messages."""

    def connected(self) -> AbstractContextManager[Connected]:
        from hystmpc.rig.transports.dds_ import DdsLink, dds_transport

        topics = DdsSettings.parse({"kind": "dds", "domain": 75})
        return over(DdsLink(topics, 0.3), dds_transport(topics, SAME))


def module_of(file: Path) -> Any:
    """A Python file, imported under its own name."""
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def template() -> Any:
    """The contract tests that `hystmpc new transport` writes, beside their class."""
    import sys

    with TemporaryDirectory() as folder:
        write_template("transport", Path(folder) / "new")
        sys.modules["serial_line"] = module_of(Path(folder) / "new" / "serial_line.py")
        try:
            return module_of(Path(folder) / "new" / "test_serial_line.py")
        finally:
            del sys.modules["serial_line"]


class Line:
    """The template on a pseudo-terminal."""

    def connected(self) -> AbstractContextManager[Connected]:
        return template().Device().connected()


class TestTemplate(Line, TransportContract):
    """As it is written."""


@pytest.mark.slow
@pytest.mark.parametrize("law", IN_THE_LOOP)
def test_the_loop_is_safe_with_the_template(law: str) -> None:
    getattr(type("Contract", (Line, LoopContract), {})(), law)()


def test_the_template_is_short_and_whole(tmp_path: Path) -> None:
    done = RUN.invoke(app, ["new", "transport", str(tmp_path / "mine")])
    assert done.exit_code == 0, done.output
    names = sorted(path.name for path in (tmp_path / "mine").iterdir())
    assert names == ["bench.yaml", "serial_line.py", "test_serial_line.py"]
    assert len((tmp_path / "mine" / "serial_line.py").read_text().splitlines()) <= 50
    transport = load_record(tmp_path / "mine" / "bench.yaml").transport
    assert transport.place == "transport serial_line:SerialLine"
    tests = vars(template())
    assert {name for name in tests if name.startswith("Test")} == {"TestWire", "TestLoop"}


def test_the_tutorial_shows_the_template() -> None:
    root = Path(__file__).resolve().parents[2]
    text = (root / "testing" / "templates" / "new-transport" / "serial_line.py.txt").read_text()
    assert text[text.index("class SerialLine") :] in (root / "docs" / "tutorials" / "your_hardware.md").read_text()


def test_a_template_overwrites_nothing(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "serial_line.py").write_text("months of work")
    with pytest.raises(ConfigError, match="expected a new or empty folder"):
        write_template("transport", tmp_path / "mine")
    with pytest.raises(ConfigError, match=r"unknown kind, available: controller, .*; did you mean 'transport'"):
        write_template("tranport", tmp_path / "other")


class Lossy(Udp):
    """A transport that breaks one law."""

    def __init__(self, **broken: Any) -> None:
        self.broken = broken

    @contextmanager
    def connected(self) -> Iterator[Connected]:
        with Udp.connected(self) as c:
            broken = type("Broken", (), {name: getattr(c.transport, name) for name in ("greet", "stop", "counters")})
            kept = vars(broken) | {"read": c.transport.read, "write": c.transport.write}
            made = type("Broken", (), {k: v for k, v in kept.items() if not k.startswith("__")})
            for name, make in self.broken.items():
                setattr(made, name, staticmethod(make(c.transport)))
            yield Connected(made, c.tell, c.heard)  # type: ignore[arg-type]  # as a lab's own class may be


@pytest.mark.parametrize(
    ("law", "broken"),
    [
        ("test_a_measurement_comes_once_and_as_it_was_sent", {"read": lambda t: lambda: t.read() and None}),
        (
            "test_commands_arrive_in_order_and_as_they_were_written",
            {"write": lambda t: lambda u: t.write(2.0 * u)},
        ),
        ("test_only_write_moves_the_device", {"greet": lambda t: lambda: t.write(0.0)}),
        (
            "test_after_stop_nothing_is_sent_and_stop_may_come_twice",
            {"stop": lambda t: lambda goodbye=False: None},
        ),
    ],
)
def test_a_broken_law_is_found(law: str, broken: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hystmpc.testing.wire._COMES_S", 0.5)
    contract = type("Contract", (Lossy, TransportContract), {})(**broken)
    with pytest.raises(AssertionError):
        getattr(contract, law)()
