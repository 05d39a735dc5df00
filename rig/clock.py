"""Time as the loop knows it: a monotonic clock with absolute deadlines."""

from __future__ import annotations

import time
from typing import Protocol, final

_BOOT: int | None = getattr(time, "CLOCK_BOOTTIME", None)  # Linux


class Clock(Protocol):
    """Where time comes from."""

    def now_ns(self) -> int:
        """Monotonic time [ns]."""
        ...

    def boot_ns(self) -> int:
        """Monotonic time that also counts while the machine is suspended [ns]."""
        ...

    def wall_ns(self) -> int:
        """Wall clock [ns since 1970], for the log only: it may jump."""
        ...

    def wait_until(self, deadline_ns: int) -> None:
        """Return at the deadline or, where it has passed, at once."""
        ...


@final
class MonotonicClock:
    """The system's monotonic clock: sleep to shortly before the deadline, then spin.

    Args:
        spin_s: how long before the deadline sleeping ends [s]; 0 never spins.
    """

    def __init__(self, spin_s: float = 0.0005) -> None:
        self._spin_ns = round(1e9 * spin_s)

    def now_ns(self) -> int:
        """Monotonic time [ns]."""
        return time.monotonic_ns()

    def boot_ns(self) -> int:
        """Monotonic time with suspension [ns]; the monotonic time itself where the system has no such clock."""
        return time.monotonic_ns() if _BOOT is None else time.clock_gettime_ns(_BOOT)

    def wall_ns(self) -> int:
        """Wall clock [ns since 1970]."""
        return time.time_ns()

    def wait_until(self, deadline_ns: int) -> None:
        """Sleep, then spin; the rest of the time is computed anew after every sleep, so no error adds up."""
        while (left := deadline_ns - time.monotonic_ns()) > self._spin_ns:
            time.sleep(1e-9 * (left - self._spin_ns))
        while time.monotonic_ns() < deadline_ns:
            pass
