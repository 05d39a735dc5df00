"""A transport from outside the package, kept at arm's length: it may raise, hang or talk nonsense, the loop goes on."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import replace
from numbers import Integral, Real
from queue import SimpleQueue
from threading import Thread
from typing import Any, TypeVar, final

from hystmpc.trials.errors import ConfigError

from .transport import Reading, RunContext, Transport

METHODS = ("read", "write", "greet", "stop")
"""What a transport has to have, beside `counters`."""

PATIENCE_S = 0.1  # of a call; a transport returns at once
_OPENS_S = 10.0  # a drive that initialises
_CLOSES_S = 1.0

T = TypeVar("T")


@final
class Worker:
    """A thread in which a foreign object is made and called; a call that hangs holds up nobody else."""

    def __init__(self, name: str) -> None:
        self._calls: SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = SimpleQueue()
        self._newest: Future[Any] | None = None
        Thread(target=self._work, name=name, daemon=True).start()

    def call(self, function: Callable[[], T], patience_s: float) -> T:
        """What the function returns or raises; `TimeoutError` where it, or the call before, does not come back."""
        if self._newest is not None and not self._newest.done():
            raise TimeoutError("it still hangs in the call before")
        future = self._newest = self._put(function)
        try:
            return future.result(patience_s)
        except TimeoutError:
            if future.done():  # its own
                raise
            raise TimeoutError(f"it has not come back within {patience_s:g} s") from None

    def last(self, function: Callable[[], object], then: Callable[[], T], patience_s: float) -> Future[T]:
        """The last two calls; they come after one that hangs, and the thread ends. Waits for the first of them."""
        future, second = self._put(function), self._put(then)
        self._put(_end)
        future.result(patience_s)
        return second

    def _put(self, function: Callable[[], T]) -> Future[T]:
        future: Future[T] = Future()
        self._calls.put((future, function))
        return future

    def _work(self) -> None:
        while True:
            future, function = self._calls.get()
            if function is _end:
                return
            try:
                future.set_result(function())
            except Exception as error:  # noqa: BLE001 - handed to whoever called
                future.set_exception(error)
            except BaseException as error:  # noqa: BLE001 - a driver must not end the program beside a moving device
                future.set_exception(OSError(f"it raised {type(error).__name__}"))


def _end() -> None:
    """Ends the thread."""


@final
class GuardedTransport(Transport):
    """A transport from outside the package, made and called in a thread of its own.

    A call that does not come back within 0.1 s raises; until it does come back, every other call raises at once. So a
    wire that hangs looks like one that is silent, and the run ends by the loop's own rules. What `read` returns is
    checked, counted where it is no measurement, and converted from the units of the block `wire`.

    Args:
        make: makes the transport.
        name: of it, in messages.

    Raises:
        ConfigError: if it cannot be made within 10 s, or lacks what a transport has.
    """

    def __init__(self, make: Callable[[], Any], name: str, run: RunContext) -> None:
        self._conversion, self._now = run.conversion, run.now_ns
        self._counters: Counter[str] = Counter()
        self._worker, self._open = Worker(name), True
        self._at_end: Future[dict[str, int]] = Future()  # what it has counted when it was closed
        try:
            self._device = self._worker.call(make, _OPENS_S)
            counts = self._worker.call(lambda: hasattr(self._device, "counters"), PATIENCE_S)
        except Exception as error:  # noqa: BLE001 - a device's driver may raise anything
            raise ConfigError(f"transport {name}: cannot be opened ({_said(error)})") from None
        missing = lacking(self._device) or ([] if counts else ["counters"])
        if missing:
            raise ConfigError(f"transport {name}: {lacks(missing)}")

    @property
    def counters(self) -> Mapping[str, int]:
        counted = Counter(self._counters)
        try:
            told = self._worker.call(self._told, PATIENCE_S) if self._open else self._at_end.result(PATIENCE_S)
            counted.update(told)
        except Exception:  # noqa: BLE001 - as above; what it has counted is only told
            counted["counters cannot be read"] += 1
        return counted

    def _told(self) -> dict[str, int]:
        return {str(cause): int(n) for cause, n in dict(self._device.counters).items()}

    def read(self) -> Reading | None:
        found = self._call("read", lambda: self._device.read())
        if found is None:
            return None
        if fault := nonsense(found, self._now()):
            self._counters[fault] += 1
            raise ValueError(fault)
        angle, held = self._conversion.angle_deg(float(found.angle_deg)), self._conversion.command(float(found.held))
        return replace(found, angle_deg=angle, held=held)

    def write(self, command: float) -> None:
        raw = self._conversion.raw_command(command)
        self._call("write", lambda: self._device.write(raw))

    def greet(self) -> None:
        """Ask the device to listen, where it knows such a thing."""
        self._call("greet", lambda: self._device.greet())

    def stop(self, goodbye: bool = False) -> None:
        """Close, once; a transport that hangs is closed when it comes back."""
        if self._open:
            self._open = False
            self._at_end = self._worker.last(lambda: self._device.stop(goodbye), self._told, _CLOSES_S)

    def _call(self, name: str, function: Callable[[], T]) -> T:
        if not self._open:
            raise OSError("the transport is closed")
        try:
            return self._worker.call(function, PATIENCE_S)
        except Exception as error:
            self._counters[f"{name} raised {type(error).__name__}"] += 1
            raise


def lacking(device: object) -> list[str]:
    """Methods that a transport, or its class, lacks; those that it only inherits from the protocol are none."""
    kind = device if isinstance(device, type) else type(device)
    inherited = [name for name in METHODS if getattr(kind, name, None) is getattr(Transport, name)]
    return [name for name in METHODS if name in inherited or not callable(getattr(device, name, None))]


def lacks(missing: list[str]) -> str:
    """The end of an error line."""
    return f"lacks {', '.join(missing)}, expected the methods {', '.join(METHODS)} and the mapping counters"


def nonsense(found: object, now_ns: int) -> str:
    """Why something that `read` returned is no measurement, empty where it is one.

    Args:
        found: what was returned, not None.
        now_ns: this process's monotonic clock [ns].
    """
    if not isinstance(found, Reading):
        return f"read returned {type(found).__name__}, expected Reading or None"
    numbers = {"angle_deg": Real, "held": Real, "sequence": Integral, "sent_ns": Integral, "received_ns": Integral}
    for name, kind in numbers.items():
        value = getattr(found, name)
        if not isinstance(value, kind) or math.isinf(value):
            return f"read returned no number as {name}"
    if not isinstance(found.session, Integral):
        return "read returned no number as session"
    return "received_ns lies ahead, expected time.monotonic_ns()" if found.received_ns > now_ns else ""


def _said(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
