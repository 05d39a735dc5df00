"""The live views: what is shown is what happened, and whatever a browser sends changes nothing."""

from __future__ import annotations

import contextlib
import http.client
import io
import json
import math
import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from hystmpc.rig.live.page import LivePage, message
from hystmpc.rig.live.state import WINDOW_S, LiveState
from hystmpc.rig.live.terminal import TerminalView, bar, columns_of, curves, headline, limits_of, raster
from hystmpc.trials.errors import ConfigError

from .recording_samples import sample

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
RATE = 100.0


def state(count: int, **changes) -> LiveState:
    found = LiveState(RATE)
    found.update(sample(k, RATE, **changes) for k in range(count))
    return found


def test_figures_are_those_of_the_run() -> None:
    live = LiveState(RATE)
    live.update(
        sample(k, RATE, faults=("frozen",) if k in (5, 7) else (), missed=k == 9, lateness_s=1e-3 * (k % 4))
        for k in range(3000)
    )
    shown = live
    assert shown.last == sample(2999, RATE, lateness_s=3e-3)
    assert (shown.missed, shown.faults, shown.fault_s) == (1, {"frozen": 2}, {"frozen": 0.07})
    assert shown.rate_hz == pytest.approx(RATE)
    window = [sample(k, RATE) for k in range(1000, 3000)]
    error = np.array([s.reference_deg - s.measured_deg for s in window])
    assert shown.rms_deg == pytest.approx(np.sqrt(np.mean(error**2)))
    assert shown.t[0] == pytest.approx(10.0, abs=0.03)
    assert shown.t[-1] - shown.t[0] <= WINDOW_S
    assert shown.late.summary().greatest_s == 3e-3
    assert shown.late.counts.sum() == 3000


@given(first=st.integers(1, 2500), more=st.integers(1, 300))
@settings(max_examples=20)
def test_a_point_once_shown_stays_where_it_was(first: int, more: int) -> None:
    """The plot is thinned out; thinning that began anew at every update would make it flicker."""
    live = state(first)
    before = live.t
    live.update(sample(k, RATE) for k in range(first, first + more))
    kept = before[before >= live.t[0]] if live.t.size else before[:0]
    np.testing.assert_array_equal(kept, live.t[: kept.size])


def test_without_a_sample_nothing_is_shown() -> None:
    assert not LiveState(RATE).update(())
    with pytest.raises(ConfigError, match="rate of 0"):
        LiveState(0)


@given(st.lists(st.floats(), min_size=1, max_size=40), st.integers(1, 30), st.integers(1, 8))
def test_a_curve_is_drawn_inside_its_field(values: list[float], width: int, height: int) -> None:
    y = np.array(values)
    low, high = limits_of(y, least_span=1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        text = curves([(raster(np.arange(y.size), y, low, high, width, height), "red")]).plain
    assert [len(line) for line in text.split("\n")] == [width] * height


@given(st.floats(), st.integers(1, 40))
def test_a_bar_is_as_wide_as_asked(value: float, width: int) -> None:
    assert len(bar(value, 0.0, 5.0, width)) == width


def test_curves_bars_and_histograms_show_what_they_should() -> None:
    up = raster(np.arange(10.0), np.arange(10.0), 0.0, 9.0, 5, 2)
    assert up[1, 0] > 0
    assert up[0, 4] > 0
    assert up[0, 0] == 0
    assert bar(2.5, 0, 5, 10) == "█████·····"
    assert columns_of(np.array([0, 9, 0, 1]), 4)[::2] == "  "
    assert columns_of(np.array([0, 9, 0, 1]), 4)[1] == "█"


def view(width: int = 110, **changes) -> str:
    """The terminal view after 5 s of a run, as text."""
    out = io.StringIO()
    terminal = TerminalView("mm", RATE, "http://127.0.0.1:1/", Console(file=out, force_terminal=True, width=width))
    for k in range(500):
        terminal.put(sample(k, RATE, **changes))
    terminal.tell("the disk is full")
    terminal.close()
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", out.getvalue())


def test_the_terminal_shows_what_a_person_at_a_bench_looks_for() -> None:
    text = view(faults=("frozen",), missed=True, source="hold", measured_deg=math.nan)
    for part in (
        "HOLD",
        "angle      --",
        "frozen ×500",
        "deadlines missed 500",
        "the disk is full",
        "127.0.0.1:1",
        "mm",
    ):
        assert part in text
    assert "faults  none" in view()


@pytest.mark.parametrize("width", [20, 40, 80, 300])
def test_the_terminal_may_be_narrow_or_wide(width: int) -> None:
    assert max(map(len, view(width).splitlines())) <= width


def test_an_angle_without_a_reference_is_no_fault() -> None:
    shown = state(3, reference_deg=math.nan)
    text = headline(shown, "mm").plain
    assert "reference      --" in text
    assert "no angle" not in text
    assert "nan" not in text


def test_the_terminal_names_its_curves() -> None:
    assert "━ reference  ━ measured angle" in view()


def test_without_a_terminal_it_says_so_in_plain_lines() -> None:
    out = io.StringIO()
    terminal = TerminalView("bar", RATE, console=Console(file=out, width=200))
    terminal.put(sample(0, RATE))
    terminal.close()
    shown = state(1)
    assert out.getvalue().strip() == headline(shown, "bar").plain.strip()


@pytest.fixture
def page() -> Iterator[LivePage]:
    served = LivePage("mm", RATE, port=0)
    for k in range(300):
        served.put(sample(k, RATE, measured_deg=math.nan if k == 299 else 30.0))
    yield served
    served.close()


def ask(page: LivePage, method: str, path: str, **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection(urlsplit(page.address).netloc, timeout=5)
    connection.request(method, path, headers=headers)
    return connection.getresponse()


def first_event(page: LivePage) -> dict:
    answer = ask(page, "GET", "/events")
    for _ in range(20):
        line = answer.readline()
        if line.startswith(b"data: "):
            return json.loads(line[6:])
    raise AssertionError("no event")


def test_a_browser_is_told_that_the_run_has_ended(page: LivePage) -> None:
    answer = ask(page, "GET", "/events")
    answer.readline()
    page.close()
    assert answer.read().decode().endswith("event: end\ndata: \n\n")


def test_the_page_gets_figures_and_curves(page: LivePage) -> None:
    found = first_event(page)
    assert (found["unit"], found["source"], found["t_s"], found["angle_deg"]) == ("mm", "mpc", 2.99, None)
    assert len(found["curves"]["t"]) == len(found["curves"]["angle"]) == 150
    answer = ask(page, "GET", "/")
    text = answer.read().decode()
    assert answer.status == 200
    assert "connect-src 'self'" in str(answer.getheader("Content-Security-Policy"))
    shown = state(3)
    used = set(re.findall(r"\bm\.(\w+)", text))
    assert used <= set(message(shown, "mm", RATE))


def test_the_page_needs_nothing_from_elsewhere() -> None:
    text = files("hystmpc.rig.live").joinpath("page.html").read_text(encoding="utf-8")
    assert re.findall(r"(?:src|href)=|https?://|@import|url\(|innerHTML", text) == []


def test_it_listens_on_this_machine_only(page: LivePage) -> None:
    assert urlsplit(page.address).hostname == "127.0.0.1"
    with pytest.raises(ConfigError, match=r"cannot listen on 127\.0\.0\.1 port"):
        LivePage("mm", RATE, port=int(urlsplit(page.address).port or 0))
    with pytest.raises(ConfigError, match="cannot listen"):
        LivePage("mm", RATE, port=70_000)


def test_a_name_of_another_site_is_turned_away(page: LivePage) -> None:
    """A foreign page could have its own name point to this machine and read along otherwise."""
    for path in ("/", "/events"):
        assert ask(page, "GET", path, Host="evil.example").status == 421


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "PATCH", "X" * 2000])
def test_nothing_can_be_sent_to_it(page: LivePage, method: str) -> None:
    assert ask(page, method, "/").status in (400, 414, 501)


@pytest.mark.parametrize("path", ["/../page.py", "/events/", "/%2e%2e/", "/?a=1", "/events?x"])
def test_there_is_nothing_else_to_get(page: LivePage, path: str) -> None:
    assert ask(page, "GET", path).status == 404


@settings(max_examples=30)
@given(
    data=st.one_of(
        st.binary(max_size=300), st.binary(max_size=200).map(lambda b: b"GET / HTTP/1.1\r\n" + b + b"\r\n\r\n")
    )
)
def test_rubbish_changes_nothing(data: bytes, rubbish_page: LivePage) -> None:
    where = urlsplit(rubbish_page.address)
    with socket.create_connection((str(where.hostname), int(where.port or 0)), timeout=5) as client:
        client.sendall(data)
    assert ask(rubbish_page, "GET", "/").status == 200


@pytest.fixture(scope="module")
def rubbish_page() -> Iterator[LivePage]:
    served = LivePage("mm", RATE, port=0)
    yield served
    served.close()


def test_clients_that_say_nothing_do_not_pile_up(page: LivePage) -> None:
    where = urlsplit(page.address)
    idle = [socket.create_connection((str(where.hostname), int(where.port or 0)), timeout=5) for _ in range(40)]
    try:
        refused = 0
        for client in idle[-8:]:
            client.settimeout(2)
            try:
                refused += client.recv(1) == b""
            except OSError as error:
                refused += isinstance(error, ConnectionError)
        assert refused == 8
    finally:
        for client in idle:
            client.close()


IN_A_TERMINAL = """
import sys
from hystmpc.rig.recording.recorder_process import Views, open_recorder_process
from hystmpc.rig.recording.recording import RecordingMeta
from tests.rig.recording_samples import sample

sink = open_recorder_process(sys.argv[1], {}, RecordingMeta("mm"), 100.0, Views(terminal=True, page=True, port=0))
for k in range(200):
    sink.put(sample(k))
sink.close()
print(sink.on_disk, sink.dropped, sink.page)
"""


@pytest.mark.slow
def test_views_of_the_recording_process_draw_on_the_terminal_and_do_not_disturb_it(tmp_path: Path) -> None:
    ours, theirs = os.openpty()
    command = [sys.executable, "-c", IN_A_TERMINAL, str(tmp_path / "run")]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=theirs, text=True)
    os.close(theirs)
    drawn = b""
    with contextlib.suppress(OSError):  # what reading a terminal ends with when nobody holds its other side
        while part := os.read(ours, 65536):
            drawn += part
    os.close(ours)
    said, _ = process.communicate()
    assert re.fullmatch(r"200 0 http://127\.0\.0\.1:\d+/\n", said)
    assert "MPC" in drawn.decode()
    assert "faults  none" in drawn.decode()
    assert "on_disk" not in drawn.decode()
