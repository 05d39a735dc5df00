"""Sessions and sequence numbers: order of messages, and exclusive access of one controller to a device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

from .transport import Says

NEW, RESTARTED, REPLAYED = "", "restarted", "replayed-or-reordered"
_HALF = 1 << 31
_REMEMBERED = 64  # sessions that have ended; what claims to come from one of them is a replay


@final
class Order:
    """Detects repeated, reordered and replayed messages; sequence numbers wrap at 2^32."""

    def __init__(self) -> None:
        self._session: int | None = None
        self._sequence = 0
        self._ended: list[int] = []
        self.lost = 0

    def numbers(self) -> Mapping[str, int]:
        """Session and sequence number of the newest message."""
        return {"session": self._session or 0, "sequence": self._sequence}

    def judge(self, session: int, sequence: int) -> str:
        """`NEW`, `RESTARTED` (new as well) or `REPLAYED`; messages that never came are added to `lost`."""
        if session == self._session:
            ahead = (sequence - self._sequence) & 0xFFFFFFFF
            if not 0 < ahead < _HALF:
                return REPLAYED
            self.lost += ahead - 1
            self._sequence = sequence
            return NEW
        if session in self._ended:
            return REPLAYED
        first = self._session is None
        if self._session is not None:
            self._ended = [*self._ended, self._session][-_REMEMBERED:]
        self._session, self._sequence = session, sequence
        return NEW if first else RESTARTED


ANOTHER, NO_GREETING, OLD = "another controller", "no greeting", "replayed-or-reordered"


@final
class Admission:
    """Exclusive access of one controller: its greeting opens a session, its goodbye or a silence frees the device.

    After a silence another greeting ends the session. What others send meanwhile is refused, whatever it is, and
    changes nothing. A session that has ended is not taken up again.

    Args:
        silence_s: how long the pinned session has to be silent before another may greet [s].
    """

    def __init__(self, silence_s: float) -> None:
        self._silence_ns = round(1e9 * silence_s)
        self._order = Order()
        self._pinned: tuple[object, int] | None = None
        self._heard_ns = 0
        self._commanded = False

    @property
    def session(self) -> int | None:
        """The session that is listened to."""
        return None if self._pinned is None else self._pinned[1]

    def admit(self, says: Says, sender: object, session: int, sequence: int, now_ns: int) -> str:
        """Reason for refusing a message, empty where it is admitted.

        The goodbye of a session that has never commanded ends the session and is refused.

        Args:
            says: what it says.
            sender: where it comes from: an address, or the writer of a topic.
            session, sequence: of the message.
            now_ns: monotonic time now [ns].
        """
        known = self._pinned == (sender, session)
        if says == "greeting":
            if not known and self._pinned is not None and now_ns - self._heard_ns <= self._silence_ns:
                return ANOTHER
        elif self._pinned is None:
            return NO_GREETING
        elif not known:
            return ANOTHER
        if self._order.judge(session, sequence) not in (NEW, RESTARTED):
            return OLD
        self._heard_ns = now_ns
        if says == "goodbye":
            self._pinned = None
            return "" if self._commanded else "goodbye without a command"
        if says == "command":
            self._commanded = True
        if says == "greeting" and not known:
            self._pinned, self._commanded = (sender, session), False
        return ""
