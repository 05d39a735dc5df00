"""Transports from outside the package, called in a separate thread: they may raise, hang or return nonsense."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from numbers import Integral, Real
from queue import SimpleQueue
from threading import Thread
from typing import Any, ClassVar, Literal, TypeVar, final

import numpy as np
from pydantic import ConfigDict, Field, PrivateAttr

from hystmpc.trials.errors import ConfigError
from hystmpc.trials.from_outside import MODULE_AND_CLASS, class_named, made_by

from ..safety.stop import cause_of
from .transport import Reading, RunContext, Transport, TransportBase

METHODS = ("read", "write", "greet", "stop")
"""What a transport has to have, beside `counters`."""

PATIENCE_S = 0.1  # of a call; a transport returns at once
_OPENS_S = 10.0  # a drive that initialises
_CLOSES_S = 1.0
_AT_ONCE, _AT_ONCE_NS = 64, 1_000_000  # readings fetched in one call, and for how long another one is begun
_WHOLE = 1 << 63  # bound of whole numbers: stamps are int64, and a difference of two still is a number

T = TypeVar("T")


@final
class Worker:
    """Thread that creates and calls an external object, so that a blocking call delays no other thread."""

    def __init__(self, name: str) -> None:
        self._calls: SimpleQueue[tuple[Future[Any], Callable[[], Any]]] = SimpleQueue()
        self._newest: Future[Any] | None = None
        Thread(target=self._work, name=name, daemon=True).start()

    @property
    def idle(self) -> bool:
        """Whether no call is blocked."""
        return self._newest is None or self._newest.done()

    def call(self, function: Callable[[], T], patience_s: float) -> T:
        """Result or exception of the function; `TimeoutError` if this or the previous call does not return in time."""
        if not self.idle:
            raise TimeoutError("it still hangs in the call before")
        future = self._newest = self._put(function)
        try:
            return future.result(patience_s)
        except TimeoutError:
            if future.done():  # its own
                raise
            raise TimeoutError(f"it has not come back within {patience_s:g} s") from None

    def last(self, function: Callable[[], object], then: Callable[[], T], patience_s: float) -> Future[T]:
        """Queue the last two calls and end the thread after them; wait for the first one."""
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
    """Signal the end of the thread."""


@final
class GuardedTransport(Transport):
    """Transport from outside the package, created and called in a separate thread.

    A call without a result within 0.1 s raises; until it returns, every other call raises at once. A blocked wire thus
    looks like a silent one, and the run ends by the loop's own rules. The results of `read` are checked, counted where
    they are no measurement, and converted from the units of the block `wire`.

    Readings are fetched several at a time, since a thread's answer takes longer than most drivers do. Those of a late
    call are kept; after them the wire is left to a command before it is read again.

    Raises:
        ConfigError: if it cannot be made within 10 s, or lacks methods of a transport.
    """

    def __init__(self, make: Callable[[], Any], name: str, run: RunContext) -> None:
        self._conversion, self._now = run.conversion, run.now_ns
        self._counters: Counter[str] = Counter()
        self._worker, self._open = Worker(name), True
        self._fetched: deque[Any] = deque()  # fetched and not yet read: readings, whatever they are, and errors
        self._late = False
        self._final: Future[dict[str, int]] = Future()  # what it has counted when it was closed
        try:
            self._device = self._worker.call(make, _OPENS_S)
            counts = self._worker.call(lambda: hasattr(self._device, "counters"), PATIENCE_S)
        except Exception as error:  # noqa: BLE001 - a device's driver may raise anything
            raise ConfigError(f"transport {name}: cannot be opened ({cause_of(error)})") from None
        missing = missing_methods(self._device) or ([] if counts else ["counters"])
        if missing:
            raise ConfigError(f"transport {name}: {missing_text(missing)}")

    @property
    def counters(self) -> Mapping[str, int]:
        counted = Counter(self._counters)
        try:
            counts = self._worker.call(self._counts, PATIENCE_S) if self._open else self._final.result(PATIENCE_S)
            counted.update(counts)
        except Exception:  # noqa: BLE001 - as above; what it has counted is only told
            counted["counters cannot be read"] += 1
        return counted

    def _counts(self) -> dict[str, int]:
        return {str(cause): int(n) for cause, n in dict(self._device.counters).items()}

    def read(self) -> Reading | None:
        if not self._fetched:
            if self._late and self._open and self._worker.idle:
                self._late = False
                return None
            try:
                self._call("read", self._fetch)
            except TimeoutError:
                self._late = True
                raise
            if not self._fetched:
                return None
        item = self._fetched.popleft()
        if isinstance(item, Exception):
            self._counters[f"read raised {type(item).__name__}"] += 1
            raise item
        if fault := reading_fault(item, self._now()):
            self._counters[fault] += 1
            raise ValueError(fault)
        return self._converted(item)

    def _fetch(self) -> None:
        """Read the available measurements in the device's thread; a later error is queued behind them."""
        until, count = self._now() + _AT_ONCE_NS, 0
        while count < _AT_ONCE and (not count or self._now() < until):
            try:
                item = self._device.read()
            except Exception as error:
                if not count:
                    raise
                item = error
            if item is None:
                return
            self._fetched.append(item)
            count += 1

    def _converted(self, raw: Reading) -> Reading:
        """Reading in Python numbers and the run's units."""
        reading = Reading(
            self._conversion.angle_deg(float(raw.angle_deg)),
            int(raw.sequence),
            int(raw.session),
            int(raw.sent_ns),
            int(raw.received_ns),
            self._conversion.command(float(raw.held)),
            bool(raw.listens),
        )
        for name in ("angle_deg", "held"):
            if math.isinf(getattr(reading, name)):
                self._counters[fault := f"read returned no number as {name} in the units of the run"] += 1
                raise ValueError(fault)
        return reading

    def write(self, command: float) -> None:
        raw = self._conversion.raw_command(command)
        self._call("write", lambda: self._device.write(raw))

    def greet(self) -> None:
        """Ask the device to listen if its class supports it."""
        self._call("greet", lambda: self._device.greet())

    def stop(self, goodbye: bool = False) -> None:
        """Close the transport once; a blocked transport is closed after its call returns."""
        if self._open:
            self._open = False
            self._final = self._worker.last(lambda: self._device.stop(goodbye), self._counts, _CLOSES_S)

    def _call(self, name: str, function: Callable[[], T]) -> T:
        if not self._open:
            raise OSError("the transport is closed")
        try:
            return self._worker.call(function, PATIENCE_S)
        except Exception as error:
            self._counters[f"{name} raised {type(error).__name__}"] += 1
            raise


def missing_methods(device: object) -> list[str]:
    """Names of the transport methods that an object or class does not define; the protocol's do not count."""
    kind = device if isinstance(device, type) else type(device)
    inherited = [name for name in METHODS if getattr(kind, name, None) is getattr(Transport, name)]
    return [name for name in METHODS if name in inherited or not callable(getattr(device, name, None))]


def missing_text(missing: list[str]) -> str:
    """End of an error line on missing methods."""
    return f"lacks {', '.join(missing)}, expected the methods {', '.join(METHODS)} and the mapping counters"


def reading_fault(value: object, now_ns: int) -> str:
    """Reason why a value returned by `read` is no measurement; empty if it is one.

    Args:
        value: what was returned, not None.
        now_ns: this process's monotonic clock [ns].
    """
    if not isinstance(value, Reading):
        return f"read returned {type(value).__name__}, expected Reading or None"
    for name in ("angle_deg", "held"):
        if not _is_number(getattr(value, name)):
            return f"read returned no number as {name}"
    for name in ("sequence", "session", "sent_ns", "received_ns"):
        if not _is_whole(getattr(value, name)):
            return f"read returned no whole number as {name}"
    if not isinstance(value.listens, bool | np.bool_):
        return f"read returned {type(value.listens).__name__} as listens, expected a bool"
    return "received_ns lies ahead, expected time.monotonic_ns()" if value.received_ns > now_ns else ""


def _is_number(value: object) -> bool:
    """Whether the value is a real number or not-a-number, which a sensor may return."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and not math.isinf(float(value))
    except OverflowError:
        return False


def _is_whole(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool) and -_WHOLE <= int(value) < 2 * _WHOLE


GROUP = "hystmpc.transports"
"""Entry points by which an installed package makes `kind: NAME` known; the value is MODULE:CLASS."""


class PythonSettings(TransportBase):
    """Transport `python: MODULE:CLASS`: a class of the user; every further key is a keyword argument of it.

    Attributes:
        kind: of this block; may be left out.
        python: module and class, such as `mylab.bus:Bus`, of an installed package or of the working folder.
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="allow")  # `open` checks the arguments against the class

    kind: Literal["python"] = "python"
    python: str = Field(pattern=MODULE_AND_CLASS)
    _instance: Transport | None = PrivateAttr(None)

    @classmethod
    def of(cls, transport: Transport) -> PythonSettings:
        """Settings of an existing transport object."""
        settings = cls(python=f"{type(transport).__module__}:{type(transport).__name__}")
        settings._instance = transport
        return settings

    @property
    def place(self) -> str:
        return f"transport {self.python}"

    def open(self, run: RunContext) -> Transport:
        if self._instance is not None:
            instance = self._instance
            return GuardedTransport(lambda: instance, self.python, run)
        return GuardedTransport(self._make(), self.python, run)

    def _make(self) -> Callable[[], Any]:
        """Factory of the transport, after checks of class, methods and arguments."""
        kind = class_named(self.python, "transport", GROUP, object)
        if missing := missing_methods(kind):
            raise ConfigError(f"transport {self.python}: {missing_text(missing)}")
        return made_by(kind, dict(self.model_extra or {}), f"transport {self.python}")
