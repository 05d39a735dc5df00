"""Rod in a sheath that bends in two planes, pulled by two pairs of tendons.

    x' = (u - x) / tau                                    drives of both pairs
    f' = x' (1 - f sign(x') / width)                      friction of each pair, Dahl's: the tendon gives way by f
    p  = R(phi) (x - f)                                   tendons that are not aligned with the planes
    z <- p - b;  |z| <= r (1 + k |p|)                     friction in the sheath, one for both planes: a vector
    b  = p - z,   b -= late (b - c),  c' = (b - c) / 8 s  bend of the rod, a share of it late
    theta = G (b (1 - s |b|^2) + g)                       stiffening, gravity, sensor frame and coupling

The friction of the sheath is a vector of bounded length: a motion in one plane sets the other free. No operator of the
package has that, nor Dahl's smooth friction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

REACH_MM = 3.0
"""Greatest command either way [mm]."""

RATE_MM_S = 8.0
"""Greatest change of a command per second [mm/s]."""

_SUBSTEPS = 4
_CREEP_S = 8.0


@dataclass(frozen=True)
class RodNumbers:
    """Numbers of a rod; angles in deg, lengths in mm, times in s."""

    gain: float
    tau_s: float
    width: float
    sheath: float
    pull: float
    turn_x: float
    turn_y: float
    late: float
    stiffening: float
    gravity: float
    coupling_x: float
    coupling_y: float
    noise_deg: float
    rate_hz: float


def drawn(random: np.random.Generator) -> RodNumbers:
    """A rod of the study: misalignment 0 to 20 deg, coupling 0 to .3, drives 0 to .2 s, 25 or 50 Hz."""
    return RodNumbers(
        gain=float(random.uniform(9.0, 16.0)),
        tau_s=float(random.uniform(0.0, 0.2)),
        width=float(random.uniform(0.05, 0.3)),
        sheath=float(random.uniform(0.02, 0.15)),
        pull=float(random.uniform(0.0, 0.3)),
        turn_x=float(random.uniform(-20.0, 20.0)),
        turn_y=float(random.uniform(-20.0, 20.0)),
        late=float(random.uniform(0.0, 0.06)),
        stiffening=float(random.uniform(0.0, 0.006)),
        gravity=float(random.uniform(0.0, 0.15)),
        coupling_x=float(random.uniform(-0.3, 0.3)),
        coupling_y=float(random.uniform(-0.3, 0.3)),
        noise_deg=float(random.uniform(0.05, 0.15)),
        rate_hz=float(random.choice([25.0, 50.0])),
    )


class Rod:
    """A rod at rest at zero commands; `advance` holds commands (2,) [mm] for one sample.

    Attributes:
        numbers: of the rod.
        angles: true angles (2,) [deg].
    """

    def __init__(self, numbers: RodNumbers, seed: int = 0) -> None:
        self.numbers, self._random = numbers, np.random.default_rng(seed)
        self._x, self._f, self._z, self._c = (np.zeros(2) for _ in range(4))
        x, y = np.deg2rad([numbers.turn_x, numbers.turn_y])
        self._pull = np.array([[np.cos(x), -np.sin(y)], [np.sin(x), np.cos(y)]])
        self._frame = numbers.gain * np.array([[1.0, numbers.coupling_x], [numbers.coupling_y, 1.0]])
        self.angles = self._answer()

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return 1 / self.numbers.rate_hz

    def _answer(self) -> Vec:
        n, bend = self.numbers, self._pull @ (self._x - self._f) - self._z
        bend = bend - n.late * (bend - self._c)
        stiff = bend * (1 - n.stiffening * float(bend @ bend))
        return np.asarray(self._frame @ (stiff + np.array([0.0, -n.gravity])))

    def advance(self, commands: Vec) -> Vec:
        """True angles (2,) [deg] after one sample."""
        n, dt = self.numbers, self.dt / _SUBSTEPS
        u = np.clip(commands, -REACH_MM, REACH_MM)
        share = 1.0 if n.tau_s == 0 else 1 - float(np.exp(-dt / n.tau_s))
        for _ in range(_SUBSTEPS):
            move = share * (u - self._x)
            self._x = self._x + move
            along = np.exp(-np.abs(move) / n.width)
            self._f = np.sign(move) * n.width * (1 - along) + self._f * along
            before = self._pulled
            self._pulled = self._pull @ (self._x - self._f)
            z = self._z + self._pulled - before
            bound, length = n.sheath * (1 + n.pull * float(np.hypot(*self._pulled))), float(np.hypot(*z))
            self._z = z * min(1.0, bound / length) if length > 0 else z
            self._c = self._c + dt / _CREEP_S * (self._pulled - self._z - self._c)
        self.angles = self._answer()
        return self.angles

    _pulled: Vec = np.zeros(2)

    def measured(self) -> Vec:
        """Angles (2,) [deg] with noise."""
        return np.asarray(self.angles + self.numbers.noise_deg * self._random.standard_normal(2))


def trials_of(numbers: RodNumbers, seed: int, count: int = 5, seconds: float = 40.0) -> list[Trial]:
    """Recorded trials: random moves and rests of both commands, at times of one alone."""
    made = []
    for number in range(count):
        random, rod = np.random.default_rng((seed, number)), Rod(numbers, seed + 97 * number)
        samples = round(seconds / rod.dt)
        commands = np.stack([_wandering(random, samples, rod.dt) for _ in range(2)], axis=1)
        if number % 3 == 1:
            commands[: samples // 2, 1] = 0.0
        if number % 3 == 2:
            commands[: samples // 2, 0] = 0.0
        commands = _limited(commands, rod.dt)
        angles = [rod.measured()]
        for u in commands[:-1]:
            rod.advance(u)
            angles.append(rod.measured())
        t = rod.dt * np.arange(samples)
        made.append(Trial(t, commands, np.array(angles), units=Units("mm", "deg"), source=f"trial_{number}"))
    return made


def _limited(commands: Vec, dt: float) -> Vec:
    made, reach = np.zeros_like(commands), 0.5 * RATE_MM_S * dt
    for k in range(1, len(commands)):
        made[k] = made[k - 1] + np.clip(commands[k] - made[k - 1], -reach, reach)
    return made


def _wandering(random: np.random.Generator, samples: int, dt: float) -> Vec:
    """Ramps between random commands at random speeds, with rests."""
    values, at = [np.zeros(round(1.0 / dt))], 0.0
    while sum(map(len, values)) < samples:
        to, speed = float(random.uniform(-REACH_MM, REACH_MM)), float(random.uniform(0.5, 4.0))
        way = max(round(abs(to - at) / speed / dt), 1)
        values += [np.linspace(at, to, way, endpoint=False), np.full(round(random.uniform(0.0, 1.5) / dt), to)]
        at = to
    return np.concatenate(values)[:samples]


def changed(numbers: RodNumbers, **values: float) -> RodNumbers:
    """The same rod with other numbers."""
    return replace(numbers, **values)
