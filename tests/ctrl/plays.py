"""The one list of models that the controllers' tests run over: small exact ones, a compiled one, broken ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hystmpc.ctrl.learning.bank import FILTERS, BankState
from hystmpc.models.chain import Chain
from hystmpc.models.contract.metadata import Range
from hystmpc.models.model import Inverse, Predictor
from hystmpc.models.operators import dynamics as operators
from hystmpc.models.operators.dynamics import Delay
from hystmpc.models.operators.prandtl_ishlinskii import PrandtlIshlinskii
from hystmpc.models.prediction.build import controller_model
from hystmpc.models.simulator import ChainModel, Identification, Simulator
from hystmpc.trials.types import Vec

DT = 0.04


@dataclass(frozen=True)
class Backlash(Predictor):
    """y = max(m_up (u + c_up), min(m_lo (u + c_lo), y_prev)); values of the tendon catheter (S2)."""

    m_lo: float = 10.27
    m_up: float = 10.70
    c_lo: float = 2.822
    c_up: float = 2.003
    dt: float = DT
    command_range: tuple[float, float] = (0.0, 6.0)

    def initial(self, y: float, u: float) -> Vec:
        del u
        return np.array([y])

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        y = max(self.m_up * (u + self.c_up), min(self.m_lo * (u + self.c_lo), float(state[0])))
        return y, np.array([y])

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        angles = np.empty_like(plans)
        y = np.full(plans.shape[0], float(state[0]))
        for k in range(plans.shape[1]):
            u = plans[:, k]
            y = np.maximum(self.m_up * (u + self.c_up), np.minimum(self.m_lo * (u + self.c_lo), y))
            angles[:, k] = y
        return angles

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        angles, jacobian = np.empty(plan.size), np.zeros((plan.size, plan.size))
        y, row = float(state[0]), np.zeros(plan.size)
        for k, u in enumerate(plan):
            up, lo = self.m_up * (u + self.c_up), self.m_lo * (u + self.c_lo)
            if up >= min(lo, y):
                y, row = up, self.m_up * np.eye(plan.size)[k]
            elif lo <= y:
                y, row = lo, self.m_lo * np.eye(plan.size)[k]
            angles[k], jacobian[k] = y, row
        return angles, jacobian

    def width(self, u: float) -> float:
        """Command travel across the dead band, downwards from the loading line at `u`."""
        return u - (self.m_up * (u + self.c_up) / self.m_lo - self.c_lo)


@dataclass(frozen=True)
class BacklashInverse(Inverse):
    """The whole interval of commands that give the angle, or its ends where the angle has to move."""

    model: Backlash

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        m, y = self.model, float(state[0])
        up, lo = theta / m.m_up - m.c_up, theta / m.m_lo - m.c_lo
        if abs(theta - y) < 1e-9:
            return min(max(u_last, lo), up)
        return up if theta > y else lo


@dataclass(frozen=True)
class Lag(Predictor):
    """y+ = a y + (1 - a) (g u + b): a straight line behind a first-order lag."""

    a: float = 0.6
    g: float = 10.0
    b: float = 20.0
    dt: float = DT
    command_range: tuple[float, float] = (0.0, 6.0)

    def initial(self, y: float, u: float) -> Vec:
        del u
        return np.array([y])

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        y = self.a * float(state[0]) + (1 - self.a) * (self.g * u + self.b)
        return y, np.array([y])

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        _, jacobian = self.linearise(state, plans[0])
        free = float(state[0]) * self.a ** np.arange(1, plans.shape[1] + 1)
        return free + (plans + self.b / self.g) @ jacobian.T

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        n = plan.size
        ages = np.arange(n)[:, None] - np.arange(n)
        jacobian = np.where(ages >= 0, (1 - self.a) * self.g * self.a ** np.maximum(ages, 0), 0.0)
        free = float(state[0]) * self.a ** np.arange(1, n + 1)
        return free + jacobian @ (plan + self.b / self.g), jacobian


@dataclass(frozen=True)
class LagInverse(Inverse):
    """One-step deadbeat."""

    model: Lag

    def command(self, state: Vec, theta: float, u_last: float) -> float:
        del u_last
        m = self.model
        return ((theta - m.a * float(state[0])) / (1 - m.a) - m.b) / m.g


class Faulty(Predictor):
    """A model that does `fault` whenever it is asked about a command above `threshold`; at rest it is sound."""

    def __init__(self, inner: Predictor, fault: Callable[[Vec], Vec], threshold: float = 1.0) -> None:
        self.inner, self.fault, self.threshold = inner, fault, threshold
        self.dt, self.command_range = inner.dt, inner.command_range

    def _spoil(self, value: Vec, plan: Vec | float) -> Vec:
        return self.fault(value) if np.max(plan) > self.threshold else value

    def initial(self, y: float, u: float) -> Vec:
        return self.inner.initial(y, u)

    def advance(self, state: Vec, u: float) -> tuple[float, Vec]:
        y, after = self.inner.advance(state, u)
        return float(self._spoil(np.array([y]), u)[0]), self._spoil(after, u)

    def rollout(self, state: Vec, plans: Vec) -> Vec:
        return self._spoil(self.inner.rollout(state, plans), plans)

    def linearise(self, state: Vec, plan: Vec) -> tuple[Vec, Vec]:
        angles, jacobian = self.inner.linearise(state, plan)
        return self._spoil(angles, plan), self._spoil(jacobian, plan)


def raising(value: Vec) -> Vec:
    """The fault of a model that raises."""
    raise ValueError("out of the trained range")


def not_a_number(value: Vec) -> Vec:
    """The fault of a model that answers not-a-number."""
    return np.full_like(value, np.nan)


class ModelPlant:
    """A plant that is a predictor, with optional offset, delay and sensor noise; its state is hidden."""

    def __init__(
        self,
        predictor: Predictor,
        y: float,
        u: float,
        offset_deg: float = 0.0,
        delay_samples: int = 0,
        noise_deg: float = 0.0,
        seed: int = 1,
    ) -> None:
        self.dt = predictor.dt
        self.predictor, self.y, self.u = predictor, y, u
        self.offset_deg, self.delay_samples, self.noise_deg, self.seed = offset_deg, delay_samples, noise_deg, seed
        self.stopped = False

    def reset(self) -> float:
        self.state = self.predictor.initial(self.y, self.u)
        self.pending = [self.u] * self.delay_samples
        self.random = np.random.default_rng(self.seed)
        self.true = [self.y]
        return self._measured(self.y)

    def apply(self, u: float) -> float:
        self.pending.append(u)
        y, self.state = self.predictor.advance(self.state, self.pending.pop(0))
        self.true.append(y + self.offset_deg)
        return self._measured(y)

    def stop(self) -> None:
        self.stopped = True

    def _measured(self, y: float) -> float:
        return y + self.offset_deg + self.noise_deg * float(self.random.standard_normal())


@dataclass(frozen=True)
class Case:
    """A model with its inverse, built when first asked for, and a state of rest that both can hold."""

    name: str
    y_rest: float
    u_rest: float
    build: Callable[[], tuple[Predictor, Inverse]]

    @cached_property
    def _built(self) -> tuple[Predictor, Inverse]:
        return self.build()

    @property
    def predictor(self) -> Predictor:
        return self._built[0]

    @property
    def inverse(self) -> Inverse:
        return self._built[1]

    def broken(self, fault: Callable[[Vec], Vec]) -> Case:
        """The same model with a fault."""
        return replace(
            self, name=f"{self.name}, {fault.__name__}", build=lambda: (Faulty(self.predictor, fault), self.inverse)
        )


PI = PrandtlIshlinskii(3.0, (2.5, 2.0, 1.5, 1.2), 0.15, 0.012, 22.0)


def compiled_pi() -> tuple[Predictor, Inverse]:
    """Rate-dependent PI with four plays, as identified models are: compiled, with its exact inverse."""
    return compiled(Chain(PI))


def compiled(chain: Chain) -> tuple[Predictor, Inverse]:
    """A chain of a tendon catheter, compiled, with its inverse."""
    simulator = Simulator(
        chain=chain,
        dt_s=DT,
        command_unit="mm",
        command_limits=Range(lower=0.0, upper=6.0),
        command_rate_per_s=12.0,
        trained_command=Range(lower=0.0, upper=6.0),
        trained_angle_deg=Range(lower=20.0, upper=95.0),
        trained_rate_per_s=11.0,
        identification=Identification(method="chosen by hand"),
    )
    return controller_model(ChainModel(simulator)).predictive


def backlash() -> tuple[Predictor, Inverse]:
    model = Backlash()
    return model, BacklashInverse(model)


def lag() -> tuple[Predictor, Inverse]:
    model = Lag()
    return model, LagInverse(model)


PLAY = Case("backlash", Backlash.m_lo * Backlash.c_lo, 0.0, backlash)
LINEAR = Case("lag", Lag.b, 0.0, lag)
SOUND = [PLAY, LINEAR, Case("compiled PI", 22.0, 0.0, compiled_pi)]
DRIVEN = Case(
    "PI behind delay and lag", 22.0, 0.0, lambda: compiled(Chain(PI, (Delay(2 * DT, 2), operators.Lag(0.12))))
)
BROKEN = [case.broken(fault) for case in (PLAY, LINEAR) for fault in (raising, not_a_number)]


def with_entries(state: BankState, **entries: object) -> BankState:
    """A bank with some entries of its filters replaced."""
    filters = state.filters.copy()
    for name, value in entries.items():
        filters.view(FILTERS)[name] = value
    return replace(state, filters=filters)
