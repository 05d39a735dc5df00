"""A measurement card whose driver waits for the next sample: a thread of its own waits, `read` takes what is there."""

import math
from collections import deque
from importlib import import_module
from threading import Event, Thread
from typing import Protocol

from hystmpc.rig import Reading


class Driver(Protocol):
    """What is used of the card's own driver; nidaqmx: one sample of a hardware-timed task, one on-demand output."""

    def read_next(self) -> tuple[int, float]: ...  # waits; sample number, volts of the angle sensor
    def put(self, volts: float) -> None: ...  # returns at once
    def close(self) -> None: ...  # ends a `read_next` that waits, with an error


class Card:
    def __init__(self, driver: str | Driver, deg_per_volt: float = 9.0, mm_per_volt: float = 0.6) -> None:
        module, _, name = driver.partition(":") if isinstance(driver, str) else ("", "", "")
        self._driver: Driver = getattr(import_module(module), name)() if isinstance(driver, str) else driver
        self._deg, self._mm = deg_per_volt, mm_per_volt
        self._got: deque[Reading] = deque(maxlen=1000)
        self.counters, self._over, self._fault = {"waits that failed": 0}, Event(), ""
        Thread(target=self._wait, daemon=True).start()

    def _wait(self) -> None:
        while not self._over.is_set():
            try:
                number, volts = self._driver.read_next()
                self._got.append(Reading.now(self._deg * volts, number, math.nan))  # a card does not tell what it holds
            except Exception as error:  # noqa: BLE001 - a driver may raise anything
                self.counters["waits that failed"] += 1
                self._fault = str(error)
                self._over.wait(0.01)

    def read(self) -> Reading | None:
        if not self._got and self._fault:
            fault, self._fault = self._fault, ""
            raise OSError(fault)
        return self._got.popleft() if self._got else None

    def write(self, command: float) -> None:
        if self._over.is_set():
            raise OSError("the card is closed")
        self._driver.put(command / self._mm)

    def greet(self) -> None:
        pass  # a card always listens

    def stop(self, goodbye: bool = False) -> None:  # noqa: ARG002 - a card knows no goodbye
        if not self._over.is_set():
            self._over.set()
            self._driver.close()
