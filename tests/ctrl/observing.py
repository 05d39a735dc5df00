"""The engine's observer by itself, with explicit state: what a controller has inside."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hystmpc.core.library import engine
from hystmpc.core.structs import layout, struct
from hystmpc.ctrl.estimation.observer import Bytes, Estimate, SensorKindSettings, read_estimate
from hystmpc.ctrl.learning.bank import BankState
from hystmpc.ctrl.learning.predictor import LearnedPredictor
from hystmpc.models.model import Predictor
from hystmpc.trials.errors import ControllerError

FILTERS = layout("hystmpc_filters")


@dataclass(frozen=True, eq=False)
class Seen:
    """A state of the observer; its estimate is read by the names of `Estimate`."""

    memory: Bytes
    watcher: Watcher

    @cached_property
    def estimate(self) -> Estimate:
        return read_estimate(self.memory, self.watcher.observer.places)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.estimate, name)

    @property
    def state(self) -> Any:
        """That from which predictions start."""
        return self.watcher.state(self)

    @property
    def model(self) -> Estimate:
        """Estimate of the model alone, where something is learned."""
        return read_estimate(self.memory[self.watcher.block :], self.watcher.observer.places)

    @property
    def learned(self) -> BankState:
        """What is learned."""
        numbers = self.memory[2 * self.watcher.block :].view(np.float64)
        size = ctypes.sizeof(FILTERS) // 8
        return BankState(numbers[size:], numbers[:size])

    @property
    def taught(self) -> BankState:
        """What late frames have taught."""
        numbers = self.memory[self.watcher.block + 8 * self.watcher.observer.places.angles :].view(np.float64)
        size = ctypes.sizeof(FILTERS) // 8
        return BankState(numbers[size:], numbers[:size])

    def copy(self) -> Seen:
        """The same state in a memory of its own, which may be changed."""
        return Seen(self.memory.copy(), self.watcher)


class Watcher:
    """Observer of a model with these settings, as a controller makes it."""

    def __init__(self, predictor: Predictor, settings: SensorKindSettings) -> None:
        learns = isinstance(predictor, LearnedPredictor)
        self.predictor = predictor.model if learns else predictor
        self.observer = settings.observer(self.predictor)
        learner = predictor.filters(self.observer.delay_samples).struct() if learns else None
        self._model = struct("hystmpc_model", predictor=self.predictor.part, learner=learner)
        self._states = int(engine().model_states(self._model.address))
        self._known = self.observer.part.address, self._model.address if self.observer.has_model else None
        self._bytes = int(engine().observing_bytes(*self._known))
        self._room = np.empty(int(engine().observing_room(*self._known)) + 64, dtype=np.uint8)
        places = self.observer.places
        row = 8 * (places.states + 3 * places.angles + 3 * places.filters)
        self.block = -(-ctypes.sizeof(layout("hystmpc_known")) // 8) * 8 + row

    @property
    def bank(self) -> Any:
        return self.observer._bank

    def init(self, y: float, u: float) -> Seen:
        memory, x = np.zeros(self._bytes, dtype=np.uint8), None
        if self.observer.has_model:
            x = np.ascontiguousarray(self.predictor.initial(y, u), dtype=np.float64)
        if engine().observing_init(*self._known, memory, x, y, u, self._room):
            raise self.observer.not_at_rest(x, y, u)
        return Seen(memory, self)

    def correct(self, seen: Seen, y: float) -> Seen:
        memory = seen.memory.copy()
        engine().observing_correct(*self._known, memory, y)
        return Seen(memory, self)

    def correct_late(self, seen: Seen, y: float, age: float) -> Seen:
        memory = seen.memory.copy()
        if not engine().observing_correct_late(*self._known, memory, y, age):
            raise ControllerError(self.observer.refused(y, age))
        return Seen(memory, self)

    def advance(self, seen: Seen, u: float) -> Seen:
        memory = seen.memory.copy()
        engine().observing_advance(*self._known, memory, u, self._room)
        return Seen(memory, self)

    def sigma_deg(self, seen: Seen) -> float:
        return self.observer.sigma_deg(seen.estimate)

    def disturbance_sigma_deg(self, seen: Seen) -> float:
        return float(self._look(seen)[0][7])

    def state(self, seen: Seen) -> Any:
        return self._look(seen)[1]

    def _look(self, seen: Seen) -> tuple[Any, Any]:
        numbers, x = np.full(10, math.nan), np.empty(self._states)
        engine().observing_look(*self._known, seen.memory, numbers, x, None, None, None, None)
        return numbers, x
