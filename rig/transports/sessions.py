"""Sessions and sequence numbers: which messages are new, and which controller a device listens to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

NEW, RESTARTED, REPLAYED = "", "restarted", "replayed-or-reordered"
_HALF = 1 << 31
_REMEMBERED = 64  # sessions that have ended; what claims to come from one of them is a replay


@final
class Order:
    """Tells new messages from repeated, reordered and replayed ones; sequence numbers wrap at 2^32."""

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
    """A session is pinned by its greeting, and dropped by its goodbye or by the greeting of another after a silence.

    What others send meanwhile is refused, whatever it is, and changes nothing. A session that has ended is not taken up
    again. Every method answers with the reason of a refusal, empty where the message is admitted.

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

    def greeting(self, sender: object, session: int, sequence: int, now_ns: int) -> str:
        """A controller asks to be listened to.

        Args:
            sender: where the message comes from: an address, or the writer of a topic.
            session, sequence: of the message.
            now_ns: monotonic time now [ns].
        """
        known = self._pinned == (sender, session)
        if not known and self._pinned is not None and now_ns - self._heard_ns <= self._silence_ns:
            return ANOTHER
        if reason := self._in_order(session, sequence, now_ns):
            return reason
        if not known:
            self._pinned, self._commanded = (sender, session), False
        return ""

    def command(self, sender: object, session: int, sequence: int, now_ns: int) -> str:
        """A controller commands; arguments as for `greeting`."""
        if reason := self._pinned_only(sender, session) or self._in_order(session, sequence, now_ns):
            return reason
        self._commanded = True
        return ""

    def goodbye(self, sender: object, session: int, sequence: int, now_ns: int) -> str:
        """A controller leaves; refused for a session that has never commanded. Arguments as for `greeting`."""
        if reason := self._pinned_only(sender, session) or self._in_order(session, sequence, now_ns):
            return reason
        self._pinned = None
        return "" if self._commanded else "goodbye without a command"

    def _pinned_only(self, sender: object, session: int) -> str:
        if self._pinned is None:
            return NO_GREETING
        return "" if self._pinned == (sender, session) else ANOTHER

    def _in_order(self, session: int, sequence: int, now_ns: int) -> str:
        if self._order.judge(session, sequence) not in (NEW, RESTARTED):
            return OLD
        self._heard_ns = now_ns
        return ""
