"""What somebody at the live page may ask of a run, and what the run answers."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, final

from pydantic import Field, model_validator

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import HystmpcError

from ..safety.stop import StopFlag

E_STOP = "e-stop from the live page"

Action = Literal["estop", "stop", "start", "target"]


class LiveSettings(Settings):
    """Block `live`: the local page, and what may be asked of the run from it.

    Attributes:
        control: whether the page has a target, Start, Stop and an e-stop; it is then served without `--page`.
        wait_for_start: whether the run waits for Start on the page before anything moves.
        host: address that the page is served on; only this machine reaches the default.
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
class Answer:
    """What a run says to a request.

    Attributes:
        done: whether it does as asked; nothing has changed where it does not.
        text: one line, empty where there is nothing to say.
    """

    done: bool
    text: str = ""


@dataclass(frozen=True)
class Access:
    """What a page has to know to take requests.

    Attributes:
        token: what a request has to carry.
        target_deg: least and greatest angle that the model reaches [deg]; None where no target can be set.
    """

    token: str
    target_deg: tuple[float, float] | None = None


# An angle [deg] to whether it is tracked from now on.
SetTarget = Callable[[float], Answer]


@final
class Desk:
    """Takes the requests of one run; of a run without one, nothing can be asked.

    A run looks at `flag` and `started` once a sample. Requests come by any thread. An e-stop is never refused.

    Args:
        settings: of the page.
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
        """What the page has to know, None where nothing may be asked."""
        return Access(self._token, self._target_deg) if self.settings.control else None

    def take_targets(self, set_target: SetTarget, low_deg: float, high_deg: float) -> None:
        """Let targets be set; the page shows the range [deg]."""
        self._set_target, self._target_deg = set_target, (low_deg, high_deg)

    def ask(self, action: str, value: float = 0.0) -> Answer:
        """Do as asked, or say why not; never raises.

        Args:
            action: an `Action`.
            value: of a target [deg].
        """
        if not self.settings.control:
            return Answer(False, "the page only shows this run (live.control is false)")
        if action == "estop":
            self.flag.set(E_STOP)
            return Answer(True)
        if self.flag.cause or self.flag.ending:
            return Answer(False, "the run is ending")
        if action == "stop":
            self.flag.end()
            return Answer(True)
        if action == "start":
            if self.started:
                return Answer(False, "the run has started")
            self.started = True
            return Answer(True)
        if action != "target" or self._set_target is None:
            return Answer(False, f"this run knows no {action}")
        try:
            return self._set_target(value)
        except HystmpcError as error:
            return Answer(False, str(error))
