"""Model of a device with two bending axes, in readable YAML: w = M u, y_i = f_i(w_i), theta = A y."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hystmpc.core.library import engine
from hystmpc.core.structs import Struct, constants, struct
from hystmpc.trials.brief import in_brief
from hystmpc.trials.config import NotNegative, Positive, Settings, dump_yaml, read_yaml
from hystmpc.trials.errors import ConfigError, ModelError, shown
from hystmpc.trials.files import write_atomically
from hystmpc.trials.trial import MOST_COMMANDS
from hystmpc.trials.types import Vec

from ..contract.metadata import Range, Rate
from ..model import NO_INPUTS
from ..scheduled import MeasuredInput
from ..simulator import ChainModel, Simulator, simulator_from, simulator_spec

FORMAT = "hystmpc-two-axes/1"
AXES = 2
_SINGULAR = 0.05  # least ratio of singular values: below, two axes are hardly two
_ROUNDING = 1e-9
_MOST_LATE = constants()["HYSTMPC_CROSS_LATE"]

Row = tuple[float, ...]
Coupled = tuple[float, float, float, float, float]
COUPLED = 5
"""Products of the travels, as in core/cross_friction.h."""


class CrossFriction(Settings):
    """What motions along both axes add to those of each alone: friction whose force is a vector, and static coupling.

        v' = (w(t - delay_s) - v) / lag_s
        c_i = sum_j weights_ij (b_ji - p_ji) + coupling_i . (x o, o^2, x o^2, x^2 o, o^3),    x = v_i, o the other one

    b_j (2,) is a play in the plane of v, |v - b_j| <= radii_j; p_ji is the play of v_i alone. A rod that slides along a
    sheath in one plane is free in the other one: the friction is zero in motions of one axis. A rod that is bent in one
    plane is stiffer in the other one: that is static coupling.

    Attributes:
        lag_s: time constant of the drives in front [s].
        radii: of the plays (J,), in the unit of w, at most eight.
        weights: k (2, J) [deg per unit of w].
        delay_s: transport delay in front [s], in whole samples, at most 64.
        coupling: g (2, 5) [deg per unit of w squared or cubed]; None for none.
    """

    lag_s: NotNegative
    radii: tuple[Positive, ...] = Field(max_length=8)
    weights: tuple[Row, Row]
    delay_s: NotNegative = 0.0
    coupling: tuple[Coupled, Coupled] | None = None

    def struct(self, dt_s: float) -> Struct:
        """Struct `hystmpc_cross_friction` at a sample time [s].

        Raises:
            ModelError: if the delay has too many samples.
        """
        delay = round(self.delay_s / dt_s)
        if delay > _MOST_LATE:
            raise ModelError(f"cross_friction: delay_s is {delay} samples, expected at most {_MOST_LATE}")
        keep = math.exp(-dt_s / self.lag_s) if self.lag_s > 0 else 0.0
        weights = np.array(self.weights, dtype=np.float64)
        coupling = None if self.coupling is None else np.array(self.coupling, dtype=np.float64)
        return struct(
            "hystmpc_cross_friction", plays=len(self.radii), delay=delay, keep=keep, radii=self.radii, weights=weights,
            coupling=coupling,
        )  # fmt: skip

    def at_rest(self, travels: Vec, dt_s: float) -> Vec:
        """State (S,) at rest at travels (2,)."""
        core, part = engine(), self.struct(dt_s)
        state = np.empty(int(core.cross_states(part.address)))
        core.cross_rest(part.address, np.ascontiguousarray(travels), state)
        return state

    def advance(self, state: Vec, travels: Vec, dt_s: float) -> tuple[Vec, Vec]:
        """c (T, 2) [deg] along travels (T, 2) from a state (S,), and the state after them."""
        part, after = self.struct(dt_s), state.copy()
        w, c = np.ascontiguousarray(travels.T), np.empty((AXES, len(travels)))
        engine().cross_run(part.address, len(travels), w, after, c)
        return np.ascontiguousarray(c.T), after

    def run(self, travels: Vec, dt_s: float) -> Vec:
        """c (T, 2) [deg] along travels (T, 2) from a rest at the first."""
        return self.advance(self.at_rest(travels[0], dt_s), travels, dt_s)[0]


class TwoAxisFile(Settings):
    """Layout of the YAML file.

    Attributes:
        format: name and version, `hystmpc-two-axes/1`.
        mix: M (2, n): travel of each axis by every command.
        frame: A (2, 2): angles by those of the axes.
        command_limits, command_rates_per_s: of each of n commands.
        rest_commands: at which the device rests, n: pretension of tendons.
        axes: two simulators, as in files of one axis; commands there are travels w.
        cross_friction: friction that both axes share; null for none.
        comparison: errors on parts left out of the identification, by what joins the axes.
    """

    format: str
    mix: tuple[Row, Row]
    frame: tuple[Row, Row]
    command_limits: tuple[Range, ...] = Field(min_length=AXES, max_length=MOST_COMMANDS)
    command_rates_per_s: tuple[Rate, ...]
    rest_commands: Row
    axes: tuple[dict[str, Any], dict[str, Any]]
    cross_friction: CrossFriction | None = None
    comparison: dict[str, float] = Field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class TwoAxisModel:
    """Two bending axes of one device with n commands u and two angles theta.

        w = M u,    y_i = f_i(w_i) + c_i(w),    theta = A y

    w (2,) are the travels that pull by the axes (Clarke coordinates of tendons), f_i is a simulator of one axis: its
    drive, hysteresis and creep. M off its diagonal stands for tendons that are not aligned with the axes, A for a
    sensor frame that is turned. Where n > 2, commands that do not pull (pretension, co-contraction) stay at rest:

        u = u_0 + N (w - M u_0),    N = M^+ (pseudo-inverse)

    Attributes:
        axes: simulators f_x, f_y; their command is w.
        mix, frame: M (2, n), A (2, 2), rows of numbers.
        command_limits, command_rates_per_s, rest_commands: of every command, n each.
        comparison: errors [deg] on parts left out, by what joins the axes; empty without an identification.
        cross_friction: c, see `CrossFriction`; None for none.

    Raises:
        ModelError: if sizes differ, a matrix cannot be inverted, a rest is beyond its limits, or the axes have
            different sample times or units.
    """

    axes: tuple[Simulator, Simulator]
    mix: tuple[Row, ...]
    frame: tuple[Row, ...]
    command_limits: tuple[Range, ...]
    command_rates_per_s: Row
    rest_commands: Row
    comparison: Mapping[str, float]
    cross_friction: CrossFriction | None = None

    def __post_init__(self) -> None:
        n = len(self.command_limits)
        sizes = {len(row) for row in self.mix} | {len(self.command_rates_per_s), len(self.rest_commands)}
        if sizes != {n} or not AXES <= n <= MOST_COMMANDS or len(self.mix) != AXES:
            raise ModelError(
                f"two axes: got sizes {sorted(sizes)} for {n} commands, expected as many of each, 2 to {MOST_COMMANDS}"
            )
        if [len(row) for row in self.frame] != [AXES] * AXES:
            raise ModelError("two axes: got a frame of another shape, expected (2, 2)")
        for name, matrix in (("mix", self.mix), ("frame", self.frame)):
            rows = np.array(matrix, dtype=np.float64)
            sigma = np.linalg.svd(rows, compute_uv=False) if np.all(np.isfinite(rows)) else np.zeros(AXES)
            if sigma[-1] <= _SINGULAR * sigma[0]:
                raise ModelError(f"two axes: {name} joins both axes into one, got {rows.tolist()}")
        for k, (rest, limits) in enumerate(zip(self.rest_commands, self.command_limits, strict=True)):
            if not limits.lower <= rest <= limits.upper:
                raise ModelError(f"two axes: rest_commands[{k}] is {rest:g}, expected {limits.lower} to {limits.upper}")
        x, y = self.axes
        if (x.dt_s, x.command_unit, x.angle_unit) != (y.dt_s, y.command_unit, y.angle_unit):
            raise ModelError("two axes: got axes of different sample times or units, expected the same of both")

    def __repr__(self) -> str:
        return in_brief(self, f"{len(self.command_limits)} commands, 2 angles, every {self.dt_s:.4g} s: {self.axes}")

    @property
    def dt_s(self) -> float:
        """Sample time [s]."""
        return self.axes[0].dt_s

    @cached_property
    def matrix(self) -> Vec:
        """M (2, n)."""
        return np.array(self.mix, dtype=np.float64)

    @cached_property
    def unmix(self) -> Vec:
        """N (n, 2), the pseudo-inverse of M; of two commands its inverse."""
        m = self.matrix
        return np.asarray(np.linalg.inv(m) if m.shape[1] == AXES else np.linalg.pinv(m), dtype=np.float64)

    @cached_property
    def turn(self) -> Vec:
        """A (2, 2)."""
        return np.array(self.frame, dtype=np.float64)

    @cached_property
    def inputs(self) -> tuple[MeasuredInput, ...]:
        """Measured inputs on which an axis depends, each once, with the range of both axes together."""
        made: dict[str, MeasuredInput] = {}
        for one in (given for axis in self.axes for given in axis.chain.inputs):
            known = made.setdefault(one.name, one)
            made[one.name] = replace(known, lower=min(known.lower, one.lower), upper=max(known.upper, one.upper))
        return tuple(made.values())

    @property
    def joined(self) -> bool:
        """Whether a command bends more than one axis, or both share friction."""
        apart = all(np.count_nonzero(matrix, axis=0).max() <= 1 for matrix in (self.matrix, self.turn))
        return self.cross_friction is not None or not apart

    def at_sample_time(self, dt_s: float) -> TwoAxisModel:
        """Model at another sample time [s]."""
        return replace(self, axes=(self.axes[0].at_sample_time(dt_s), self.axes[1].at_sample_time(dt_s)))

    def travels(self, commands: ArrayLike) -> Vec:
        """Travels w (..., 2) by commands u (..., n)."""
        return np.asarray(np.asarray(commands, dtype=np.float64) @ self.matrix.T)

    def commands(self, travels: ArrayLike) -> Vec:
        """Commands u (..., n) of least distance from the rest that pull by the travels w (..., 2)."""
        rest = np.array(self.rest_commands)
        return np.asarray(rest + (np.asarray(travels, dtype=np.float64) - self.matrix @ rest) @ self.unmix.T)

    def in_axes(self, angles_deg: ArrayLike) -> Vec:
        """Angles y (..., 2) of the axes by the angles theta (..., 2) [deg]."""
        return np.asarray(np.asarray(angles_deg, dtype=np.float64) @ np.linalg.inv(self.turn).T)

    def travel_limits(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Least and greatest travel, and greatest rate, of each axis while the other one does not bind."""
        low = np.array([limits.lower for limits in self.command_limits])
        high = np.array([limits.upper for limits in self.command_limits])
        made = []
        for row in self.matrix:
            ends = np.sort([row * low, row * high], axis=0).sum(axis=1)
            slack = _ROUNDING * (ends[1] - ends[0])
            rate = float(np.abs(row) @ np.array(self.command_rates_per_s)) * (1 + _ROUNDING)
            made.append((float(ends[0] - slack), float(ends[1] + slack), rate))
        return made[0], made[1]

    def run(self, commands: ArrayLike, start_deg: ArrayLike, inputs: Mapping[str, Vec] = NO_INPUTS) -> Vec:
        """Free run (T, 2) [deg] over commands (T, n), from the rest at the first of them that shows `start_deg` (2,).

        Args:
            inputs: measured inputs (T,) by name; their references where left out.

        Raises:
            ModelError: if the shapes do not fit.
        """
        u, start = np.asarray(commands, dtype=np.float64), np.asarray(start_deg, dtype=np.float64)
        if u.ndim != AXES or u.shape[1] != len(self.command_limits) or start.shape != (AXES,):
            raise ModelError(
                f"two axes: got commands {u.shape} and a start {start.shape}, expected (T, "
                f"{len(self.command_limits)}) and (2,)"
            )
        w = self.travels(u)
        shared = np.zeros(w.shape) if self.cross_friction is None else self.cross_friction.run(w, self.dt_s)
        begin = self.in_axes(start) - shared[0]
        y = [run_axis(ChainModel(axis), w[:, i], float(begin[i]), inputs) for i, axis in enumerate(self.axes)]
        return np.asarray((np.stack(y, axis=1) + shared) @ self.turn.T)

    def with_tendons(
        self,
        angles_deg: Sequence[float],
        *,
        pretension: float,
        limits: Sequence[tuple[float, float]],
        rates_per_s: Sequence[float],
    ) -> TwoAxisModel:
        """Model of a device of n tendons at these angles around the axis, by Clarke's coordinates.

            w = M C u,    C = 2 / n [cos phi; sin phi]

        Tendons at 0 deg pull by x, at 90 deg by y. This model has the two commands C u.

        Args:
            angles_deg: of the tendons, three to nine of them.
            pretension: command of every tendon at rest.
            limits: least and greatest command of each; a tendon is slack below the least one.
            rates_per_s: greatest change of each per second.

        Raises:
            ModelError: if this model has not two commands, counts differ, or the tendons pull by one axis alone.
        """
        phi, n = np.deg2rad(np.asarray(angles_deg, dtype=np.float64)), len(angles_deg)
        if len(self.command_limits) != AXES or not AXES < n <= MOST_COMMANDS or {len(limits), len(rates_per_s)} != {n}:
            raise ModelError(
                f"with_tendons: got {n} tendons, {len(limits)} limits, expected 3 to {MOST_COMMANDS} of each"
            )
        mix = self.matrix @ (2 / n * np.stack([np.cos(phi), np.sin(phi)]))
        return replace(
            self,
            mix=tuple(tuple(row.tolist()) for row in mix),
            command_limits=tuple(Range(lower=low, upper=high) for low, high in limits),
            command_rates_per_s=tuple(float(rate) for rate in rates_per_s),
            rest_commands=(float(pretension),) * n,
        )

    def in_travels(self) -> TwoAxisModel:
        """Model of the same device whose two commands are the travels w; `commands` of this one gives all n of them.

        The limits are a box around the rest, as large along both axes, in which all n commands keep theirs:

            |w_i - (M u_0)_i| <= min_k m_k / (|N_kx| + |N_ky|),    m_k the room of command k around its rest

        Raises:
            ModelError: if a command rests at one of its limits.
        """
        rest = np.array(self.rest_commands)
        low, high = (np.array([getattr(one, end) for one in self.command_limits]) for end in ("lower", "upper"))
        pull = np.abs(self.unmix).sum(axis=1)
        size = float(np.min(np.minimum(high - rest, rest - low)[pull > 0] / pull[pull > 0]))
        rate = float(np.min(np.array(self.command_rates_per_s)[pull > 0] / pull[pull > 0]))
        if size <= 0:
            raise ModelError("in_travels: a command rests at its limit, expected rest_commands with room on both sides")
        x, y = (self.matrix @ rest).tolist()
        return replace(
            self,
            mix=((1.0, 0.0), (0.0, 1.0)),
            command_limits=(Range(lower=x - size, upper=x + size), Range(lower=y - size, upper=y + size)),
            command_rates_per_s=(rate, rate),
            rest_commands=(x, y),
        )

    def save(self, path: Path | str) -> Path:
        """Write the model file (`.yaml`), whole or not at all."""
        file = TwoAxisFile(
            format=FORMAT,
            mix=(self.mix[0], self.mix[1]),
            frame=(self.frame[0], self.frame[1]),
            command_limits=self.command_limits,
            command_rates_per_s=self.command_rates_per_s,
            rest_commands=self.rest_commands,
            axes=(simulator_spec(self.axes[0]), simulator_spec(self.axes[1])),
            cross_friction=self.cross_friction,
            comparison=dict(self.comparison),
        )
        return write_atomically(path, dump_yaml(file.model_dump(mode="json", exclude_none=True)))


def run_axis(axis: ChainModel, travel: Vec, start_deg: float, inputs: Mapping[str, Vec]) -> Vec:
    """Free run y (T,) [deg] of one axis over its travel w (T,), with those inputs (T,) on which it depends."""
    known = {one.name: inputs[one.name] for one in axis.inputs if one.name in inputs}
    return axis.run(np.ascontiguousarray(travel), start_deg, known)


def has_two_axes(path: Path | str) -> bool:
    """Whether a file is a model of two axes; what is no YAML mapping is none."""
    if Path(path).suffix.lower() not in (".yaml", ".yml"):
        return False
    try:
        data = read_yaml(path)
    except ConfigError:
        return False
    return isinstance(data, dict) and str(data.get("format", "")).startswith(FORMAT.partition("/")[0])


def load_two_axes(path: Path | str) -> TwoAxisModel:
    """Read a model of two axes.

    Raises:
        ModelError: if the file is missing, foreign, of another version, or contradicts itself.
    """
    try:
        data = read_yaml(path)
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            got = data.get("format") if isinstance(data, dict) else type(data).__name__
            raise ModelError(f"{path}: format {shown(got)}, expected a model of two axes of format {FORMAT!r}")
        file = TwoAxisFile.parse(data, str(path))
    except ConfigError as error:
        raise ModelError(str(error)) from None
    x, y = (simulator_from(spec, f"{path}: axes[{k}]") for k, spec in enumerate(file.axes))
    try:
        return TwoAxisModel(
            (x, y), file.mix, file.frame, file.command_limits, file.command_rates_per_s, file.rest_commands,
            file.comparison, file.cross_friction,
        )  # fmt: skip
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None
