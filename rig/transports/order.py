"""Which messages of a sender are new: sessions and sequence numbers."""

from __future__ import annotations

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
