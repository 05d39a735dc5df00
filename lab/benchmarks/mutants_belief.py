"""Mutants of what is believed: angles at receipt, held commands, motion, the first climb; the same in the loop in C."""

from __future__ import annotations

from mutant import Mutant, Mutated, mutated_file  # isort: skip

_intake = mutated_file("rig", "safety/intake.py", "test_intake.py")
_gate = mutated_file("rig", "safety/gate.py", "test_anchor.py")
_motion = mutated_file("rig", "safety/plausibility.py", "test_anchor.py")
_drive = mutated_file("rig", "safety/plausibility.py", "test_drive_following.py")
_bench = Mutated("rig", "rig/bench.py", ("tests/commissioning/test_watched.py",))
_taken = mutated_file("rig", "compiled/loop.c", "test_loop_in_c_parts.py")
_climb = mutated_file("commissioning", "climb.py", "test_watched.py")
_bounded = mutated_file("commissioning", "bounded.py", "test_watched.py")
_config = mutated_file("commissioning", "config.py", "test_motions.py")

MUTANTS: tuple[Mutant, ...] = (
    _intake("a delay that grows is never seen", "before + _DRIFT * max(heard_ns - then_ns, 0)", "flight"),
    _intake("clocks may drift apart by two per cent", "_DRIFT = 500e-6", "_DRIFT = 20e-3"),
    _intake("no clock drifts", "_DRIFT = 500e-6", "_DRIFT = 0.0"),
    _intake(
        "the newest clock reading is forgotten",
        "self._flight_ns[frame] = least, heard_ns",
        "self._flight_ns[frame] = least, then_ns",
    ),
    _intake("packets that queued are fresh", "flight - least)", "0.0 * least)"),
    _intake("noise of a fast stream is a jump", "_RATE_S = 0.02", "_RATE_S = 0.0002"),
    _intake(
        "small steps of a fast stream never add up",
        "if self._rated is None or taken_ns - self._rated[0] >= _RATE_S / _S:",
        "if taken_ns >= 0:",
    ),
    _intake(
        "a coarse sensor is frozen",
        "noisy = self._turns >= _NOISY and self._equal <= self._turns // _NOISY",
        "noisy = True",
    ),
    _intake("a sensor that repeats itself at rest is frozen", "and self._equal <= self._turns // _NOISY", ""),
    _intake(
        "no sensor is noisy enough",
        "self._turns += slope * self._slope < 0.0",
        "self._turns += slope * self._slope > 1e9",
    ),
    _intake("an angle that is not believed is not shown", "self._shown_deg = angle", "self._shown_deg = math.nan"),
    _intake("times out of range do not add up", "if out_s > self._longest_s:", "if out_s > 1e9:"),
    _intake("silences do not add up", "if silences_s > 2.0 * self._longest_s:", "if silences_s > 1e9:"),
    _intake(
        "single outliers add up", "elapsed_s if outside and self._was_outside else 0.0", "elapsed_s if outside else 0.0"
    ),
    _intake(
        "lost readings add up as rejected ones",
        "limit_s = self._age_limit_s if readings else 0.5 * self._longest_s",
        "limit_s = 0.0 * self._age_limit_s",
    ),
    _intake(
        "a silence counts once a sample",
        "self._added_s = silent_s if silent_s > limit_s else min(self._added_s, silent_s)",
        "self._added_s = 0.0",
    ),
    _intake(
        "what is no number is held", "if reading.listens and tells else math.nan", "if reading.listens else math.nan"
    ),
    _gate("what nothing has led to is believed", "<= held <= max(last, led) + self._tolerance:", "<= held:"),
    _gate("a false command below the last is believed", "min(last, led) - self._tolerance <= held <=", "held <="),
    _gate(
        "the watchdog is taken to act at once",
        "if boot_ns - sent_ns >= self._watchdog_ns else last",
        "if boot_ns >= sent_ns else last",
    ),
    _gate(
        "the watchdog is taken never to act",
        "led = self._safe if boot_ns - sent_ns >= self._watchdog_ns else last",
        "led = last",
    ),
    _gate("a false command is waited for without end", "if boot_ns - self._untrue_ns > _UNTRUE_NS:", "if boot_ns < 0:"),
    _gate(
        "a device that moves by itself is waited for without end",
        "elif boot_ns - self._lost_ns > _LONGEST_NS:",
        "elif boot_ns < 0:",
    ),
    _motion("a lag is a blocked tip", "_followed(self._lagged, command, elapsed_s / self._lag_s)", "command"),
    _motion("play is left nowhere", "_REVERSED_SHARE = 0.3, 0.5", "_REVERSED_SHARE = 0.3, 0.3"),
    _motion(
        "play is left everywhere",
        "_ONWARD_SHARE, _REVERSED_SHARE = 0.3, 0.5",
        "_ONWARD_SHARE, _REVERSED_SHARE = 0.5, 0.5",
    ),
    _motion("an inverted device is not noticed", "if self._opposed < self._opposes:", "if self._opposed >= 0.0:"),
    _motion(
        "a recording looks at the direction",
        "if rises and settings.watch_direction else math.inf",
        "if settings.watch_direction else math.inf",
    ),
    _motion(
        "a motion along the command forgives nothing",
        "self._opposed + abs(travelled) if change < 0 else 0.0",
        "self._opposed + abs(travelled) if change < 0 else self._opposed",
    ),
    _motion(
        "the play begins where the lagged command was",
        "farther(self._engaged, command) if self._direction == before else command",
        "self._from",
    ),
    _motion(
        "an inverted device has its play the other way round",
        "self._engage(turned * self._gain if self._gain else 0.0)",
        "self._engage(turned)",
    ),
    _drive(
        "off-time is forgotten where nothing is told",
        "if self._tolerance is None or math.isnan(held):\n            return True",
        "if self._tolerance is None or math.isnan(held):\n            self._off_ns = None\n            return True",
    ),
    _drive(
        "a drive that lags does not follow",
        "commands = [self._lagged, *(u for _, u in window)]",
        "commands = [u for _, u in window]",
    ),
    _climb("a step is judged before the tip rests", "or self._settles(angle):", "or angle > 1e9:"),
    _climb(
        "the travel without motion is not measured",
        "return replace(self._found, still=self._still)",
        "return replace(self._found, still=0.0)",
    ),
    _bounded("an angle out of range is missing", "else now.shown_deg", "else math.nan"),
    _bounded(
        "no limits are any", "angle_limits or (sensor.lower_deg, sensor.upper_deg)", "angle_limits or (-1e9, 1e9)"
    ),
    _config("the travel of the whole range stays", ", _MOST_TRAVEL * span)", ", 1e9)"),
    _config(
        "a travel seen without motion is a fault",
        "max(watch.travel_of(span), _STILL_MARGIN * still)",
        "watch.travel_of(span)",
    ),
    _bench(
        "no closed loop looks at the direction", "closed = any(phase.closed_loop for phase in work)", "closed = False"
    ),
    _taken(
        "the loop in C sees no delay that grows", "DRIFT * most_of((double)(r->received_ns - l->heard_ns), 0.0)", "1e18"
    ),
    _taken("the loop in C takes the noise of a stream for a jump", "RATE_NS = 20000000", "RATE_NS = 1000"),
    _taken(
        "the loop in C sends whatever the time since the judgement",
        "s->sent = s->sent_boot_ns - s->boot_ns <= l->gap_ns && send_command",
        "s->sent = send_command",
    ),
    _taken("a late sample is in time in C", "l->late = s->done_ns > l->deadline_ns + l->dt_ns;", "l->late = 0;"),
    _taken(
        "the loop in C watches the command without its lag",
        "followed(l->lagged, l->last, elapsed_s / l->lag_s)",
        "l->last",
    ),
)
