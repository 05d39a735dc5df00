"""The local page: one HTML file and a stream of server-sent events, for this machine only unless told otherwise."""

from __future__ import annotations

import ipaddress
import json
import math
import threading
from collections.abc import Iterable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any, final

from hystmpc.trials.errors import ConfigError

from .controls import MOST_BYTES, Controls
from .state import LiveSnapshot, LiveView

_MOST_CLIENTS = 16  # more are turned away: a page is for the people at the bench
_MOST_STREAMS = 12  # of them, so that those who only look never keep a request out
_PATIENCE_S = 5.0  # for a client that sends or takes nothing
_SILENCE_S = 2.0  # after which an idle stream gets a comment, so that a client that left is noticed
_POLL_S = 0.1  # how soon `close` is noticed
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}


@final
class LivePage(LiveView):
    """Serves what the run does to browsers; nothing that a browser sends is taken in, but requests to `controls`.

    Args:
        host: address to listen on; the loopback, unless others are to see the page.
        port: 0 takes a free one.
        controls: takes requests; None, and the page only shows.

    Raises:
        ConfigError: if the address cannot be used, or the rate is not positive.
    """

    def __init__(
        self,
        unit: str,
        rate_hz: float,
        host: str = "127.0.0.1",
        port: int = 8765,
        controls: Controls | None = None,
    ) -> None:
        self._unit, self._rate_hz, self._controls = unit, rate_hz, controls
        self._latest = _Latest()
        super().__init__(rate_hz)
        try:
            self._server = _Server((host, port), self._latest, controls)
        except (OSError, OverflowError) as error:
            super().close()
            reason = getattr(error, "strerror", None) or error
            raise ConfigError(
                f"live page: cannot listen on {host} port {port} ({reason}), expected a free port"
            ) from None
        self._listener = threading.Thread(
            target=self._server.serve_forever, args=(_POLL_S,), name="hystmpc-page", daemon=True
        )
        self._listener.start()

    @property
    def address(self) -> str:
        """What to open in a browser; with the token, which browsers keep to themselves, where it takes requests."""
        host, port = self._server.server_address[:2]
        token = "" if self._controls is None else f"#{self._controls.access.token}"
        return f"http://{host!s}:{port}/{token}"

    def close(self) -> None:
        """Send the last state and stop listening."""
        super().close()
        self._latest.end()
        self._server.shutdown()
        self._server.server_close()

    def _show(self, snapshot: LiveSnapshot) -> None:
        self._latest.publish(json.dumps(message(snapshot, self._unit, self._rate_hz), allow_nan=False).encode())


def message(snapshot: LiveSnapshot, unit: str, rate_hz: float) -> dict[str, Any]:
    """What a browser gets: figures, and the curves of the last 20 s."""
    last = snapshot.last
    timings = {}
    for name, histogram in (("late", snapshot.late), ("work", snapshot.total)):
        figures = histogram.summary()
        counts = histogram.counts.reshape(50, -1).sum(axis=1).tolist()
        timings[name] = {
            "counts": counts,
            "median_ms": _number(1e3 * figures.median_s),
            "p99_ms": _number(1e3 * figures.p99_s),
            "greatest_ms": _number(1e3 * figures.greatest_s),
        }
    curves = {"t": snapshot.t, "reference": snapshot.reference, "angle": snapshot.angle, "command": snapshot.command}
    return {
        "unit": unit,
        "rate_hz": rate_hz,
        "real_rate_hz": _number(snapshot.rate_hz),
        "t_s": _number(last.t_s),
        "angle_deg": _number(last.measured_deg),
        "reference_deg": _number(last.reference_deg),
        "rms_deg": _number(snapshot.rms_deg),
        "command": _number(last.command),
        "source": str(last.source),
        "status": str(last.status),
        "missed": snapshot.missed,
        "faults": [[str(k), count, _number(last.t_s - snapshot.fault_s[k])] for k, count in snapshot.faults.items()],
        "notes": list(snapshot.notes),
        "timing": timings,
        "curves": {name: [_number(value) for value in values.tolist()] for name, values in curves.items()},
    }


def _number(value: float) -> float | None:
    return round(value, 5) if math.isfinite(value) else None


class _Latest:
    """The newest message, and a way to wait for the next one."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._number, self._message, self.ended = 0, b"", False

    def publish(self, text: bytes) -> None:
        with self._condition:
            self._number, self._message = self._number + 1, text
            self._condition.notify_all()

    def end(self) -> None:
        with self._condition:
            self.ended = True
            self._condition.notify_all()

    def after(self, number: int) -> tuple[int, bytes]:
        """Number and text of a message newer than `number`; the same number where none came within a while."""
        with self._condition:
            self._condition.wait_for(lambda: self._number > number or self.ended, _SILENCE_S)
            return self._number, self._message


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = 64
    block_on_close = False

    def __init__(self, address: tuple[str, int], latest: _Latest, controls: Controls | None) -> None:
        self.latest, self.controls = latest, controls
        self.page = _page(controls).encode()
        self.streams = threading.BoundedSemaphore(_MOST_STREAMS)
        self._clients = threading.BoundedSemaphore(_MOST_CLIENTS)
        super().__init__(address, _Handler)
        self.allowed = _hosts(address[0], self.server_address[1])

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._clients.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._clients.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that breaks off or sends rubbish is nobody's concern."""


class _Handler(BaseHTTPRequestHandler):
    server_version, sys_version = "hystmpc", ""
    timeout = _PATIENCE_S

    @property
    def _page(self) -> _Server:
        assert isinstance(self.server, _Server)
        return self.server

    def do_GET(self) -> None:
        if self._page.allowed and self.headers.get("Host", "").lower() not in self._page.allowed:
            self.send_error(421, "unknown host")  # a foreign page that has its own name point here must not read along
        elif self.path == "/":
            self._begin("text/html; charset=utf-8", len(self._page.page))
            self.wfile.write(self._page.page)
        elif self.path == "/events":
            self._watched()
        else:
            self.send_error(404)

    def do_POST(self) -> None:
        controls = self._page.controls
        if controls is None:
            self.send_error(501, "this page only shows")
            return
        length = self.headers.get("Content-Length", "0")
        body = self.rfile.read(int(length)) if length.isdecimal() and int(length) <= MOST_BYTES else b""
        status, text = controls.take(self.path, dict(self.headers.items()), body)
        answer = text.encode()
        self._begin("text/plain; charset=utf-8", len(answer), status)
        self.wfile.write(answer)

    def _watched(self) -> None:
        """The stream, where there are not too many."""
        if not self._page.streams.acquire(blocking=False):
            self.send_error(503, "too many pages are open")
            return
        try:
            self._stream()
        finally:
            self._page.streams.release()

    def _stream(self) -> None:
        self._begin("text/event-stream", None)
        number = 0
        while not self._page.latest.ended:
            number = self._send(number)
        self._send(number)
        self.wfile.write(b"event: end\ndata: \n\n")  # else a browser would take the end for a broken connection

    def _send(self, number: int) -> int:
        """A message newer than `number`, or a comment; returns its number."""
        newest, text = self._page.latest.after(number)
        self.wfile.write(b"data: " + text + b"\n\n" if newest > number else b": waiting\n\n")
        return newest

    def _begin(self, kind: str, length: int | None, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        if length is not None:
            self.send_header("Content-Length", str(length))
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Nothing: the terminal belongs to the run."""


def _page(controls: Controls | None) -> str:
    """The page with its scripts; buttons are shown where they do something."""
    here = files("hystmpc.rig.live")
    parts = {"link.js": here.joinpath("link.js"), "zoom.js": files("hystmpc.trials").joinpath("zoom.js")}
    text = here.joinpath("page.html").read_text(encoding="utf-8")
    for name, part in parts.items():
        text = text.replace(f"/* {name} */", part.read_text(encoding="utf-8"))
    return text if controls is None else text.replace("<body>", _body(controls.access.target_deg))


def _body(target_deg: tuple[float, float] | None) -> str:
    ends = {} if target_deg is None else dict(zip(("low", "high"), map(_number, target_deg), strict=True))
    data = "".join(f' data-{name}="{value}"' for name, value in ends.items() if value is not None)
    return f'<body class="control{"" if target_deg is None else " target"}"{data}>'


def _hosts(host: str, port: int) -> frozenset[str]:
    """What a browser on this machine calls a page on the loopback; empty, any name will do, for other addresses."""
    try:
        is_loopback = host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        is_loopback = False
    names: Iterable[str] = (host.lower(), "127.0.0.1", "localhost", "[::1]") if is_loopback else ()
    return frozenset(f"{name}:{port}" for name in names)
