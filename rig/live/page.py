"""Live page: one HTML file, a stream of server-sent events, and their HTTP server in one thread."""

from __future__ import annotations

import asyncio
import json
import math
import socket
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from http import HTTPStatus
from importlib.resources import files
from typing import Any, final

from hystmpc.trials.errors import ConfigError

from ..axes import NAMES, PerAxis, each
from ..transports.udp import is_loopback
from .desk import MOST_BYTES, Controls
from .state import LiveState, LiveView

_MOST_CLIENTS = 200  # beyond it, the oldest connection without a stream is closed
_LEAST_CLIENTS = 16
_BACKLOG = 1024  # pending connections in the system; a further one would retry after a second
_AT_ONCE = 64  # connections accepted in a row before requests are served
_MOST_STREAMS = 12
_MOST_REQUESTS = 8  # authorised requests in progress, without e-stops
_LARGEST_HEAD = 16_384  # bytes of a request before its body
_ASKS_S = 1.5  # time limit for the arrival of a request
_TAKES_S = 5.0  # time limit for the transfer of an answer or message
_SILENCE_S = 2.0  # idle time before a comment is sent, which detects lost clients
_CLOSE_S = 2.0
_MOST_BEHIND = 65_536  # greatest number of bytes after a request
_UNSENT = 65_536  # backlog [bytes] above which a stream gets no further message
_END = b"event: end\ndata: \n\n"  # otherwise a browser assumes a broken connection
_SECURE = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "connect-src 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Connection": "close",
}
_ONCE = ("host", "authorization", "content-length", "origin", "sec-fetch-site")


class BadRequestError(Exception):
    """A malformed HTTP request; its argument is the status."""


@final
class PageServer:
    """HTTP server of one page, a stream of messages, and requests to `controls`; None for no remote control."""

    def __init__(self, page: bytes, controls: Controls | None) -> None:
        self.page, self.controls = page, controls
        self.latest = b""
        self.allowed: frozenset[str] = frozenset()
        self.waiting = 0  # requests passed to the run by a thread
        self.clients: dict[_Client, None] = {}  # in the order of their arrival
        self.streams: set[_Client] = set()
        self._loop = asyncio.new_event_loop()
        self._ended = asyncio.Event()
        self._thread = threading.Thread(target=self._work, name="hystmpc-page", daemon=True)

    def listen(self, host: str, port: int) -> tuple[str, int]:
        """Start the server and return address and port."""
        self._socket = socket.create_server((host, port), backlog=_BACKLOG)
        where = self._socket.getsockname()
        self.allowed = _hosts(host, where[1])
        self._thread.start()
        return str(where[0]), int(where[1])

    def publish(self, message: bytes) -> None:
        """Send a message to every stream without a backlog; callable from any thread."""
        self.latest = b"data: " + message + b"\n\n"
        self.call(self._publish)

    def call(self, function: object, *arguments: object) -> None:
        """Call a function in the server's thread; no effect after its end."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(function, *arguments)  # type: ignore[arg-type]

    def close(self) -> None:
        """End the streams and stop listening; a second call has no effect."""
        if self._thread.is_alive():
            self.call(self._ended.set)
            self._thread.join(2 * _CLOSE_S)

    def admit(self, client: _Client) -> None:
        """Accept a connection; beyond the limit the oldest idle connection is aborted."""
        self.clients[client] = None
        if len(self.clients) > _most_clients():
            oldest = next((one for one in self.clients if one not in self.streams and not one.asks), client)
            self.leave(oldest)  # at once, since its callback comes later
            oldest.abort()

    def leave(self, client: _Client) -> None:
        """Remove a connection that has ended."""
        self.clients.pop(client, None)
        self.streams.discard(client)

    def _work(self) -> None:
        with suppress(RuntimeError):
            self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        server = await self._loop.create_server(lambda: _Client(self), sock=self._socket, backlog=_AT_ONCE)
        self._socket.listen(_BACKLOG)  # asyncio takes one number for both
        while not self._ended.is_set():
            with suppress(TimeoutError):
                await asyncio.wait_for(self._ended.wait(), _SILENCE_S)
            for stream in list(self.streams):
                stream.send(b": waiting\n\n")
        server.close()
        for stream in list(self.streams):
            stream.finish(_END)
        end = self._loop.time() + _CLOSE_S
        while self.streams and self._loop.time() < end:
            await asyncio.sleep(0.01)
        for client in list(self.clients):
            client.abort()
        await asyncio.sleep(0)

    def _publish(self) -> None:
        for stream in list(self.streams):
            stream.send(self.latest)


@final
class _Client(asyncio.Protocol):
    def __init__(self, server: PageServer) -> None:
        self._server = server
        self._got = bytearray()
        self._head: tuple[str, str, dict[str, str]] | None = None  # method, path, headers by name in lower case
        self._length = 0
        self._behind = 0  # bytes after the request
        self._answered = False
        self.asks = False  # whether the request was passed to the run

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        transport.set_write_buffer_limits(high=_UNSENT)
        self._timer = self._later(_ASKS_S)
        self._server.admit(self)

    def connection_lost(self, exc: Exception | None) -> None:
        del exc
        self._timer.cancel()
        self._server.leave(self)

    def data_received(self, data: bytes) -> None:
        if self._answered or self.asks:
            self._behind += len(data)
            if self._behind > _MOST_BEHIND:
                self.abort()
            return
        self._got += data
        try:
            if self._complete():
                self._do()
        except BadRequestError as error:
            self.answer(error.args[0], "")

    def abort(self) -> None:
        self._transport.abort()

    def answer(self, status: HTTPStatus, text: str) -> None:
        self._answer(status, "text/plain; charset=utf-8", text.encode())

    def send(self, message: bytes) -> None:
        """Write to a stream; a client with a backlog is skipped, and disconnected after a time limit."""
        if self._transport.get_write_buffer_size() > _UNSENT // 2:
            return
        self._timer.cancel()
        self._timer = self._later(_TAKES_S)
        self._transport.write(message)

    def finish(self, last: bytes = b"") -> None:
        """Write the last bytes; the connection ends when the client has read them, or after a time limit."""
        self._answered = True
        self._timer.cancel()
        self._timer = self._later(_TAKES_S)
        self._transport.write(last)
        with suppress(OSError, RuntimeError):
            self._transport.write_eof()

    def _later(self, seconds: float) -> asyncio.TimerHandle:
        return asyncio.get_running_loop().call_later(seconds, self.abort)

    def _complete(self) -> bool:
        """Whether the whole request has arrived; `BadRequestError` if it is malformed or too long."""
        if self._head is None:
            head, blank, rest = bytes(self._got).partition(b"\r\n\r\n")
            if len(head) > _LARGEST_HEAD:
                raise BadRequestError(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
            if not blank:
                return False
            self._head = _parsed(head)
            self._length = _length(self._head[2])
            self._got = bytearray(rest)
        return len(self._got) >= self._length

    def _do(self) -> None:
        assert self._head is not None
        method, path, headers = self._head
        server = self._server
        if method == "GET":
            if server.allowed and headers.get("host", "").lower() not in server.allowed:
                # a foreign page whose name resolves to this machine must not read the stream
                self.answer(HTTPStatus.MISDIRECTED_REQUEST, "unknown host")
            elif path == "/":
                self._answer(HTTPStatus.OK, "text/html; charset=utf-8", server.page)
            elif path == "/events":
                self._watch()
            else:
                self.answer(HTTPStatus.NOT_FOUND, "nothing here")
        elif method != "POST" or server.controls is None:
            self.answer(HTTPStatus.NOT_IMPLEMENTED, "this page only shows")
        else:
            self._ask(server.controls, path, headers, bytes(self._got[: self._length]))

    def _ask(self, controls: Controls, path: str, headers: Mapping[str, str], body: bytes) -> None:
        """Forward an admitted request to the run in a separate thread, since the reply may take seconds."""
        server = self._server
        if refused := controls.refusal(path, headers, body):
            self.answer(*refused)
            return
        emergency = controls.is_estop(path)
        if not emergency and server.waiting >= _MOST_REQUESTS:
            self.answer(HTTPStatus.SERVICE_UNAVAILABLE, "the run has not answered earlier requests")
            return
        self.asks = True
        self._timer.cancel()
        server.waiting += not emergency

        def ask() -> None:
            status, text = controls.take(path, headers, body)
            server.call(reply, status, text)

        def reply(status: HTTPStatus, text: str) -> None:
            server.waiting -= not emergency
            self.asks = False
            self.answer(status, text)

        threading.Thread(target=ask, name="hystmpc-page-request", daemon=True).start()

    def _watch(self) -> None:
        """Start a stream if the limit on their number allows it."""
        if len(self._server.streams) >= _MOST_STREAMS:
            self.answer(HTTPStatus.SERVICE_UNAVAILABLE, "too many pages are open")
            return
        self._answered = True
        self._server.streams.add(self)
        self.send(_head(HTTPStatus.OK, "text/event-stream", None) + self._server.latest)

    def _answer(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.finish(_head(status, kind, len(body)) + body)


def _parsed(head: bytes) -> tuple[str, str, dict[str, str]]:
    """Method, path and headers of a request; `BadRequestError` if malformed or an identity or length is repeated."""
    first, *lines = head.decode("latin-1").split("\r\n")
    words = first.split(" ")
    if len(words) != 3 or not words[2].startswith("HTTP/1."):
        raise BadRequestError(HTTPStatus.BAD_REQUEST)
    headers: dict[str, str] = {}
    for line in lines:
        name, colon, value = line.partition(":")
        name = name.lower()
        if not colon or not name or name != name.strip() or (name in headers and name in _ONCE):
            raise BadRequestError(HTTPStatus.BAD_REQUEST)
        headers[name] = value.strip()
    return words[0], words[1], headers


def _length(headers: Mapping[str, str]) -> int:
    """Length of the body [bytes]; `BadRequestError` if it is no decimal number, or larger than any valid request."""
    if "transfer-encoding" in headers:
        raise BadRequestError(HTTPStatus.LENGTH_REQUIRED)
    text = headers.get("content-length", "0")
    if not (text.isascii() and text.isdigit()):
        raise BadRequestError(HTTPStatus.BAD_REQUEST)
    if len(text) > 10 or int(text) > MOST_BYTES:
        raise BadRequestError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
    return int(text)


def _head(status: HTTPStatus, kind: str, length: int | None) -> bytes:
    fields = {"Content-Type": kind, **({} if length is None else {"Content-Length": str(length)}), **_SECURE}
    lines = [f"HTTP/1.1 {status.value} {status.phrase}", *(f"{name}: {value}" for name, value in fields.items())]
    return "\r\n".join([*lines, "", ""]).encode("latin-1")


def _most_clients() -> int:
    """Limit of simultaneous connections, far below the number of files that this process may open."""
    if sys.platform == "win32":
        return _MOST_CLIENTS
    import resource

    files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return _MOST_CLIENTS if files < 0 else min(_MOST_CLIENTS, max(_LEAST_CLIENTS, files // 4))


def _hosts(host: str, port: int) -> frozenset[str]:
    """Host names of a page on the loopback; empty for other addresses, for which any name is accepted."""
    names = (host.lower(), "127.0.0.1", "localhost", "[::1]") if is_loopback(host) else ()
    return frozenset(f"{name}:{port}" for name in names)


@final
class LivePage(LiveView):
    """Live view for browsers; all input except authorised requests to `controls` is ignored.

    Args:
        host: address of the page; the loopback, unless others are to see it.
        port: 0 takes a free one.
        controls: takes requests; without them the page only shows.

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
        self._server = PageServer(_page(controls).encode(), controls)
        super().__init__(rate_hz)
        try:
            self._where = self._server.listen(host, port)
        except (OSError, OverflowError) as error:
            super().close()
            reason = getattr(error, "strerror", None) or error
            raise ConfigError(
                f"live page: cannot listen on {host} port {port} ({reason}), expected a free port"
            ) from None

    @property
    def address(self) -> str:
        """URL of the page; the token is in the fragment, which browsers do not send."""
        host, port = self._where
        token = "" if self._controls is None else f"#{self._controls.access.token}"
        return f"http://{host}:{port}/{token}"

    def close(self) -> None:
        super().close()
        self._server.close()

    def _show(self, state: LiveState) -> None:
        self._server.publish(json.dumps(message(state, self._unit, self._rate_hz), allow_nan=False).encode())


def message(state: LiveState, unit: str, rate_hz: float) -> dict[str, Any]:
    """Message to the browsers: figures, and the curves of the last 20 s.

    Of two axes figures are lists, and each axis has a curve: `angle_x`, `angle_y`.
    """
    last = state.last
    timings = {}
    for name, histogram in (("late", state.late), ("work", state.total)):
        figures = histogram.summary()
        counts = histogram.counts.reshape(50, -1).sum(axis=1).tolist()
        timings[name] = {
            "counts": counts,
            "median_ms": _number(1e3 * figures.median_s),
            "p99_ms": _number(1e3 * figures.p99_s),
            "greatest_ms": _number(1e3 * figures.greatest_s),
        }
    curves = {"t": state.t}
    for name, values in (("reference", state.reference), ("angle", state.angle), ("command", state.command)):
        several = {f"{name}_{axis}": column for axis, column in zip(NAMES, values.T, strict=False)}
        curves |= {name: values} if values.ndim == 1 else several
    return {
        "unit": unit,
        "rate_hz": rate_hz,
        "real_rate_hz": _number(state.rate_hz),
        "t_s": _number(last.t_s),
        "angle_deg": _figures(last.measured_deg),
        "reference_deg": _figures(last.reference_deg),
        "rms_deg": _number(state.rms_deg),
        "command": _figures(last.command),
        "source": str(last.source),
        "status": str(last.status),
        "missed": state.missed,
        "faults": [[str(k), count, _number(last.t_s - state.fault_s[k])] for k, count in state.faults.items()],
        "notes": list(state.notes),
        "timing": timings,
        "curves": {name: [_number(value) for value in values.tolist()] for name, values in curves.items()},
    }


def _figures(value: PerAxis) -> float | list[float | None] | None:
    """Number of one axis, or list of both."""
    numbers = [_number(one) for one in each(value)]
    return numbers[0] if len(numbers) == 1 else numbers


def _number(value: float) -> float | None:
    return round(value, 5) if math.isfinite(value) else None


def _page(controls: Controls | None) -> str:
    """Page with its scripts; buttons without an effect are hidden."""
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
