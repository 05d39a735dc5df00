"""Contract tests of effects, on which simulators and the diagnosis rely."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import casadi as ca
import numpy as np

from hystmpc.models.effects.effect import Effect, Scale, base_name
from hystmpc.models.operators.operator import Operator
from hystmpc.trials.types import Vec

from .wire import require

_DT_S = 0.04
_SCALE = Scale(low=0.0, high=6.0, angle_low=20.0, angle_high=90.0, duration_s=60.0, total_s=180.0, dt_s=_DT_S)
_STEP, _NEAR = 1e-5, 1e-3  # of a difference quotient, and its tolerance


class EffectContract:
    """Contract tests of an effect: derive a class whose name begins with `Test`, give it `effect`, run pytest.

    Attributes:
        effect: effect under test; need not be installed.
        jumps: share of the samples in which the equation may jump, and has no derivative.
        moves_at_rest: whether the effect moves without input, as a drift does.
    """

    effect: Effect
    jumps: float = 0.02
    moves_at_rest: bool = False

    def test_with_its_neutral_values_it_changes_nothing(self) -> None:
        """With neutral values the output of an operator is its input."""
        operator = next(self._operators())
        neutral = operator.with_values(self.effect.neutral_values(operator))
        for side, u in self._signals():
            off = float(np.max(np.abs(_run(neutral, u) - u)))
            require(off < 1e-4 * float(np.ptp(u)), f"as neutral it changes the {side} by {off:.3g}")

    def test_as_shown_it_is_seen(self) -> None:
        """The values of `shown` change a signal by more than a hundredth of its range."""
        _, u = next(self._signals())
        for values in self.effect.shown:
            off = float(np.max(np.abs(_run(self._with(values), u) - u)))
            require(off > 0.01 * float(np.ptp(u)), f"with {dict(values)} it changes the signal by {off:.3g} only")

    def test_at_rest_nothing_moves(self) -> None:
        """The output stays constant under a constant input after `settling_samples`."""
        if self.moves_at_rest:
            return
        for operator in self._each():
            u = np.full(operator.settling_samples + 20, 3.0)
            y = _run(operator, u)[operator.settling_samples - 1 :]
            require(float(np.ptp(y)) < 1e-9, f"the input rests, and the output moves by {float(np.ptp(y)):.3g}")

    def test_finite_signals_stay_finite(self) -> None:
        """Finite inputs give finite outputs, also with parameters at their bounds."""
        for operator in self._each():
            for _, u in self._signals():
                require(bool(np.all(np.isfinite(_run(operator, u)))), f"not finite with {operator}")
        for operator in self._operators():
            for candidate in self.effect.forms(_SCALE):
                bounds = ({f.name: f.lower for f in candidate.free}, {f.name: f.upper for f in candidate.free})
                for values in bounds:
                    names = [p.name for p in operator.parameters]
                    at_bounds = [values.get(n, v) for n, v in zip(names, operator.values, strict=True)]
                    _, u = next(self._signals())
                    y = _run(operator.with_values(at_bounds), u)
                    require(bool(np.all(np.isfinite(y))), f"not finite at the bounds {values}")

    def test_its_derivatives_are_those_of_its_equation(self) -> None:
        """Derivatives by input and parameters at `shown` lie between the one-sided difference quotients."""
        for operator in (self._with(values) for values in self.effect.shown):
            off = _derivative_errors(operator, next(self._signals())[1])
            wrong = float(np.mean(off > _NEAR))
            require(wrong <= self.jumps, f"the derivatives differ in {100 * wrong:.0f} % of the samples")

    def test_every_parameter_says_what_it_is(self) -> None:
        """Each parameter has unit, meaning and bounds; neutral values belong to parameters."""
        known = {base_name(p.name) for operator in self._operators() for p in operator.parameters}
        for operator in self._operators():
            for p in operator.parameters:
                require(bool(p.meaning and p.unit), f"{p.name} lacks unit or meaning")
                require(p.lower < p.upper, f"{p.name}: bounds {p.lower} to {p.upper}")
        stray = set(self.effect.neutral) - known
        require(not stray, f"neutral names {', '.join(sorted(stray))}, which are no parameters")
        require(bool(self.effect.equation and self.effect.apart), "equation and apart have to be said")

    def test_its_forms_can_be_fitted(self) -> None:
        """Each form frees existing parameters, starts within their bounds, and acts on an allowed side."""
        forms = self.effect.forms(_SCALE)
        require(bool(forms), "no forms: a diagnosis cannot look for it")
        for form in forms:
            known = {p.name for operator in form.operators for p in operator.parameters}
            stray = {f.name for f in form.free} - known
            require(form.effect == self.effect.name, f"the form {form.label} names another effect")
            require(not stray, f"{form.label}: {', '.join(sorted(stray))} are no parameters of its operators")
            require(form.side in self.effect.sides, f"{form.label}: side {form.side}, not among {self.effect.sides}")
            require(bool(form.starts), f"{form.label}: no start")
            for start in form.starts:
                require(
                    len(start) == len(form.free), f"{form.label}: {len(start)} values for {len(form.free)} freedoms"
                )
                for value, f in zip(start, form.free, strict=True):
                    require(f.lower <= value <= f.upper, f"{form.label}: {f.name} starts at {value}, beyond its bounds")

    def _operators(self) -> Iterator[Operator]:
        kinds = (self.effect.operator, *self.effect.other_forms)
        for kind in kinds:
            yield kind.template(**{key: kind.default_sizes.get(key, 1) for key in kind.shape})

    def _with(self, given: Mapping[str, float]) -> Operator:
        operator = next(self._operators())
        names = [p.name for p in operator.parameters]
        defaults = [self.effect.optional(name) for name in names]
        pairs = zip(names, defaults, operator.values, strict=True)
        return operator.with_values([given.get(n, v if d is None else d) for n, d, v in pairs])

    def _each(self) -> Iterator[Operator]:
        yield from self._operators()
        for values in self.effect.shown:
            yield self._with(values)

    def _signals(self) -> Iterator[tuple[str, Vec]]:
        """Test signals for each side: a growing sine, holds, steps and noise in the range of a catheter."""
        random, t = np.random.default_rng(1), _DT_S * np.arange(150)
        motion = 3.0 - np.cos(2.0 * t) * np.minimum(t, 3.0)
        motion[50:65] = motion[50]
        motion[100:] = 0.5
        motion[120:] = np.clip(motion[120:] + np.cumsum(0.3 * random.standard_normal(30)), 0.0, 6.0)
        for side in self.effect.sides:
            yield side, motion if side == "command" else 20.0 + 70.0 / 6.0 * motion


def _stepped(operator: Operator) -> tuple[ca.Function, int]:
    size, count = len(operator.states), len(operator.values)
    x, u, p = ca.SX.sym("x", size), ca.SX.sym("u"), ca.SX.sym("p", count)
    following, y = operator.equation(x, u, p, _DT_S)
    return ca.Function("step", [x, u, p], [following, y]), size


def _run(operator: Operator, u: Vec) -> Vec:
    """Output of an operator for an input (T,), from rest at its first value."""
    step, _ = _stepped(operator)
    values = ca.DM(list(operator.values))
    x, y = operator.at_rest(ca.DM(u[0]), ca.DM(u[0]), values), np.empty(u.size)
    for k, given in enumerate(u.tolist()):
        x, out = step(x, given, values)
        y[k] = float(out)
    return y


def _derivative_errors(operator: Operator, u: Vec) -> Vec:
    """Relative distance of the derivatives from the interval of the one-sided difference quotients, by sample."""
    step, size = _stepped(operator)
    x, given, p = ca.SX.sym("x", size), ca.SX.sym("u"), ca.SX.sym("p", len(operator.values))
    y = step(x, given, p)[1]
    slope = ca.Function("slope", [x, given, p], [ca.jacobian(y, ca.vertcat(given, p))])
    values = np.array(operator.values)
    inside = [p.lower < v < p.upper for p, v in zip(operator.parameters, operator.values, strict=True)]
    free = [0, *(1 + np.flatnonzero(inside))]  # at a bound only one side is free
    state, off = operator.at_rest(ca.DM(u[0]), ca.DM(u[0]), ca.DM(values)), np.empty(u.size)
    for k, command in enumerate(u.tolist()):
        exact, point = np.asarray(slope(state, command, values)).ravel(), np.r_[command, values]
        here, worst = float(step(state, command, values)[1]), 0.0
        for j in free:
            move = np.zeros(point.size)
            move[j] = _STEP * max(1.0, abs(point[j]))
            ends = [float(step(state, q[0], q[1:])[1]) for q in (point + move, point - move)]
            low, high = sorted(((ends[0] - here) / move[j], (here - ends[1]) / move[j]))
            beyond = max(low - exact[j], exact[j] - high, 0.0)
            worst = max(worst, beyond / max(1.0, abs(exact[j])))
        off[k] = worst
        state = step(state, command, values)[0]
    return off
