"""What joins the axes anew: misalignment, cross-coupling and shared friction, chosen on trials left out of their fit.

    w = D M u,    D = [[cos a, -sin b], [sin a, cos b]]       misalignment: tendons turned by a and b
    theta = A B y,    B = [[1, p], [q, 1]]                    cross-coupling: an angle shows a share of the other bend
    y_i = f_i(w_i) + c_i(w) + k_i . z_i(w_i)                  c: friction that both axes share

M, A, f and c are those of the simulator. z_i are lags and plays of the axis's travel (`models.two_axes.joints`). Their
weights k_i follow by least squares: what one axis alone can explain does not count for a join.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from hystmpc.models.identify.runs import Blocks
from hystmpc.models.simulator import ChainModel
from hystmpc.models.two_axes.cross import shared_friction
from hystmpc.models.two_axes.joints import columns_of, weights_of
from hystmpc.models.two_axes.model import AXES, CrossFriction, TwoAxisModel
from hystmpc.trials.errors import GapError
from hystmpc.trials.trial import Trial
from hystmpc.trials.types import Index, Mask, Vec

from ..decide.gap_closed import ClosedShares
from ..logs.sensor import white_noise
from ..logs.trial_choice import FINAL_SHARE, most_repeated, motion_features
from .diagnosis import JoinEffect, JoinGap, KnownJoins

FREE: Mapping[str, tuple[int, ...]] = {"misalignment": (0, 1), "cross_coupling": (2, 3), "shared_friction": ()}
"""Numbers (a, b, p, q) that each effect has."""

AS_GIVEN = "as given"
"""Name of no effect among those that were tried."""

LEAST_S = 15.0
"""Duration of all trials below which no effect is looked for [s]."""

_PARTS = 6  # parts that are left out one after another
_CLEAR = 2.0  # standard errors by which an effect lowers the held-out error
_WORTH = 0.2  # of the structural error: what it lowers it by at least
_T90 = 2.015  # 90 % interval of Student's distribution with five degrees of freedom
_MOST = 0.8  # greatest size of a number
_STEP, _MOST_STEPS = 1e-4, 40  # of the search of these numbers
_BLOCK_S = 3.0
_SPREAD = 0.1  # half of an interval due to differences between trials, as of one axis with too few trials
_FEW_TRIALS = 3
_COLUMNS = 8  # tables of columns that are kept


@dataclass(frozen=True, eq=False)
class Joined:
    """Numbers (a, b, p, q) and friction of a simulator that is joined anew."""

    q: Vec
    cross: CrossFriction | None

    def model(self, given: TwoAxisModel) -> TwoAxisModel:
        """The simulator with them."""
        a, b, p, q = self.q.tolist()
        turned = np.array([[np.cos(a), -np.sin(b)], [np.sin(a), np.cos(b)]]) @ given.matrix
        shown = given.turn @ np.array([[1.0, p], [q, 1.0]])
        mix, frame = (tuple(tuple(row) for row in matrix.tolist()) for matrix in (turned, shown))
        return replace(given, mix=mix, frame=frame, cross_friction=self.cross)


@dataclass(frozen=True, eq=False)
class Tried:
    """Effects fitted to all development samples and without each part, and their errors on these parts [deg^2]."""

    names: frozenset[str]
    joined: Joined
    folds: tuple[Joined, ...]
    squares: Vec

    def better_than(self, other: Tried, floor_mse: float) -> bool:
        """Whether the held-out error falls clearly, and by a good part of the structural error."""
        gain = other.squares - self.squares
        least = max(_CLEAR * _error_of_mean(gain), _WORTH * max(float(other.squares.mean()) - floor_mse, 0.0))
        return float(gain.mean()) > least

    def alike(self, best: Tried, rest: Tried, floor_mse: float) -> bool:
        """Whether the held-out error exceeds that of the best by no more than its doubt.

        That is what the best leaves itself, since the form of the simulator errs by as much, or two standard errors.
        These count up to a good part of the structural error of the rest, which has neither effect.
        """
        more, left = self.squares - best.squares, float(best.squares.mean()) - floor_mse
        chance = min(_CLEAR * _error_of_mean(more), _WORTH * (float(rest.squares.mean()) - floor_mse))
        return float(more.mean()) <= max(chance, left)


@dataclass(frozen=True, eq=False)
class JoinTrials:
    """Trials at the rate of the simulator, one behind the other (T samples), and their split.

    Attributes:
        final: samples on which nothing is chosen (T,).
        names: of the trials with final samples.
    """

    simulator: TwoAxisModel
    trials: tuple[Trial, ...]
    final: Mask
    names: tuple[str, ...]
    _kept: dict[frozenset[str], Tried] = field(default_factory=dict)
    _begun: dict[frozenset[str], Joined] = field(default_factory=dict)
    _columns: dict[bytes, Vec] = field(default_factory=dict)

    @classmethod
    def of(cls, simulator: TwoAxisModel, trials: Sequence[Trial], ordered: bool) -> JoinTrials:
        """Split trials: a quarter, those most like another, is final; of one or two trials the last quarter of each.

        Raises:
            GapError: if a command or an angle of the trials never moves.
        """
        for name in ("commands", "angles"):
            spans = np.max([np.ptp(getattr(trial, name), axis=0) for trial in trials], axis=0)
            if np.any(spans == 0):
                raise GapError(
                    f"{trials[0].source}: {name[:-1]} {'xy'[int(np.argmin(spans))]} never moves in these logs, "
                    "expected motion of both axes; record a motion along each"
                )
        parts = [np.zeros(len(trial), dtype=bool) for trial in trials]
        if len(trials) < _FEW_TRIALS:
            for part in parts:
                part[round((1 - FINAL_SHARE) * part.size) :] = True
        else:
            features = [motion_features([t.commands[:, k] for t in trials], simulator.dt_s) for k in range(AXES)]
            for k in most_repeated(np.hstack(features), [""] * len(trials), ordered):
                parts[k][:] = True
        names = [trial.source for trial, part in zip(trials, parts, strict=True) if part.any()]
        return cls(simulator, tuple(trials), np.concatenate(parts), tuple(names))

    @cached_property
    def _axes(self) -> list[ChainModel]:
        return [ChainModel(axis) for axis in self.simulator.axes]

    @cached_property
    def parts(self) -> list[Index]:
        """Development samples of each part."""
        return [np.asarray(part) for part in np.array_split(np.flatnonzero(~self.final), _PARTS)]

    def errors(self, joined: Joined, seen: Mask, corrected: bool = True) -> Vec:
        """Errors (T, 2) [deg] without each trial's mean, behind axes that are corrected by the samples seen."""
        model = joined.model(self.simulator)
        travels, left = self._left(model)
        e = _without_means(left)
        if corrected:
            e = e - self._of_axes(travels, e, seen)
        return np.asarray(e @ model.turn.T)

    def _left(self, model: TwoAxisModel) -> tuple[list[Vec], list[Vec]]:
        """Travels (T, 2) of each trial, and what the axes leave of its angles in their own frame (T, 2) [deg]."""
        travels = [model.travels(trial.commands) for trial in self.trials]
        left = []
        for trial, w in zip(self.trials, travels, strict=True):
            y = model.in_axes(trial.angles)
            runs = [f.run(np.ascontiguousarray(w[:, i]), float(y[0, i])) for i, f in enumerate(self._axes)]
            shared = 0.0 if model.cross_friction is None else model.cross_friction.run(w, model.dt_s)
            left.append(y - np.stack(runs, axis=1) - shared)
        return travels, left

    def _of_axes(self, travels: Sequence[Vec], e: Vec, seen: Mask) -> Vec:
        """What lags and plays of each axis alone explain of errors (T, 2), by the samples seen."""
        explained = np.empty_like(e)
        for i in range(AXES):
            columns = self._columns_of([w[:, i] for w in travels])
            explained[:, i] = columns @ weights_of(columns[seen], e[seen, i])
        return explained

    def _columns_of(self, travels: Sequence[Vec]) -> Vec:
        """Lags and plays of a travel (T, K) without each trial's mean; the last few are kept."""
        key = np.concatenate(travels).tobytes()
        if key not in self._columns:
            if len(self._columns) >= _COLUMNS:
                self._columns.pop(next(iter(self._columns)))
            made = columns_of(travels, [self.simulator.dt_s] * len(travels))[:, 1:]
            self._columns[key] = _without_means(np.split(made, np.cumsum([len(w) for w in travels])[:-1]))
        return self._columns[key]

    def tried(self, names: frozenset[str], start: Joined) -> Tried:
        """Effects fitted and judged; searched from others."""
        if names not in self._kept:
            all_ = ~self.final
            joined, folds, squares = self._fit(names, start), [], np.empty(_PARTS)
            for k, part in enumerate(self.parts):
                seen = all_.copy()
                seen[part] = False
                folds.append(self._fitted(names, seen, joined))
                squares[k] = _mse(self.errors(folds[-1], seen)[part])
            self._kept[names] = Tried(names, joined, tuple(folds), squares)
        return self._kept[names]

    @property
    def held_out(self) -> dict[str, float]:
        """Errors on parts left out [deg], by the effects that were tried."""
        rows = ((" + ".join(sorted(names)) or AS_GIVEN, tried) for names, tried in self._kept.items())
        return {name: float(np.sqrt(tried.squares.mean())) for name, tried in rows}

    def worth_trying(self, more: Sequence[frozenset[str]], chosen: Tried, floor_mse: float) -> list[frozenset[str]]:
        """Effects whose own fit lowers the error by a good part, and by about as much as the best; the quick choice.

        Held-out errors fall by less than those of a fit.
        """
        before = self._of_fit(chosen.joined)
        after = {names: self._of_fit(self._fit(names, chosen.joined)) for names in more}
        least, part = min(after.values(), default=before), _WORTH * max(before - floor_mse, 0.0)
        return [names for names, mse in after.items() if before - mse > part and mse - least <= part]

    def _of_fit(self, joined: Joined) -> float:
        """Mean square error of a fit on its own samples [deg^2]."""
        return _mse(self.errors(joined, ~self.final)[~self.final])

    def _fit(self, names: frozenset[str], start: Joined) -> Joined:
        """Effects fitted to all development samples, searched from others and from nothing: valleys may be apart."""
        if names not in self._begun:
            starts = [start, replace(start, q=np.zeros_like(start.q))] if np.any(start.q) else [start]
            self._begun[names] = min((self._fitted(names, ~self.final, one) for one in starts), key=self._of_fit)
        return self._begun[names]

    def _fitted(self, names: frozenset[str], seen: Mask, start: Joined) -> Joined:
        joined = self._numbers(names, seen, start)
        if "shared_friction" not in names:
            return joined
        travels, left = self._left(replace(joined, cross=None).model(self.simulator))
        e = _without_means(left)
        e = e - self._of_axes(travels, e, seen)
        ends = np.cumsum([len(w) for w in travels])[:-1]
        cross = shared_friction(travels, np.split(e, ends), self.simulator.dt_s, seen)
        return self._numbers(names, seen, replace(joined, cross=cross))

    def _numbers(self, names: frozenset[str], seen: Mask, start: Joined) -> Joined:
        """Numbers of least error on the samples seen; those of other effects are zero."""
        free = sorted(k for name in names for k in FREE[name])
        q = np.zeros(len(start.q))
        if not free:
            return replace(start, q=q)

        def moved(values: Vec) -> Joined:
            numbers = q.copy()
            numbers[free] = values
            return replace(start, q=numbers)

        answer = least_squares(
            lambda values: self.errors(moved(values), seen)[seen].ravel(),
            np.clip(start.q[free], -0.99 * _MOST, 0.99 * _MOST),
            bounds=(-_MOST, _MOST),
            diff_step=_STEP,
            xtol=1e-5,
            ftol=1e-7,  # of linear axes only A M is known: the valley is long where they are nearly so
            max_nfev=_MOST_STEPS,
        )
        return moved(answer.x)

    def blocks(self, joined: Joined, corrected: bool = True) -> Blocks:
        """Squared errors of the tip on the final samples, in blocks of three seconds."""
        size = np.sum(self.errors(joined, ~self.final, corrected) ** 2, axis=1)
        owner = np.repeat(np.arange(len(self.trials)), [len(trial) for trial in self.trials])[self.final]
        at = np.concatenate([np.arange(len(trial)) for trial in self.trials])[self.final]
        label = np.stack([owner, (at * self.simulator.dt_s / _BLOCK_S).astype(int)], axis=1)
        each, number = np.unique(label, axis=0, return_inverse=True)
        number = number.ravel()
        return Blocks(
            np.bincount(number, size[self.final]).astype(np.float64), np.bincount(number).astype(np.float64), each[:, 0]
        )


def find_joins(data: JoinTrials, seed: int, names: Collection[str] = tuple(FREE)) -> tuple[KnownJoins, TwoAxisModel]:
    """Effects between the axes, and the simulator with them.

    One effect after another is added that lowers the held-out error by two of its standard errors and by a fifth of the
    structural error. Effects that are not needed any more are taken back. One whose closed share on the final trials
    may be zero is none.

    Args:
        seed: of the intervals.
        names: effects that are looked for.
    """
    as_given = Joined(np.zeros(4), data.simulator.cross_friction)
    nothing = data.tried(frozenset(), as_given)
    floor_mse = _noise_mse(data, nothing)
    enough = sum(trial.duration_s for trial in data.trials) >= LEAST_S
    offered = [name for name in FREE if name in names] if enough else []
    chosen = _chosen(data, nothing, floor_mse, offered)
    while chosen.names:
        known = _measured(data, chosen, nothing, floor_mse, seed)
        unproven = [effect.name for effect in known.effects if effect.closed_ci90[0] <= 0]
        if not unproven:
            known = replace(known, ambiguity=_ambiguity(data, chosen, floor_mse, offered))
            return known, chosen.joined.model(data.simulator)
        chosen = data.tried(chosen.names - {unproven[0]}, as_given)
    return _measured(data, nothing, nothing, floor_mse, seed), data.simulator


def _chosen(data: JoinTrials, nothing: Tried, floor_mse: float, offered: Sequence[str]) -> Tried:
    """Effects that count together."""
    chosen = nothing
    while True:
        more = [chosen.names | {name} for name in offered if name not in chosen.names]
        some = [data.tried(names, chosen.joined) for names in data.worth_trying(more, chosen, floor_mse)]
        good = [one for one in some if one.better_than(chosen, floor_mse)]
        if not good:
            break
        best = min(good, key=lambda one: float(one.squares.mean()))
        alike = [one for one in good if one.alike(best, chosen, floor_mse)]
        # Friction has many weights, and may stand for numbers that are not free yet.
        chosen = min(alike, key=lambda one: ("shared_friction" in one.names - chosen.names, float(one.squares.mean())))
    for name in sorted(chosen.names):
        fewer = data.tried(chosen.names - {name}, chosen.joined)
        if len(chosen.names) > 1 and not chosen.better_than(fewer, floor_mse):
            chosen = fewer
    return chosen


def _ambiguity(
    data: JoinTrials, chosen: Tried, floor_mse: float, offered: Sequence[str]
) -> tuple[tuple[str, ...], ...]:
    """Sets of an effect and those that do as well in its place."""
    sets = []
    for name in sorted(chosen.names):
        rest = chosen.names - {name}
        swapped = {other: rest | {other} for other in offered if other not in chosen.names}
        fewer = data.tried(rest, chosen.joined)
        near = data.worth_trying(list(swapped.values()), fewer, floor_mse)
        rivals = [
            other
            for other, names in swapped.items()
            if names in near and data.tried(names, chosen.joined).alike(chosen, fewer, floor_mse)
        ]
        sets += [(name, *rivals)] if rivals else []
    return tuple(sets)


def _measured(data: JoinTrials, chosen: Tried, nothing: Tried, floor_mse: float, seed: int) -> KnownJoins:
    """Sizes of the effects, and the shares that they close on the final trials."""

    def blocks(names: frozenset[str]) -> Blocks:
        return data.blocks(data.tried(names, chosen.joined).joined)

    before, after = blocks(frozenset()), blocks(chosen.names)
    shares = ClosedShares(before, min(floor_mse, after.mse, before.mse), _SPREAD, seed)
    effects = []
    for name, (share, ci90) in shares.of_causes(chosen.names, blocks).items():
        values = _values(data, chosen.joined, name)
        folds = [_values(data, fold, name) for fold in chosen.folds]
        half = {key: _T90 * _jackknife([fold[key] for fold in folds]) for key in values}
        effects.append(
            JoinEffect(
                name=name,
                parameters=values,
                ci90={key: (value - half[key], value + half[key]) for key, value in values.items()},
                closed_share=share,
                closed_ci90=ci90,
                rmse_before_deg=float(np.sqrt(blocks(chosen.names - {name}).mse)),
                rmse_after_deg=float(np.sqrt(after.mse)),
            )
        )
    nominal, joined = (data.blocks(one.joined, corrected=False) for one in (nothing, chosen))
    gap = JoinGap(
        nominal_rmse_deg=float(np.sqrt(nominal.mse)),
        joined_rmse_deg=float(np.sqrt(joined.mse)),
        between_rmse_deg=float(np.sqrt(before.mse)),
        left_rmse_deg=float(np.sqrt(after.mse)),
        floor_rmse_deg=float(np.sqrt(floor_mse)),
        final_trials=data.names,
    )
    return KnownJoins(tuple(sorted(effects, key=lambda one: -one.closed_share)), (), gap, data.held_out)


def _values(data: JoinTrials, joined: Joined, name: str) -> dict[str, float]:
    """Numbers of an effect, see `diagnosis.UNITS`."""
    a, b, p, q = joined.q.tolist()
    if name == "misalignment":
        return {"turn_deg": float(np.degrees(0.5 * (a + b))), "skew_deg": float(np.degrees(a - b))}
    if name == "cross_coupling":
        return {"x_by_y": p, "y_by_x": q, "turn_deg": float(np.degrees(np.arctan(0.5 * (q - p))))}
    changes = []
    for trial in data.trials:
        w = joined.model(data.simulator).travels(trial.commands)
        both = joined.cross, data.simulator.cross_friction
        after, before = (np.zeros_like(w) if c is None else c.run(w, data.simulator.dt_s) for c in both)
        changes.append(after - before)
    x, y = np.std(np.vstack(changes), axis=0).tolist()
    return {"x_deg": x, "y_deg": y}


def _without_means(parts: Sequence[Vec]) -> Vec:
    return np.vstack([part - part.mean(0) for part in parts])


def _mse(errors: Vec) -> float:
    """Mean square length of errors (T, 2)."""
    return float(np.mean(np.sum(errors**2, axis=1)))


def _noise_mse(data: JoinTrials, nothing: Tried) -> float:
    """Mean square length of the sensor's white noise [deg^2]."""
    ends = np.cumsum([len(trial) for trial in data.trials])[:-1]
    errors = np.split(data.errors(nothing.joined, ~data.final), ends)
    return sum(white_noise([np.ascontiguousarray(e[:, i]) for e in errors]) ** 2 for i in range(AXES))


def _error_of_mean(values: Vec) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values)))


def _jackknife(values: Sequence[float]) -> float:
    """Standard error of a number by its values without one part after another."""
    return float(np.sqrt((len(values) - 1) / len(values) * np.sum((np.array(values) - np.mean(values)) ** 2)))
