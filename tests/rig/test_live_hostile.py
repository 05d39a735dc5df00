"""Whatever is connected to the live page and whatever it says, an e-stop is heard; nothing of it fills memory."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from urllib.parse import urlsplit

import pytest

from hystmpc.rig.live import page as live_page
from hystmpc.rig.live.desk import MOST_BYTES, Controls, Desk, Reply
from hystmpc.rig.live.page import LivePage

from .test_live_control import CONTROL, Heard, post

LONG_S = 60.0
HOSTILE = {
    "say nothing": b"",
    "begin a request": b"POST /estop HTTP/1.1\r\nHost: 127.",
    "begin a body": b"POST /stop HTTP/1.1\r\nHost: HOST\r\nContent-Length: 100\r\n\r\n{",
    "never read the stream": b"GET /events HTTP/1.1\r\nHost: HOST\r\n\r\n",
    "never read the page": b"GET / HTTP/1.1\r\nHost: HOST\r\n\r\n",
    "send rubbish": b"\x00" * 100_000,
    "send a long head": b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 10_000,
    "ask without the token": b"POST /estop HTTP/1.1\r\nHost: HOST\r\n\r\n",
}


@dataclass
class Served:
    """A page, where it is, and what came through it."""

    page: LivePage
    heard: Heard

    @property
    def where(self) -> tuple[str, int]:
        place = urlsplit(self.page.address)
        return str(place.hostname), int(place.port or 0)

    def connected(self, said: bytes = b"") -> socket.socket:
        client = socket.create_connection(self.where, timeout=10)
        with suppress(OSError):  # the page may end it before all is sent
            client.sendall(said.replace(b"HOST", f"{self.where[0]}:{self.where[1]}".encode()))
        return client


@pytest.fixture
def served() -> Iterator[Served]:
    access, heard = Desk(CONTROL).access, Heard()
    assert access is not None
    page = LivePage("mm", 100.0, port=0, controls=Controls(access, heard.ask))
    yield Served(page, heard)
    page.close()


@pytest.mark.parametrize("kind", HOSTILE)
def test_an_e_stop_is_heard_beside_any_number_of_other_connections(
    kind: str, served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More than the page keeps; none of them is given up for the time that it takes."""
    monkeypatch.setattr(live_page, "_ASKS_S", LONG_S)
    monkeypatch.setattr(live_page, "_TAKES_S", LONG_S)
    others = [served.connected(HOSTILE[kind]) for _ in range(live_page._MOST_CLIENTS + 50)]
    try:
        for _ in range(3):
            assert post(served.page.address, "/estop") == (200, "done")
        assert served.heard.asked == [("estop", 0.0)] * 3
    finally:
        for other in others:
            other.close()


def test_the_page_keeps_far_fewer_connections_than_it_may_open_files(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    resource = pytest.importorskip("resource")
    monkeypatch.setattr(resource, "getrlimit", lambda which: (100, 100))
    assert live_page._most_clients() == 25
    monkeypatch.setattr(live_page, "_ASKS_S", LONG_S)
    others = [served.connected() for _ in range(60)]
    assert post(served.page.address, "/estop") == (200, "done")
    assert len(served.page._server.clients) <= 25
    for other in others:
        other.close()


def test_a_request_that_drips_has_no_more_time_than_one_that_does_not_come(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_page, "_ASKS_S", 0.2)
    sent = 0
    with served.connected() as client, suppress(OSError):
        while sent < 500:
            client.sendall(b"G")
            sent += 1
            time.sleep(0.02)
    assert 0 < sent < 500
    assert served.heard.asked == []


def test_a_viewer_that_takes_nothing_fills_no_memory_and_is_given_up(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_page, "_TAKES_S", 0.5)
    message = b"x" * 20_000
    with (
        served.connected(HOSTILE["never read the stream"]) as idle,
        served.connected(HOSTILE["never read the stream"]) as reads,
    ):
        end, most = time.monotonic() + 10.0, 0
        while time.monotonic() < end and len(served.page._server.streams) != 1:
            served.page._server.publish(message)
            reads.recv(1 << 20)
            for stream in list(served.page._server.streams):
                most = max(most, stream._transport.get_write_buffer_size())
        assert len(served.page._server.streams) == 1, "one reads, the other is given up"
        assert most <= live_page._UNSENT + len(message)
        assert idle.fileno() >= 0


BODIES = {
    "-1": 400,
    "+5": 400,
    "0x5": 400,
    "5 5": 400,
    "5,5": 400,
    "": 400,
    "\u0665".encode().decode("latin-1"): 400,
    "1e3": 400,
    "\xb2": 400,  # a digit to Python, and no number
    str(MOST_BYTES + 1): 413,
    "9" * 400: 413,
    "18446744073709551615": 413,
}


@pytest.mark.parametrize("length", BODIES)
def test_a_body_of_any_other_length_is_refused_without_being_read(length: str, served: Served) -> None:
    assert said(served, f"Content-Length: {length}") == BODIES[length]


@pytest.mark.parametrize(
    ("lines", "status"),
    [
        ("Transfer-Encoding: chunked", 411),
        ("Transfer-Encoding: identity\r\nContent-Length: 3", 411),
        ("Content-Length: 3\r\nContent-Length: 3", 400),
        ("Content-Length : 3", 400),
        ("Authorization: Bearer x", 400),
        ("Host: evil.example", 400),
        ("no colon", 400),
    ],
)
def test_a_request_that_two_readers_would_read_otherwise_is_refused(lines: str, status: int, served: Served) -> None:
    assert said(served, lines) == status


def test_a_head_is_kept_up_to_a_length(served: Served) -> None:
    with served.connected(b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * (live_page._LARGEST_HEAD // 6 + 1)) as client:
        assert b" 431 " in client.recv(100)


def said(served: Served, lines: str) -> int:
    """The status of an e-stop with the token and further lines in its head; no body follows."""
    token = urlsplit(served.page.address).fragment
    head = f"POST /estop HTTP/1.1\r\nHost: HOST\r\nAuthorization: Bearer {token}\r\n{lines}\r\n\r\n"
    with served.connected(head.encode("latin-1")) as client:
        answer = client.recv(100)
    assert served.heard.asked == []
    return int(answer.split()[1])


def test_a_body_of_the_greatest_length_is_read_whole_however_it_comes(served: Served) -> None:
    token, body = urlsplit(served.page.address).fragment, b'{"deg": 41.5}'.ljust(MOST_BYTES)
    head = (
        f"POST /target HTTP/1.1\r\nHost: HOST\r\nAuthorization: Bearer {token}\r\nContent-Length: {MOST_BYTES}\r\n\r\n"
    )
    with served.connected(head.encode()) as client:
        for k in range(0, MOST_BYTES, 50):
            client.sendall(body[k : k + 50])
            time.sleep(0.005)
        assert b"200 OK" in client.recv(100)
    assert served.heard.asked == [("target", 41.5)]


def test_requests_that_wait_for_the_run_are_few_and_keep_no_e_stop_out(monkeypatch: pytest.MonkeyPatch) -> None:
    free, got = threading.Event(), list[str]()

    def ask(action: str, value: float) -> Reply:
        got.append(action)
        if action != "estop":
            free.wait(10)
        return Reply(True)

    access = Desk(CONTROL).access
    assert access is not None
    page = LivePage("mm", 100.0, port=0, controls=Controls(access, ask))
    token = urlsplit(page.address).fragment
    world = Served(page, Heard())
    asked = f"POST /stop HTTP/1.1\r\nHost: HOST\r\nAuthorization: Bearer {token}\r\n\r\n".encode()
    try:
        waiting = [world.connected(asked) for _ in range(live_page._MOST_REQUESTS)]
        end = time.monotonic() + 5
        while page._server.waiting < live_page._MOST_REQUESTS and time.monotonic() < end:
            time.sleep(0.001)
        with world.connected(asked) as more:
            assert b" 503 " in more.recv(100)
        assert post(page.address, "/estop")[0] == 200
        free.set()
        assert [b" 200 " in client.recv(100) for client in waiting] == [True] * len(waiting)
        assert page._server.waiting == 0
    finally:
        free.set()
        page.close()
