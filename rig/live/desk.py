"""Remote control of a run from the live page: authorisation of requests, their effect, and the replies."""

from __future__ import annotations

import hmac
import ipaddress
import json
import secrets
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from threading import Lock
from typing import Literal, final

from pydantic import Field, model_validator

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import HystmpcError

from ..safety.stop import StopFlag

E_STOP = "e-stop from the live page"

Action = Literal["estop", "stop", "start", "target"]


class LiveSettings(Settings):
    """Block `live`: the local page, and its remote control of the run.

    Attributes:
        control: whether the page has a target, Start, Stop and an e-stop; it is then served without `--page`.
        wait_for_start: whether the run waits for Start on the page before anything moves.
        host: address of the page; only this machine reaches the default.
        port: of the page; 0 takes a free one.
    """

    control: bool = False
    wait_for_start: bool = False
    host: str = "127.0.0.1"
    port: int = Field(default=8765, ge=0, le=65535)

    @model_validator(mode="after")
    def _can_be_started(self) -> LiveSettings:
        if self.wait_for_start and not self.control:
            raise ValueError("got wait_for_start without control, expected control: true")
        return self


@dataclass(frozen=True)
class Reply:
    """Reply of a run to a request: whether it is executed, and one line; a refused request changes nothing."""

    done: bool
    text: str = ""


@dataclass(frozen=True)
class Access:
    """Access token of the live page, and the range of its targets [deg]; None where no target can be set."""

    token: str
    target_deg: tuple[float, float] | None = None


# An angle [deg] to whether it is tracked from now on.
SetTarget = Callable[[float], Reply]


@final
class Desk:
    """Executor of the requests of a person at the live page: start, stop, emergency stop, targets.

    A run reads `flag` and `started` once a sample. Requests come by any thread. An e-stop is never refused.
    """

    def __init__(self, settings: LiveSettings = LiveSettings()) -> None:
        self.settings = settings
        self.flag = StopFlag()
        self.started = not settings.wait_for_start
        self._set_target: SetTarget | None = None
        self._token = secrets.token_urlsafe(24)
        self._target_deg: tuple[float, float] | None = None

    @property
    def access(self) -> Access | None:
        """Access data of the page; None for a page without control."""
        return Access(self._token, self._target_deg) if self.settings.control else None

    def take_targets(self, set_target: SetTarget, low_deg: float, high_deg: float) -> None:
        """Enable targets within a range [deg]."""
        self._set_target, self._target_deg = set_target, (low_deg, high_deg)

    def ask(self, action: str, value: float = 0.0) -> Reply:
        """Execute a request or refuse it with a reason; never raises. `value` is a target [deg]."""
        if not self.settings.control:
            return Reply(False, "the page only shows this run (live.control is false)")
        if action == "estop":
            self.flag.set(E_STOP)
            return Reply(True)
        if self.flag.cause or self.flag.ending:
            return Reply(False, "the run is ending")
        if action == "stop":
            self.flag.end()
            return Reply(True)
        if action == "start":
            if self.started:
                return Reply(False, "the run has started")
            self.started = True
            return Reply(True)
        if action != "target" or self._set_target is None:
            return Reply(False, f"this run knows no {action}")
        try:
            return self._set_target(value)
        except HystmpcError as error:
            return Reply(False, str(error))


# An action and its value to what the run says.
Ask = Callable[[str, float], Reply]

MOST_BYTES = 200
"""Of the body of a request."""

_PATHS = {"/estop": "estop", "/stop": "stop", "/start": "start", "/target": "target"}
_SCHEME = "Bearer "


@final
class Controls:
    """Authorisation of requests to the page; admitted requests go to the run. Safe for many threads.

    A request is refused without the token, from another site's page, or to a foreign host name. A foreign page can have
    its name resolve to this machine, but not a number, so only numbers and this machine's names are accepted.

    Args:
        host: the name of the page's address, where it is one.
    """

    def __init__(self, access: Access, ask: Ask, host: str = "") -> None:
        self.access, self._ask = access, ask
        self._names = {host.lower(), "localhost", socket.gethostname().lower()} - {""}
        self._one = Lock()  # at a time, but for the e-stop, which waits for nobody

    @staticmethod
    def is_estop(path: str) -> bool:
        """Whether a path is that of the emergency stop."""
        return _PATHS.get(path) == "estop"

    def refusal(self, path: str, headers: Mapping[str, str], body: bytes) -> tuple[HTTPStatus, str] | None:
        """Reason for refusing a request: a status and one line; None if it is admitted. Never waits."""
        said = {name.lower(): value for name, value in headers.items()}
        action = _PATHS.get(path)
        if not self._is_ours(said.get("host", "")):
            return HTTPStatus.MISDIRECTED_REQUEST, "unknown host"
        if not _same_origin(said):
            return HTTPStatus.FORBIDDEN, "only the page itself may ask"
        if not self._carries_token(said.get("authorization", "")):
            return HTTPStatus.FORBIDDEN, "wrong token: open the address that the terminal shows"
        if action is None:
            return HTTPStatus.NOT_FOUND, "no such request"
        if action == "target" and _angle(body) is None:
            return HTTPStatus.BAD_REQUEST, 'expected {"deg": a number}'
        return None

    def take(self, path: str, headers: Mapping[str, str], body: bytes) -> tuple[HTTPStatus, str]:
        """Answer an HTTP request with this path, headers (any case) and body; wait for the reply of the run."""
        if refused := self.refusal(path, headers, body):
            return refused
        if self.is_estop(path):
            return _http(self._ask("estop", 0.0))
        value = _angle(body) or 0.0
        with self._one:
            return _http(self._ask(_PATHS[path], value))

    def _is_ours(self, host: str) -> bool:
        """Whether the host of a request is certainly this machine: a number, or one of its names."""
        name = host.rpartition(":")[0] if ":" in host and not host.endswith("]") else host
        try:
            ipaddress.ip_address(name.strip("[]"))
        except ValueError:
            return name.lower() in self._names
        return True

    def _carries_token(self, authorization: str) -> bool:
        wanted = (_SCHEME + self.access.token).encode()
        return hmac.compare_digest(authorization.encode(errors="replace"), wanted)


def _http(said: Reply) -> tuple[HTTPStatus, str]:
    return (HTTPStatus.OK if said.done else HTTPStatus.CONFLICT), said.text


def _same_origin(said: Mapping[str, str]) -> bool:
    """Whether a request does not come from another site's page; programs send no origin, and need the token alone."""
    origin, site = said.get("origin"), said.get("sec-fetch-site", "same-origin")
    return site == "same-origin" and origin in (None, f"http://{said.get('host', '')}")


def _angle(body: bytes) -> float | None:
    try:
        data = json.loads(body)
    except (ValueError, RecursionError):
        return None
    value = data.get("deg") if isinstance(data, dict) else None
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9 else None
