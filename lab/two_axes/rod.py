"""Rod in a sheath that bends in two planes, pulled by two pairs of tendons.

    x' = (u(t - delay) - x) / tau                         drives of both pairs
    f' = x' (sign(x') width - f) sign(x') / (2.5 width)   friction of each pair, Dahl's: the tendon gives way by f
    p  = R(phi) (x - f)                                   tendons that are not aligned with the planes
    z <- p - b;  |z| <= r (1 + k |p|)                     friction in the sheath, one for both planes: a vector
    b  = p - z,   b -= late (b - c),  c' = (b - c) / 8 s  bend of the rod, a share of it late
    theta = G (b (1 - s |b|^2) + g)                       stiffening, gravity, sensor frame and coupling

The friction of the sheath is a vector of bounded length: a motion in one plane sets the other free. No operator of the
package has that, nor Dahl's smooth friction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hystmpc.trajectories.excitation import identification_motions
from hystmpc.trajectories.trajectory import Sampled, Trajectory
from hystmpc.trials.trial import Trial, Units
from hystmpc.trials.types import Vec

REACH_MM = 3.0
"""Greatest command either way [mm]."""

RATE_MM_S = 8.0
"""Greatest change of a command per second [mm/s]."""

_SUBSTEPS = 4
_CREEP_S = 8.0
_SOFT = 2.5  # above two, or the rod would go back at a reversal


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
    delay_samples: int


def drawn(random: np.random.Generator) -> RodNumbers:
    """A rod of the study: misalignment 0 to 20 deg, coupling 0 to .3, drives 0 to .2 s, 25 or 50 Hz.

    Delays and noise are those of the drawn devices of one axis (`hystmpc_lab.devices.drawn`).
    """
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
        noise_deg=float(np.exp(random.uniform(*np.log([0.03, 0.3])))),
        rate_hz=float(random.choice([25.0, 50.0])),
        delay_samples=int(random.integers(0, 4)),
    )


class Rod:
    """A rod at rest at zero commands; `advance` holds commands (2,) [mm] for one sample.

    Attributes:
        numbers: of the rod.
        angles: true angles (2,) [deg].
    """

    def __init__(self, numbers: RodNumbers, seed: int = 0) -> None:
        self.numbers, self._random = numbers, np.random.default_rng(seed)
        self._x, self._f, self._z, self._c, self._pulled = (np.zeros(2) for _ in range(5))
        self._late = [np.zeros(2)] * numbers.delay_samples
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
        self._late.append(np.clip(commands, -REACH_MM, REACH_MM))
        u = self._late.pop(0)
        share = 1.0 if n.tau_s == 0 else 1 - float(np.exp(-dt / n.tau_s))
        for _ in range(_SUBSTEPS):
            move = share * (u - self._x)
            self._x = self._x + move
            along = np.exp(-np.abs(move) / (_SOFT * n.width))
            self._f = np.sign(move) * n.width * (1 - along) + self._f * along
            before = self._pulled
            self._pulled = self._pull @ (self._x - self._f)
            z = self._z + self._pulled - before
            bound, length = n.sheath * (1 + n.pull * float(np.hypot(*self._pulled))), float(np.hypot(*z))
            self._z = z * min(1.0, bound / length) if length > 0 else z
            self._c = self._c + dt / _CREEP_S * (self._pulled - self._z - self._c)
        self.angles = self._answer()
        return self.angles

    def measured(self) -> Vec:
        """Angles (2,) [deg] with noise."""
        return np.asarray(self.angles + self.numbers.noise_deg * self._random.standard_normal(2))


def trials_of(numbers: RodNumbers, seed: int) -> list[Trial]:
    """Recorded trials of six minutes in all: the motions of an identification of one axis, on both at different times.

    Commands hold for a sample, and the angle is that at its end. The first two trials move one axis alone.
    """
    random = np.random.default_rng(seed)
    x, y = (list(identification_motions(2 * REACH_MM, 0.5 * RATE_MM_S, random)) for _ in range(2))
    still: Trajectory = Sampled(np.array([0.0, 1.0]), np.full(2, REACH_MM))
    pairs = [(x[0][1], still), (still, y[0][1])]
    pairs += [(one, y[(k + 1) % len(y)][1]) for k, (_, one) in enumerate(x)]
    made = []
    for number, motions in enumerate(pairs):
        rod = Rod(numbers, seed + 97 * number)
        seconds = max(motion.duration_s for motion in motions) + 1.0
        t = rod.dt * np.arange(round(seconds / rod.dt))
        asked = np.stack([motion(t) - REACH_MM for motion in motions], axis=1)
        commands = _limited(asked, rod.dt)
        angles = []
        for u in commands:
            rod.advance(u)
            angles.append(rod.measured())
        time = np.asarray(t, dtype=np.float64)
        made.append(Trial(time, commands, np.array(angles), units=Units("mm", "deg"), source=f"trial_{number}"))
    return made


def _limited(asked: Vec, dt: float) -> Vec:
    """Commands that begin at rest and stay within half of the greatest rate."""
    made, reach, at = np.empty_like(asked), 0.5 * RATE_MM_S * dt, np.zeros(2)
    for k, wanted in enumerate(asked):
        at = at + np.clip(wanted - at, -reach, reach)
        made[k] = at
    return made
