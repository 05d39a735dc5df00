"""Mutants of the controllers: limits, guard, ladder, estimator, learning, handover."""

from __future__ import annotations

from mutant import Mutant, mutated_file  # isort: skip

_limits = mutated_file("ctrl", "limits.py", "test_limits.py", "test_contract.py")
_guarded = mutated_file(
    "ctrl", "guarded.py", "test_fallback.py", "test_contract.py", "test_tip_controller.py", "test_tip_replay.py"
)
_fallback = mutated_file("ctrl", "fallback.py", "test_fallback.py", "test_contract.py")
_estimator = mutated_file("ctrl", "estimation/observer.py", "test_estimator.py", "test_fallback.py")
_noise = mutated_file("ctrl", "estimation/noise.py", "test_noise.py", "test_estimator.py")
_steps = mutated_file("ctrl", "estimation/noise.py", "test_quantised.py")
_hold = mutated_file("ctrl", "mpc.py", "test_quantised.py")
_pid = mutated_file("ctrl", "feedback/pid.py", "test_quantised.py")
_deaf = mutated_file("ctrl", "handover.py", "test_quantised.py")
_bank = mutated_file("ctrl", "learning/bank.py", "test_learning.py")
_basis = mutated_file("ctrl", "learning/basis.py", "test_learning.py")
_learning = mutated_file("ctrl", "learning/estimator.py", "test_learning.py")
_handover = mutated_file("ctrl", "handover.py", "test_handover.py")

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
        "u = self._limits.clip(level.u, estimate.command, self._dt)",
        "u = level.u",
    ),
    _guarded(
        "the command is limited from itself",
        "u = self._limits.clip(level.u, estimate.command, self._dt)",
        "u = self._limits.clip(level.u, level.u, self._dt)",
    ),
    _guarded("a latched stop is released", "if fallback.stopped:", "if fallback.stopped and fallback.failures < 0:"),
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
        "attempt(lambda: self._observer.advance(estimate, level.u))",
    ),
    _guarded(
        "a start beyond the limits is accepted",
        "if not (math.isfinite(angle) and held is not None and low <= held <= high):",
        "if not math.isfinite(angle) or held is None:",
    ),
    _guarded(
        "a stop that is asked for is forgotten", "fallback=self._fallback.halt(cause))", "fallback=state.fallback)"
    ),
    _guarded(
        "recorded commands beyond the limits are replayed",
        "np.all((commands >= low) & (commands <= high))",
        "np.all(np.isfinite(commands))",
    ),
    _fallback(
        "the stop is never latched", "state = replace(state, stopped=True)", "state = replace(state, stopped=False)"
    ),
    _fallback("the shifted plan is skipped", "if state.plan.size:", "if state.plan.size and state.failures < 0:"),
    _fallback(
        "the shifted plan is not shifted",
        "return level, replace(state, plan=state.plan[1:], predicted=state.predicted[1:])",
        "return level, state",
    ),
    _fallback("the inverse is skipped", "if self._inverse is None:", "if self._inverse is not None:"),
    _fallback(
        "an inverse that is not finite is taken",
        'return (u, "") if math.isfinite(u) else (None, f"the inverse answers {u}")',
        'return u, ""',
    ),
    _fallback("the stop does not go to the safe command", "given.u_last if safe is None else safe", "given.u_last"),
    _fallback("failures are not counted", "failures=state.failures + 1", "failures=state.failures"),
    _fallback(
        "the stop comes one sample late",
        "state.failures >= self._settings.stop_after_failures",
        "state.failures > self._settings.stop_after_failures",
    ),
    _fallback(
        "a safe command beyond the limits is accepted",
        "if safe is not None and not limits.lower <= safe <= limits.upper:",
        "if safe is not None and not math.isfinite(safe):",
    ),
    _fallback("a plan is trusted without measurements", "if blind:", "if blind and state.failures < 0:"),
    _fallback(
        "a success does not shift the plan",
        "FallbackState(plan=plan[1:], predicted=predicted[1:])",
        "FallbackState(plan=plan)",
    ),
    _noise(
        "the bound of the disturbance is removed",
        "min(max(bank[0, i] + gain * error, -limit), limit)",
        "bank[0, i] + gain * error",
    ),
    _noise(
        "the disturbance is bounded on one side only",
        "min(max(bank[0, i] + gain * error, -limit), limit)",
        "min(bank[0, i] + gain * error, limit)",
    ),
    _steps(
        "equal readings are better than their steps",
        "np.maximum(usual * _SENSOR_FACTORS, least)",
        "usual * _SENSOR_FACTORS",
    ),
    _hold(
        "a hold is left within a step of the readings",
        "_LEAVE_SIGMAS * sigma + self._step if",
        "_LEAVE_SIGMAS * sigma if",
    ),
    _hold(
        "a hold is entered a whole step away",
        "if before.holding else waited * sigma",
        "if before.holding else waited * sigma + self._step",
    ),
    _hold(
        "the hold does not know the steps",
        "HoldRule(settings.hold, predictor.dt, delay, step)",
        "HoldRule(settings.hold, predictor.dt, delay)",
    ),
    _pid("half a step is integrated", "least = _HALF * step_deg", "least = 0.0"),
    _pid("a greater dead zone is narrowed", "return self if self.dead_zone_deg >= least else", "return"),
    _deaf("feedback that takes over hunts", "found.deaf_to(predictor.noise.sensor_resolution_deg)", "found"),
    _noise("the innovation has the wrong sign", "bank[0, i] + gain * error", "bank[0, i] - gain * error"),
    _noise("the gain of a bank is not bounded", "min(before * by_spread, most)", "before / spread"),
    _noise("weights may die", "share * by_model[i]", "0.0"),
    _noise("a given sigma is not kept", "if given is not None:", "if given is not None and known < 0.0:"),
    _noise("a spike says as much as it likes", "_FREEDOM = 7.0", "_FREEDOM = 1e9"),
    _estimator(
        "outliers are taken",
        "if not (abs(offset - estimate.disturbance) <= far or abs(angle - estimate.measured) <= far):",
        "if math.isnan(offset):",
    ),
    _estimator(
        "not-a-number is taken for a measurement",
        "if not (abs(offset - estimate.disturbance) <= far or abs(angle - estimate.measured) <= far):",
        "if abs(offset - estimate.disturbance) > far and abs(angle - estimate.measured) > far:",
    ),
    _estimator(
        "an angle near the last one is an outlier",
        "if not (abs(offset - estimate.disturbance) <= far or abs(angle - estimate.measured) <= far):",
        "if not abs(offset - estimate.disturbance) <= far:",
    ),
    _estimator(
        "missing measurements are not counted",
        "estimate, missing=estimate.missing + 1)\n        if not",
        "estimate, missing=0)\n        if not",
    ),
    _estimator(
        "a start far from the model is accepted",
        "if abs(y - angle) > limit_deg:",
        "if math.isnan(y - angle):",
    ),
    _estimator(
        "a model that answers not-a-number is advanced",
        'raise ArithmeticError(f"the model answers {angle} deg to command {u:.6g}")',
        "pass",
    ),
    _estimator(
        "a model that answers an absurd angle is trusted",
        "abs(angle) <= ANGLE_BOUND_DEG and",
        "abs(angle) < math.inf and",
    ),
    _estimator(
        "the dead band winds the disturbance up",
        "if not estimate.responsive[0]:",
        "if not estimate.responsive:",
    ),
    _estimator(
        "the delay is not waited for", "angles=(*estimate.angles[1:], angle)", "angles=(angle,) * len(estimate.angles)"
    ),
    _bank(
        "the learned part acts whatever it foretells",
        "share=min(max((gained - _LEAST_GAIN) / _FULL_GAIN, 0.0), 1.0)",
        "share=1.0",
    ),
    _bank(
        "the share of the learned part is not bounded",
        "min(max((gained - _LEAST_GAIN) / _FULL_GAIN, 0.0), 1.0)",
        "gained",
    ),
    _bank("the worst drive is taken", "np.argmin(scores[:DRIVES])", "np.argmax(scores[:DRIVES])"),
    _bank(
        "forecasts are judged in a hold", "if means[_NOTHING] <= _MOVING * self._noise:", "if means[_NOTHING] < 0.0:"
    ),
    _bank("forecasts see the measurements", "forecast -= h[a] * frozen[n, a]", "forecast -= h[a] * z[n, a]"),
    _bank("forecasts are never begun anew", "count=0, frozen=z,", "count=0,"),
    _bank("the weights walk in a hold", "walk[a] * travel", "walk[a]"),
    _bank("a jump in a hold moves the weights", "travel == 0.0", "travel < 0.0"),
    _bank("a delay that is told is learned again", "n % DELAYS + delay", "n % DELAYS"),
    _bank("a model that has been learned is distrusted", "min(means[_MODEL], means[best])", "means[_MODEL]"),
    _bank("one block says as much as it likes", "/ means[_NOTHING]), _WORST)", "/ means[_NOTHING]), math.inf)"),
    _basis("a learned play has no width", "v - RADII[i]), v + RADII[i])", "v), v)"),
    _basis(
        "the learned plays do not start at zero",
        "out[at] = memory[1 + i] - v0 - side * RADII[i]",
        "out[at] = memory[1 + i] - v0",
    ),
    _basis(
        "a learned delay is not waited for",
        "own[MEMORY + delay - 1 - k] if k < delay else (plan[k - delay] - low) / span",
        "(plan[k] - low) / span",
    ),
    _basis("the slope of a learned lag is that of none", "by[0, j] *= 1.0 - share", "by[0, j] *= 0.0"),
    _basis("the slope of a dead zone does not wait for it", "if v > ZONES[i]:", "if v > 0.0:"),
    _learning("the angle of now jumps with the weights", "noise[0] -= change", "noise[0] -= 0.0"),
    _learning("a jump at rest is no outlier", "far + self._bank.reach(learning.bank)", "1e3"),
    _learning("a jump behind a fast command is an outlier", "far + self._bank.reach(learning.bank)", "far"),
    _learning("angles on their way have the learned part of now", "back - k)", "back)"),
    _learning(
        "missing measurements of a learning controller are not counted", "missing=estimate.missing + 1", "missing=0"
    ),
    _handover(
        "the inverse takes over with a jump",
        "self._inverse_pid.taken_over(given) if",
        "self._inverse_pid.init(given.due, given.u_last) if",
    ),
    _handover(
        "the PID takes over with a jump",
        "else self._pid.taken_over(given)",
        "else self._pid.init(given.measured, given.u_last)",
    ),
    _handover("good forecasts are handed over", "distrust > threshold for", "distrust < threshold for"),
    _handover("it goes back and forth at a threshold", "distrust > _BACK * threshold", "distrust > threshold"),
    _handover("it never comes back", "min(at, best)", "at"),
    _handover(
        "another law takes over the memory of the last one", "if level != memory.level:", "if level == memory.level:"
    ),
    _handover("the log says that the MPC acts", "status, law.source)", "status, self.source)"),
)
