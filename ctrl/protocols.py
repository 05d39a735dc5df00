"""The seams of the closed loop: controller and plant."""

from __future__ import annotations

from typing import Protocol, TypeVar

from hystmpc.trials.types import Vec

from .command import Command

S = TypeVar("S")


class Controller(Protocol[S]):
    """State in, state out: `step` never raises and never returns a command beyond the limits."""

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        ...

    @property
    def horizon(self) -> int:
        """Number of reference samples that `step` looks at, at least 1."""
        ...

    def init(self, y: float, u: float) -> S:
        """State at rest, with measured angle `y` [deg] and the command `u` that the device holds."""
        ...

    def step(self, state: S, y: float, reference: Vec) -> tuple[Command, S]:
        """One sample.

        Args:
            state: what `init` or the last `step` returned.
            y: measured tip angle [deg]; not-a-number where the measurement is missing.
            reference: wanted tip angles [deg] at the ends of this and the next samples, shape (H,).
        """
        ...


class Plant(Protocol):
    """A device, simulated or real; the only place where state may be hidden."""

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        ...

    def reset(self) -> float:
        """Bring the device to rest and return the measured tip angle [deg]."""
        ...

    def apply(self, u: float) -> float:
        """Apply command `u` [mm or bar] for one sample and return the tip angle measured at its end [deg]."""
        ...

    def stop(self) -> None:
        """Leave the device in its safe state."""
        ...
