"""Requests to the live page: who may ask, in which words, and what the browser is told."""

from __future__ import annotations

import hmac
import ipaddress
import json
import socket
from collections.abc import Callable, Mapping
from http import HTTPStatus
from threading import Lock
from typing import final

from .desk import Access, Answer

# An action and its value to what the run says.
Ask = Callable[[str, float], Answer]

MOST_BYTES = 200
"""Of the body of a request."""

_PATHS = {"/estop": "estop", "/stop": "stop", "/start": "start", "/target": "target"}
_SCHEME = "Bearer "


@final
class Controls:
    """Judges each request and hands those that may pass to the run; used by many threads.

    Nothing is done for a request that does not carry the token, that another site's page has made, or that was sent to
    a foreign name. A foreign page can have its own name point here, but not a number, so only numbers and this
    machine's own names are taken.

    Args:
        access: what a request has to carry.
        ask: hands a request to the run.
        host: the name that the page is served on, where it is one.
    """

    def __init__(self, access: Access, ask: Ask, host: str = "") -> None:
        self.access, self._ask = access, ask
        self._names = {host.lower(), "localhost", socket.gethostname().lower()} - {""}
        self._one = Lock()  # at a time, but for the e-stop, which waits for nobody

    @staticmethod
    def is_estop(path: str) -> bool:
        """Whether a path is that of the e-stop."""
        return _PATHS.get(path) == "estop"

    def refusal(self, path: str, headers: Mapping[str, str], body: bytes) -> tuple[HTTPStatus, str] | None:
        """Why the run is not asked: a status and one line; None where it is. Waits for nobody."""
        said = {name.lower(): value for name, value in headers.items()}
        action = _PATHS.get(path)
        if not self._is_ours(said.get("host", "")):
            return HTTPStatus.MISDIRECTED_REQUEST, "unknown host"
        if not _from_own_page(said):
            return HTTPStatus.FORBIDDEN, "only the page itself may ask"
        if not self._carries_token(said.get("authorization", "")):
            return HTTPStatus.FORBIDDEN, "wrong token: open the address that the terminal shows"
        if action is None:
            return HTTPStatus.NOT_FOUND, "no such request"
        if action == "target" and _angle(body) is None:
            return HTTPStatus.BAD_REQUEST, 'expected {"deg": a number}'
        return None

    def take(self, path: str, headers: Mapping[str, str], body: bytes) -> tuple[HTTPStatus, str]:
        """What to answer to a request of this path, headers (any case) and body: a status and one line.

        It waits for the run's answer.
        """
        if refused := self.refusal(path, headers, body):
            return refused
        if self.is_estop(path):
            return _answer(self._ask("estop", 0.0))
        value = _angle(body) or 0.0
        with self._one:
            return _answer(self._ask(_PATHS[path], value))

    def _is_ours(self, host: str) -> bool:
        """Whether a browser that asks this host asks us for certain: a number, or a name of this machine."""
        name = host.rpartition(":")[0] if ":" in host and not host.endswith("]") else host
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return name.lower() in self._names
        return True

    def _carries_token(self, authorization: str) -> bool:
        wanted = (_SCHEME + self.access.token).encode()
        return hmac.compare_digest(authorization.encode(errors="replace"), wanted)


def _answer(said: Answer) -> tuple[HTTPStatus, str]:
    return (HTTPStatus.OK if said.done else HTTPStatus.CONFLICT), said.text


def _from_own_page(said: Mapping[str, str]) -> bool:
    """Whether no other site's page has made the request; programs say nothing of it, and need the token alone."""
    origin, site = said.get("origin"), said.get("sec-fetch-site", "same-origin")
    return site == "same-origin" and origin in (None, f"http://{said.get('host', '')}")


def _angle(body: bytes) -> float | None:
    """The angle of a target [deg], None where there is none."""
    try:
        found = json.loads(body)
    except (ValueError, RecursionError):
        return None
    value = found.get("deg") if isinstance(found, dict) else None
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9 else None
