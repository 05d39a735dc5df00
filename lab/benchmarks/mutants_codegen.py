"""Mutants of the exported C, the FMU, the planner's face and the ros2_control plugin."""

from __future__ import annotations

from mutant import Mutant, mutated_file  # isort: skip

_C = ("test_fuzz.py", "test_commands.py")
_header = mutated_file("codegen", "c/hystmpc.h", "test_fuzz.py")
_controller = mutated_file("codegen", "c/controller.c", *_C)
_estimator = mutated_file("codegen", "c/estimator.c", *_C)
_feedback = mutated_file("codegen", "c/feedback.c", *_C)
_device = mutated_file("codegen", "fmu/c/device.c", "test_fmu.py")
_planner = mutated_file("ctrl", "planner/tip_controller.py", "test_tip_safety.py", "test_tip_types.py")
_memory = mutated_file("ctrl", "planner/memory.py", "test_tip_safety.py", "test_tip_types.py", "test_tip_controller.py")
_settings = mutated_file("ctrl", "planner/settings.py", "test_tip_types.py")
_numbers = mutated_file("ctrl", "limits.py", "test_tip_types.py")
_reference = mutated_file("ctrl", "guarded.py", "test_tip_types.py", "test_fallback.py", "test_contract.py")
_plugin = mutated_file("ros2", "hystmpc_controller/src/controller.cpp", "test_controller.py")

MUTANTS: tuple[Mutant, ...] = (
    _header("C for finite numbers only is compiled", "__FINITE_MATH_ONLY__ > 0", "__FINITE_MATH_ONLY__ > 1"),
    _controller(
        "a refused start leaves the controller running", "        hystmpc_stop(c);\n        return", "        return"
    ),
    _controller("a refused start forgets what was sent", "if (!started(c)) c->estimate.command", "c->estimate.command"),
    _controller(
        "not-a-number from another sender is remembered",
        "advance(c, within_range(command, c->estimate.command));",
        "advance(c, command);",
    ),
    _controller("a command of another kind is taken as it is", "clamp(finite(u) ? u : otherwise,", "clamp(u,"),
    _controller("what was never started steps", "if (!started(c)) return stand_still(c);", ""),
    _controller("what was never started looks on", "if (!started(c)) return 1;", ""),
    _controller(
        "memory that nobody has written is sent",
        "answer.u = within_range(c->estimate.command, HYSTMPC_LOWER);",
        "answer.u = c->estimate.command;",
    ),
    _controller(
        "any memory but zero has been started",
        "return c->estimate.started == HYSTMPC_MARK;",
        "return c->estimate.started != 0;",
    ),
    _controller("a plan of before another sent is taken up", "    forget(c);\n    advance", "    advance"),
    _controller(
        "a step in C is not limited", "answer.u = within_limits(out.u, c->estimate.command);", "answer.u = out.u;"
    ),
    _controller("a latched stop in C is released", "    if (c->stopped) {", "    if (c->stopped && c->failures > 0) {"),
    _controller(
        "a reference in C that is not-a-number is followed",
        "if (!(absolute(wanted[k]) <= HYSTMPC_ANGLE_BOUND)) {",
        "if (absolute(wanted[k]) > HYSTMPC_ANGLE_BOUND) {",
    ),
    _controller(
        "missing measurements are bridged for ever in C",
        "if (c->estimate.missing > HYSTMPC_MOST_MISSING) {",
        "if (c->estimate.missing < 0) {",
    ),
    _controller(
        "the stop in C comes a sample late", "c->failures >= HYSTMPC_STOP_AFTER", "c->failures > HYSTMPC_STOP_AFTER"
    ),
    _controller(
        "a plan in C is trusted without measurements", "    if (blind) {", "    if (blind && c->failures < 0) {"
    ),
    _controller("no time in C makes no difference", "    if (c->hurried) {", "    if (c->hurried < 0) {"),
    _controller(
        "the stop in C does not go to the safe command",
        "HYSTMPC_SAFE_KNOWN ? HYSTMPC_SAFE : c->estimate.command",
        "c->estimate.command",
    ),
    _controller(
        "an accepted start does not release the stop",
        "c->failures = c->stopped = c->hurried = 0;",
        "c->failures = c->hurried = 0;",
    ),
    _estimator("an absurd angle is one in C", "absolute(y) <= HYSTMPC_ANGLE_BOUND ? y : (real)NAN", "y"),
    _estimator(
        "a start in C under no number is accepted",
        "if (!(HYSTMPC_LOWER <= u && u <= HYSTMPC_UPPER)) return",
        "if (u < HYSTMPC_LOWER || u > HYSTMPC_UPPER) return",
    ),
    _estimator(
        "a start in C far from the model is accepted",
        "    if (!(absolute(y - angle) <= HYSTMPC_REST_TOLERANCE)) return HYSTMPC_NOT_AT_REST;\n",
        "",
    ),
    _estimator(
        "a sensor that walks away leaves no noise filter",
        "if (!(total > HYSTMPC_LEAST_WEIGHT)) {",
        "if (total < R(0.0)) {",
    ),
    _estimator(
        "missing measurements in C are not counted",
        "        e->missing = later(e->missing);\n        return 0;",
        "        e->missing = 0;\n        return 0;",
    ),
    _estimator(
        "a count of samples runs over",
        "samples < HYSTMPC_MOST_SAMPLES ? samples + 1 : samples",
        "samples + 1",
    ),
    _feedback("the command falls at any rate in C", "most(HYSTMPC_LOWER, at - HYSTMPC_REACH)", "HYSTMPC_LOWER"),
    _feedback(
        "the greatest command is not applied in C", "least(HYSTMPC_UPPER, at + HYSTMPC_REACH)", "at + HYSTMPC_REACH"
    ),
    _device("a step of the FMU may last for ever", "if (!(whole <= (double)MOST_SAMPLES &&", "if (!(whole <= 1e306 &&"),
    _device("samples of the FMU run over", "s->samples <= INT64_MAX - MOST_SAMPLES", "s->samples <= INT64_MAX"),
    _device(
        "an angle of the FMU may be not-a-number", "return plain_number(sum) && plain_number(s->output);", "return 1;"
    ),
    _device(
        "a step of the FMU that fails goes half of the way", "        *s = before;\n        return", "        return"
    ),
    _device(
        "not-a-number is a time of the FMU",
        "if (!(fabs(at_s - now_s) <= 0.5 * HYSTMPC_SAMPLE_S)) {",
        "if (fabs(at_s - now_s) > 0.5 * HYSTMPC_SAMPLE_S) {",
    ),
    _device("the FMU stops at not-a-number", "if (!(stop_s >= start_s))", "if (stop_s < start_s)"),
    _device(
        "the FMU starts where samples cannot be counted",
        "if (!(fabs(start_s + HYSTMPC_SAMPLE_S - start_s - HYSTMPC_SAMPLE_S) <= 1e-3 * HYSTMPC_SAMPLE_S))",
        "if (!plain_number(start_s))",
    ),
    _device("the FMU is compiled for finite numbers only", "__FINITE_MATH_ONLY__ > 0", "__FINITE_MATH_ONLY__ > 1"),
    _memory(
        "a skipped sample goes on with the ramp of a stop",
        "    if memory.stopped:  # a step",
        "    if memory.stopped and memory.steps < 0:  # a step",
    ),
    _memory(
        "a sample skipped before the start counts as sent",
        "    if control is None:\n        return memory\n    if memory.stopped:  #",
        "    if control is None:\n        return replace(memory, sent=True)\n    if memory.stopped:  #",
    ),
    _memory(
        "what is taken up is limited from the command of then",
        "control=holding(memory.control, held), sent=present.sent)",
        "control=memory.control, sent=present.sent)",
    ),
    _memory(
        "what is no number counts as one",
        "    if number is None:\n        raise",
        "    if number is None and value:\n        raise",
    ),
    _memory(
        "a stop before the start is forgotten",
        "    if memory.halted:\n        control = ",
        "    if memory.steps:\n        control = ",
    ),
    _planner(
        "steps taken elsewhere do not move the command",
        "after = holding(memory.control if control is None else control, u)",
        "after = memory.control if control is None else control",
    ),
    _planner(
        "a reset starts at the least command",
        "            held = self._memory.command.u\n            if command",
        "            held = self._assembly.limits.lower\n            if command",
    ),
    _settings("anything is a file of settings", "if not isinstance(source, str | Path):", "if source is None:"),
    _numbers("a text is a number", "isinstance(value, str | bytes | bytearray | bool |", "isinstance(value, bool |"),
    _numbers("a truth value is a number", "bytearray | bool | np.bool_ |", "bytearray |"),
    _numbers(
        "what a reading raises leaves the step",
        "    except Exception:  # noqa: BLE001 - what `__float__` of anything raises\n        return None",
        "    except (TypeError, ValueError):\n        return None",
    ),
    _numbers("texts are numbers", 'array.dtype.kind in "iufO"', 'array.dtype.kind in "iufOUSb"'),
    _reference(
        "a reference that is not-a-number is followed",
        "if not np.abs(wanted).max() <= ANGLE_BOUND_DEG:",
        "if np.abs(wanted).max() > ANGLE_BOUND_DEG:",
    ),
    _plugin(
        "the plugin writes where the drive holds too much",
        "if (!admissible(held)) {  // it",
        "if (std::isnan(held)) {  // it",
    ),
    _plugin(
        "the plugin goes over another writer", "if (samples >= GAP || !same(held, sent_)) {", "if (samples >= GAP) {"
    ),
    _plugin(
        "the plugin sends at once after a pause",
        "if (samples >= GAP || !same(held, sent_)) {",
        "if (!same(held, sent_)) {",
    ),
    _plugin(
        "the plugin answers updates as fast as they come", "    if (samples < SHORTEST) return return_type::OK;\n", ""
    ),
    _plugin(
        "a deactivation writes where it is not known what is held",
        "    if (!admissible(held)) return CallbackReturn::SUCCESS;\n",
        "",
    ),
    _plugin(
        "a deactivation goes over another writer",
        "    if (!same(held, sent_)) hystmpc_look_on(controller_.get(), real_of(NONE), real_of(held));\n",
        "",
    ),
    _plugin(
        "an angle beyond the sensor is one",
        "angle < least_angle_ || angle > greatest_angle_ ? NONE : to_deg_ * angle",
        "to_deg_ * angle",
    ),
    _plugin(
        "the plugin does not stop",
        "if (stop_.exchange(false)) hystmpc_stop",
        "if (stop_.exchange(false) && stop_.load()) hystmpc_stop",
    ),
)
