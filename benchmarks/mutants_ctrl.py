"""Mutants of the controllers: limits, guard, ladder, estimator."""

from __future__ import annotations

from mutant import Mutant, mutated_file  # isort: skip

_limits = mutated_file("ctrl", "limits.py", "test_limits.py", "test_contract.py")
_guarded = mutated_file(
    "ctrl", "guarded.py", "test_ladder.py", "test_contract.py", "test_tip_controller.py", "test_tip_replay.py"
)
_ladder = mutated_file("ctrl", "ladder.py", "test_ladder.py", "test_contract.py")
_estimator = mutated_file("ctrl", "estimator.py", "test_estimator.py", "test_ladder.py")

MUTANTS: tuple[Mutant, ...] = (
    _limits(
        "the rate limit is not applied",
        "return max(self.lower, last - self.rate * dt), min(self.upper, last + self.rate * dt)",
        "return self.lower, self.upper",
    ),
    _limits(
        "the greatest command is not applied",
        "min(self.upper, last + self.rate * dt)",
        "last + self.rate * dt",
    ),
    _limits(
        "the clip uses the wrong side",
        "return min(max(u if math.isfinite(u) else last, low), high)",
        "return max(min(u if math.isfinite(u) else last, low), high)",
    ),
    _limits("not-a-number passes the clip", "u if math.isfinite(u) else last", "u"),
    _limits(
        "a last command beyond the limits is taken as it is",
        "last = min(max(last, self.lower), self.upper)",
        "last = float(last)",
    ),
    _limits("an empty range is accepted", "self.lower >= self.upper", "self.lower > self.upper"),
    _limits("a rate of zero is accepted", "self.rate <= 0", "self.rate < 0"),
    _limits(
        "plans are limited per second, not per sample",
        "self.upper, self.rate * dt, last)",
        "self.upper, self.rate, last)",
    ),
    _guarded(
        "the command is not limited",
        "u = self._limits.clip(rung.u, estimate.command, self._dt)",
        "u = rung.u",
    ),
    _guarded(
        "the command is limited from itself",
        "u = self._limits.clip(rung.u, estimate.command, self._dt)",
        "u = self._limits.clip(rung.u, rung.u, self._dt)",
    ),
    _guarded("a latched stop is released", "if ladder.stopped:", "if ladder.stopped and ladder.failures < 0:"),
    _guarded("missing measurements are bridged for ever", "if missing > self._max_missing:", "if missing < 0:"),
    _guarded(
        "a proposal that is not finite is taken",
        "if proposal is not None and not math.isfinite(proposal.u):",
        "if proposal is None and not reason:",
    ),
    _guarded("a model that has failed is trusted", "if state.estimate.stalled:", "if state.estimate.stalled < 0:"),
    _guarded(
        "the model gets the command that was wanted, not the one sent",
        "attempt(lambda: self._observer.advance(estimate, u))",
        "attempt(lambda: self._observer.advance(estimate, rung.u))",
    ),
    _guarded(
        "a start beyond the limits is accepted",
        "if not (math.isfinite(usable_angle(y)) and low <= u <= high):",
        "if not math.isfinite(usable_angle(y)):",
    ),
    _guarded("a stop that is asked for is forgotten", "ladder=self._ladder.halt(cause))", "ladder=state.ladder)"),
    _guarded(
        "recorded commands beyond the limits are replayed",
        "np.all((commands >= low) & (commands <= high))",
        "np.all(np.isfinite(commands))",
    ),
    _ladder(
        "the stop is never latched", "state = replace(state, stopped=True)", "state = replace(state, stopped=False)"
    ),
    _ladder("the shifted plan is skipped", "if state.plan.size:", "if state.plan.size and state.failures < 0:"),
    _ladder(
        "the shifted plan is not shifted",
        "return rung, replace(state, plan=state.plan[1:], predicted=state.predicted[1:])",
        "return rung, state",
    ),
    _ladder("the inverse is skipped", "if self._inverse is None:", "if self._inverse is not None:"),
    _ladder(
        "an inverse that is not finite is taken",
        'return (u, "") if math.isfinite(u) else (None, f"the inverse answers {u}")',
        'return u, ""',
    ),
    _ladder(
        "the stop does not go to the safe command", "situation.u_last if safe is None else safe", "situation.u_last"
    ),
    _ladder("failures are not counted", "failures=state.failures + 1", "failures=state.failures"),
    _ladder(
        "the stop comes one sample late",
        "state.failures >= self._options.stop_after_failures",
        "state.failures > self._options.stop_after_failures",
    ),
    _ladder(
        "a safe command beyond the limits is accepted",
        "if safe is not None and not limits.lower <= safe <= limits.upper:",
        "if safe is not None and not math.isfinite(safe):",
    ),
    _ladder("a plan is trusted without measurements", "if blind:", "if blind and state.failures < 0:"),
    _ladder(
        "a success does not shift the plan",
        "LadderState(plan=plan[1:], predicted=predicted[1:])",
        "LadderState(plan=plan)",
    ),
    _estimator(
        "the bound of the disturbance is removed", "return min(max(disturbance, -limit), limit)", "return disturbance"
    ),
    _estimator(
        "the disturbance is bounded on one side only",
        "return min(max(disturbance, -limit), limit)",
        "return min(disturbance, limit)",
    ),
    _estimator(
        "outliers are taken",
        "if not abs(innovation) <= self._options.outlier_deg:",
        "if math.isnan(innovation):",
    ),
    _estimator(
        "not-a-number is taken for a measurement",
        "if not abs(innovation) <= self._options.outlier_deg:",
        "if abs(innovation) > self._options.outlier_deg:",
    ),
    _estimator(
        "the innovation has the wrong sign",
        "self._bounded(estimate.disturbance + gain * innovation)",
        "self._bounded(estimate.disturbance - gain * innovation)",
    ),
    _estimator("missing measurements are not counted", "missing=estimate.missing + 1)", "missing=0)"),
    _estimator(
        "a start far from the model is accepted",
        "if abs(y - angle) > self._options.disturbance_limit_deg:",
        "if math.isnan(y - angle):",
    ),
    _estimator(
        "a model that answers not-a-number is advanced",
        'raise ArithmeticError(f"the model answers {angle} deg to command {u:.6g}")',
        "pass",
    ),
    _estimator(
        "the dead band winds the disturbance up",
        "if estimate.responsive[0] else 0.0",
        "if estimate.responsive else 0.0",
    ),
    _estimator(
        "the delay is not waited for", "angles=(*estimate.angles[1:], angle)", "angles=(angle,) * len(estimate.angles)"
    ),
)
