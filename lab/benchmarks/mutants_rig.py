"""Mutants of the bench: what comes in, what goes over the wire, signals, preparation."""

from __future__ import annotations

from mutant import Mutant, Mutated, mutated_file  # isort: skip

_intake = mutated_file("rig", "safety/intake.py", "test_parts.py", "test_intake.py", "test_loop.py")
_frames = mutated_file("rig", "safety/intake.py", "test_sensor_kinds.py")
_followed = mutated_file("rig", "safety/plausibility.py", "test_drive_following.py")
_order = mutated_file("rig", "transports/sessions.py", "test_parts.py", "test_udp.py")
_units = mutated_file("rig", "transports/transport.py", "test_units.py")
_guard = mutated_file("rig", "transports/guarded.py", "test_from_outside.py")
_datagram = mutated_file("rig", "transports/udp.py", "test_datagram.py", "test_udp.py")
_signals = mutated_file("rig", "safety/stop.py", "test_signals.py")
_prepare = mutated_file("rig", "commission/phases.py", "test_prepare.py")
_gate = mutated_file("rig", "safety/gate.py", "test_anchor.py", "test_parts.py", "test_loop.py")
_anchor = mutated_file("rig", "safety/gate.py", "test_anchor.py")
_loop = mutated_file("rig", "loop.py", "test_anchor.py", "test_loop.py")
_motion = mutated_file("rig", "commission/phases.py", "test_anchor.py", "test_loop.py")
_ramp = mutated_file("rig", "safety/ramp.py", "test_anchor.py")
_config = mutated_file("rig", "config.py", "test_parts.py")
_plausibility = mutated_file("rig", "safety/plausibility.py", "test_anchor.py")
_tracking = mutated_file("rig", "commission/experiment.py", "test_bench.py")
_admission = mutated_file("rig", "transports/sessions.py", "test_sessions.py")
_udp = mutated_file("rig", "transports/udp.py", "test_udp.py", "test_sessions.py")
_dds = mutated_file("rig", "transports/dds_.py", "test_sessions.py", "test_dds.py")
_topics = mutated_file("rig", "transports/topics.py", "test_sessions.py", "test_dds.py")
_server = mutated_file("rig", "device/server.py", "test_sessions.py")
_latch = mutated_file("rig", "safety/stop.py", "test_parts.py", "test_bench.py")
_bench = mutated_file("rig", "bench.py", "test_bench.py")
_connect = mutated_file("rig", "contact.py", "test_bench.py")
_host = mutated_file("rig", "recording/recorder_process.py", "test_recording_faults.py")
_controls = mutated_file("rig", "live/controls.py", "test_live_control.py")
_desk = mutated_file("rig", "live/desk.py", "test_live_control.py")
_asked_loop = mutated_file("rig", "loop.py", "test_live_control.py")
_asked_flag = mutated_file("rig", "safety/stop.py", "test_live_control.py")
_asked_bench = mutated_file("rig", "bench.py", "test_live_control.py")
_asked_phase = mutated_file("rig", "commission/phases.py", "test_live_control.py")
_targets = mutated_file("rig", "commission/experiment.py", "test_live_control.py")
_page = mutated_file("rig", "live/server.py", "test_live_control.py", "test_live.py")
_compiled = mutated_file("rig", "compiled/controller.py", "test_backends.py")
_taken = mutated_file("rig", "compiled/loop.c", "test_loop_in_c.py")
_watched = mutated_file("rig", "compiled/loop.py", "test_loop_in_c.py")
_in_c = Mutated("codegen", "codegen/c/controller.c", ("tests/rig/test_backends.py",))
_at_bench = Mutated("cli", "cli/at_bench.py", ("tests/rig/test_bench.py",))

MUTANTS: tuple[Mutant, ...] = (
    _compiled(
        "the C does not know of a stop that was asked for",
        "if state.fallback.stopped and not c.view.stopped:",
        "if False:",
    ),
    _compiled(
        "the C plans although there is no time",
        "if self.refusal:\n            c.hurry()",
        "if not self.refusal:\n            pass",
    ),
    _compiled(
        "a stop that the C has latched is not told",
        "FallbackState(view.failures, bool(view.stopped), cause=cause)",
        "FallbackState(view.failures, False, cause=cause)",
    ),
    _compiled(
        "what the C remembers is not what the state says",
        "if state.memory is not self._newest:",
        "if not self._newest and not state.memory:",
    ),
    _compiled(
        "the C goes on from another command than the device holds",
        "if state.estimate.command != c.view.estimate.command:",
        "if c.view.estimate.command is None:",
    ),
    _taken(
        "the loop in C does not look at the checksum",
        "checksum(data, BODY) != number_at(data + BODY, 4)",
        "0",
    ),
    _taken("the loop in C takes old messages", "|| ahead == 0 || ahead > HALF", ""),
    _taken(
        "the loop in C takes stale messages",
        "    if (!(1e-9 * ((double)(woke_ns - r->received_ns) + excess) <= l->age_limit_s)) return 0;\n",
        "",
    ),
    _taken("the loop in C takes any angle", "l->angle_low <= angle && angle <= l->angle_high && ", ""),
    _taken(
        "the loop in C takes jumps",
        "!(fabs(angle - l->rated) <= l->angle_rate * elapsed_s) || ",
        "",
    ),
    _taken("the loop in C takes a frozen sensor", "l->repeats >= l->frozen_samples && ", "l->repeats < 0 && "),
    _taken("the loop in C takes a silent sensor", "S(woke_ns - l->accepted_ns) <= l->age_limit_s", "1"),
    _taken(
        "the loop in C does not see that the device does not follow",
        "return low - l->tolerance <= held && held <= high + l->tolerance;",
        "return 1;",
    ),
    _taken("the loop in C does not see a blocked tip", "if (l->travel < 0.0 || angle != angle) return 1;", "return 1;"),
    _taken("the loop in C goes on under a stop", "if (*asked || l->asked) return ASKED;\n    if (!look", "if (!look"),
    _taken("the loop in C goes on unwatched", "l->written - l->read >= l->most_behind", "0"),
    _taken(
        "the loop in C sends what the controller wants",
        "s->u = admissible(l, s->wanted, s->checked_ns);",
        "s->u = s->wanted;",
    ),
    _taken(
        "the loop in C lets a pause earn a jump",
        "least_of(most_of(S(at_ns - l->gate_ns), 0.1 * l->dt_s), l->dt_s)",
        "100.0 * l->dt_s",
    ),
    _taken(
        "the loop in C goes on with a controller about to stop",
        "c->stopped || c->failures + 1 >= l->stop_after || ",
        "",
    ),
    _watched(
        "what the loop in C has read and not used is lost",
        "return _received(self.view.pending, self.view.unread)",
        "return []",
    ),
    _in_c(
        "the C plans in a hurry",
        "    if (c->hurried) {\n        out->status = HYSTMPC_NO_TIME;\n        return;\n    }\n",
        "",
    ),
    _in_c("the hurry of a sample lasts", "    c->hurried = 0;\n    answer.missing", "    answer.missing"),
    _in_c(
        "the C looks on and forgets what was sent",
        "    advance(c, within_range(command, c->estimate.command));\n",
        "    advance(c, c->estimate.command);\n",
    ),
    _intake(
        "the age of a reading is not judged",
        "fresh = age_s <= settings.age_limit_s",
        "fresh = age_s <= 1e9",
    ),
    _intake(
        "the time of flight does not count as age",
        "return _S * (now_ns - heard_ns + flight - least)",
        "return _S * (now_ns - heard_ns)",
    ),
    _intake(
        "the time since receipt does not count as age",
        "return _S * (now_ns - heard_ns + flight - least)",
        "return _S * (flight - least)",
    ),
    _intake(
        "the order of readings is not judged",
        "verdict = self._order.judge(reading.session, reading.sequence)",
        "verdict = NEW",
    ),
    _intake(
        "a device that was restarted is believed",
        'self._dead = self._dead or "the device was restarted: what it holds now is not known"',
        "self._dead = str(self._dead)",
    ),
    _intake(
        "the plausible range is not judged",
        "if not settings.lower_deg <= angle <= settings.upper_deg:",
        "if angle > 1e9:",
    ),
    _intake(
        "jumps are not judged",
        "if abs(angle - self._rated[1]) > settings.rate_limit_deg_s * elapsed_s:",
        "if abs(angle - self._rated[1]) > 1e9:",
    ),
    _intake(
        "a frozen sensor is not found", "if count and self._repeats >= count", "if count < 0 and self._repeats >= count"
    ),
    _intake(
        "a frozen sensor is found at rest",
        "self._repeats >= count and self._travel >= settings.frozen_travel",
        "self._repeats >= count",
    ),
    _frames("a frame is as old as its message", "age_s += settings.latency_s", "age_s += 0.0 * settings.latency_s"),
    _frames("a frame is never too old", "if age_s > settings.oldest_frame_s else", "if age_s > 1e9 else"),
    _frames("a frame shown again is a new one", "return self._shown != before", "return True"),
    _frames(
        "an overtaken frame is the measure of the next",
        "if taken_ns < self._accepted_ns and math.isfinite(self._angle):",
        "if math.isnan(reading.angle_deg):",
    ),
    _frames(
        "a frame is judged with the present command",
        "return self._watch.judge(angle, then, seen_ns)",
        "return self._watch.judge(angle, self._command, seen_ns)",
    ),
    _frames(
        "a silent device without a sensor is commanded on",
        "silent = self._tells and silent_s",
        "silent = self._tells and 0.0 * silent_s",
    ),
    _intake(
        "a dead sensor does not stop the run",
        "        if silent_s > self._settings.silence_s:",
        "        if silent_s > 1e9:",
    ),
    _followed(
        "a device that does not follow never stops the run",
        "self._off_ns = now_ns if self._off_ns is None else self._off_ns",
        "self._off_ns = now_ns",
    ),
    _followed(
        "a device above what was sent counts as following",
        "low - self._tolerance <= held <= high + self._tolerance",
        "low - self._tolerance <= held",
    ),
    _followed(
        "a moment of not following is never forgotten",
        "            self._off_ns = None\n            return True",
        "            return True",
    ),
    _order("a repeated message is new", "if not 0 < ahead < _HALF:", "if not 0 <= ahead < _HALF:"),
    _order("an older message is new", "if not 0 < ahead < _HALF:", "if not 0 < ahead:"),
    _order("a session that has ended may come back", "if session in self._ended:", "if session < 0:"),
    _order("a new session is not told", "return NEW if first else RESTARTED", "return NEW"),
    _order("sequence numbers do not wrap", "(sequence - self._sequence) & 0xFFFFFFFF", "sequence - self._sequence"),
    _units("radians are divided", '"rad": 180.0 / math.pi', '"rad": math.pi / 180.0'),
    _units(
        "the command's unit is inverted on the way out",
        "return command / self.command_factor",
        "return command * self.command_factor",
    ),
    _units(
        "the command's unit is inverted on the way in",
        "return self.command_factor * raw",
        "return raw / self.command_factor",
    ),
    _units("the sign of the angle is lost", "wire.angle_sign * _TO_DEG[wire.angle_unit]", "_TO_DEG[wire.angle_unit]"),
    _units(
        "the offset of the angle is lost",
        "return self.angle_factor * raw + self.angle_offset_deg",
        "return self.angle_factor * raw",
    ),
    _units("kPa count as hPa", '"kPa": ("bar", 1e-2)', '"kPa": ("bar", 1e-3)'),
    _units("metres count as millimetres", '"m": ("mm", 1e3)', '"m": ("mm", 1.0)'),
    _units("pressure passes for travel", "if unit != command_unit:", 'if unit == "":'),
    _datagram(
        "the checksum is not looked at", "if zlib.crc32(body) != _CRC.unpack_from(data, _BODY.size)[0]:", "if not body:"
    ),
    _datagram("the version is not looked at", "version != VERSION or zero:", "zero:"),
    _datagram("any kind is a command", "known = KINDS.get(kind)", "known = KINDS.get(kind, Kind.COMMAND)"),
    _datagram("a datagram that is too long is read", "if len(data) != SIZE:", "if len(data) < SIZE:"),
    _datagram(
        "the held command is that which was measured",
        "sequence, stamp_ns, value, held)\n",
        "sequence, stamp_ns, value, value)\n",
    ),
    _signals("a closed terminal is not caught", '"SIGTERM", "SIGHUP")', '"SIGTERM")'),
    _signals("SIGTERM is not caught", '"SIGTERM", "SIGHUP")', '"SIGHUP")'),
    _signals("a signal is caught and forgotten", "flag.set(signal.Signals(number).name)", "del number"),
    _signals("handlers are not put back", "signal.signal(number, handler)", "del handler"),
    _prepare(
        "the move goes on from where it is",
        "ramp_commands(held, 0.0, self.to, ramps, dt_s)",
        "ramp_commands(held, 0.0, held + self.to, ramps, dt_s)",
    ),
    _prepare(
        "the flexure stays up",
        "stops = [self.upper, self.lower] * self.cycles",
        "stops = [self.upper, self.upper] * self.cycles",
    ),
    _prepare(
        "the pretension check does not lead back",
        "ramp_commands(held + self.by, 0.0, held, ramps, dt_s)",
        "ramp_commands(held + self.by, 0.0, held + self.by, ramps, dt_s)",
    ),
    _prepare(
        "the pretension check expects nothing",
        "            self.least_move_deg,\n            self.most_move_deg,",
        "            -1e9,\n            1e9,",
    ),
    _gate(
        "a pause earns a larger step",
        "min(max(_S * (now_ns - self._sent_ns), _SHORTEST * self._dt), self._dt)",
        "max(_S * (now_ns - self._sent_ns), _SHORTEST * self._dt)",
    ),
    _gate(
        "two commands close together are a whole sample apart",
        "min(max(_S * (now_ns - self._sent_ns), _SHORTEST * self._dt), self._dt)",
        "self._dt",
    ),
    _gate(
        "any held command is a place to start from",
        "if not low - slack <= held <= high + slack:",
        "if held < -1e9:",
    ),
    _gate("the gate does not limit", "u = self._limits.clip(wanted, self.last, self._elapsed_s(now_ns))", "u = wanted"),
    _anchor("a gap is no gap", "(away or not seen.follows)", "(not seen.follows)"),
    _anchor("a device that does not follow is commanded on", "(away or not seen.follows)", "away"),
    _anchor(
        "a held command on the move is believed",
        "still = max(values) - min(values) <= _STILL * self._tolerance",
        "still = True",
    ),
    _anchor("silence is waited out", "if silent_ns > self._silence_ns:", "if silent_ns > 1e18:"),
    _anchor(
        "a device that has moved by itself is commanded on",
        "if abs(held - before) > self._tolerance:",
        "if abs(held - before) > 1e9:",
    ),
    _anchor(
        "a command is sent however old its judgement",
        "if boot_ns - self._judged_ns <= self._gap_ns:",
        "if boot_ns >= 0:",
    ),
    _loop("commands are sent without an anchor", "if not sure:", "if not sure and not self._commands:"),
    _loop("goodbye is always said", "stop(goodbye=self._confirmed)", "stop(goodbye=True)"),
    _loop(
        "a phase that raises is held",
        "                self._halt(_said(error), now)\n                continue",
        '                return Decision(now.held, "hold", _said(error))',
    ),
    _loop(
        "the fault of a phase is ignored",
        "if not wrong or isinstance(self._phase, SafeStop):",
        "if decision is not None:",
    ),
    _loop("a dead sensor is ignored", "stop = self._flag.cause or seen.dead", "stop = self._flag.cause"),
    _loop("a signal is ignored", "stop = self._flag.cause or seen.dead", "stop = seen.dead"),
    _loop(
        "a stalled loop goes on",
        "if boot - self._boot_ns > self._stall_ns + self._dt_ns:",
        "if boot < 0:",
    ),
    _loop(
        "the stop goes on from where it was before the pause",
        "if self._waited and isinstance(self._phase, SafeStop):",
        "if self._waited < 0 and isinstance(self._phase, SafeStop):",
    ),
    _loop(
        "a command that did not leave counts as sent",
        "            self._refused_by_wire(self._clock.boot_ns())\n            return False",
        "            self._refused_by_wire(0)\n            self._gate.sent(u, self._clock.now_ns())",
    ),
    _loop("a wire that takes no command goes on", "if now - self._refused_ns > self._stall_ns:", "if now < 0:"),
    _loop("a way back that was not sent ends well", "if not self._phase.sent and not self._cause:", "if now is None:"),
    _guard("nonsense is believed", "if fault := nonsense(found, self._now()):", "if fault := '':"),
    _guard(
        "calls wait behind one that hangs",
        "        if not self.idle:\n            raise",
        "        if False:\n            raise",
    ),
    _guard("a driver ends the program", "future.set_exception(OSError(f", "future.set_exception(type(error)(f"),
    _guard("units are not converted", "raw = self._conversion.raw_command(command)", "raw = command"),
    _motion(
        "the stop has no ramp",
        "            self._commands = self._plan(now.held, now.velocity).tolist()\n        except",
        "            self._commands = []\n        except",
    ),
    _motion(
        "held is claimed without the device's word",
        "self.confirmed = abs(now.told - self._safe) <= self._tolerance",
        "self.confirmed = True",
    ),
    _motion("the stop ends at once", "there = self.sent and (", "there = True or ("),
    _ramp(
        "a stop does not brake",
        "if min(start, safe) - overshoot <= ramp.min() and ramp.max() <= max(start, safe) + overshoot:",
        "if ramp.size:",
    ),
    _ramp(
        "a stop brakes as gently as a ramp",
        "max(ramps.acceleration_per_s2, velocity**2 / (2.0 * overshoot))",
        "ramps.acceleration_per_s2",
    ),
    _config("a weak brake is accepted", "> self.overshoot * (1 + 1e-9):", "> 1e9:"),
    _plausibility("a blocked tip is not noticed", "if not self._on or (", "if self._on or ("),
    _plausibility(
        "an angle that moves counts as one that does not",
        "if not max(self._high, angle) - min(self._low, angle) < self._moves:",
        "if math.isnan(self._high):",
    ),
    _plausibility(
        "only a positive disturbance counts", "self._on and abs(disturbance_deg)", "self._on and disturbance_deg"
    ),
    _plausibility(
        "the estimator's own limit does not count", "min(settings.model_error_deg, 0.99 * limit_deg)", "30.5"
    ),
    _tracking("the model is not watched", "watch.judge(command.disturbance)", '""'),
    _intake(
        "the command held by a device that listens to another counts",
        "self._held = reading.held if reading.listens and tells else math.nan",
        "self._held = reading.held",
    ),
    _admission(
        "anybody may take a device over",
        "if not known and self._pinned is not None and now_ns - self._heard_ns <= self._silence_ns:",
        "if now_ns < 0:",
    ),
    _admission("anybody may command", 'return "" if self._pinned == (sender, session) else ANOTHER', 'return ""'),
    _admission(
        "the sender does not matter",
        'return "" if self._pinned == (sender, session) else ANOTHER',
        'return "" if self._pinned[1] == session else ANOTHER',
    ),
    _admission(
        "who has never commanded may say goodbye",
        'return "" if self._commanded else "goodbye without a command"',
        'return ""',
    ),
    _admission(
        "old messages are new", "if self._order.judge(session, sequence) not in (NEW, RESTARTED):", "if now_ns < 0:"
    ),
    _udp("any kind is a reading", "if message.kind is not Kind.READING:", "if message.kind is None:"),
    _udp(
        "goodbye is said anyway over UDP", "for _ in range(_GOODBYES if goodbye else 0):", "for _ in range(_GOODBYES):"
    ),
    _udp(
        "not a number passes over UDP",
        'return Incoming(message.value) if math.isfinite(message.value) else "not-a-number"',
        "return Incoming(message.value)",
    ),
    _topics(
        "goodbye is said anyway over DDS", "if goodbye and self._device_has_sessions:", "if self._device_has_sessions:"
    ),
    _dds(
        "not a number passes over DDS",
        'return Incoming(raw) if math.isfinite(raw) else "not-a-number"',
        "return Incoming(raw)",
    ),
    _dds("every writer is the same", "come = writer, message.session,", "come = 0, 0,"),
    _server("the watchdog never bites", "if self._silent <= self._settings.watchdog_s:", "if self._silent <= 1e9:"),
    _server("no greeting is wanted after the watchdog", "self._deaf = self._deaf or bites", "self._deaf = False"),
    _server(
        "a goodbye disarms the watchdog anywhere",
        "if abs(self._held - self._rest) <= _AT_REST * (self._limits.upper - self._limits.lower):",
        "if self._rest >= 0:",
    ),
    _server(
        "a greeting ends the return",
        "                self._deaf = False\n",
        "                self._deaf, self._silent = False, 0.0\n",
    ),
    _server(
        "the drive jumps",
        "self._held = self._limits.clip(self._target, self._held, self._dt)",
        "self._held = self._target",
    ),
    _latch("nothing keeps a second program out", "lock.acquire(blocking=False)", "lock.lock_file"),
    _latch("an unreadable latch is released", '{"cause": "unreadable latch", "since": "?"}', "None"),
    _bench("a run is not latched while it lasts", "    latch.set(RUNNING)\n", ""),
    _bench(
        "a stop is not latched",
        "    if cause:\n        latch.set(cause)",
        "    if not cause:\n        latch.set(cause)",
    ),
    _bench("a latched stop is ignored", "        latch.require_released()\n", ""),
    _connect(
        "a device beyond the limits is accepted", "if not low - slack <= held <= high + slack:", "if held < -1e9:"
    ),
    _connect(
        "a device of another controller is accepted", "self._seen += self._listens and (inside", "self._seen += (inside"
    ),
    _connect(
        "another start command is accepted",
        "if wanted is not None and abs(held - wanted)",
        "if wanted is None and abs(held)",
    ),
    _host("Ctrl-C ends the recording", "for name in STOPPING:", 'for name in ("SIGHUP",):'),
    _host("a closed terminal ends the recording", "for name in STOPPING:", 'for name in ("SIGINT", "SIGTERM"):'),
    _controls(
        "any token will do",
        'return hmac.compare_digest(authorization.encode(errors="replace"), wanted)',
        "return len(wanted) > 0",
    ),
    _controls("a token may be empty", "wanted = (_SCHEME + self.access.token).encode()", "wanted = _SCHEME.encode()"),
    _controls(
        "the e-stop needs no token",
        'if not self._carries_token(said.get("authorization", "")):',
        'if action != "estop" and not self._carries_token(said.get("authorization", "")):',
    ),
    _controls(
        "another site's page may ask",
        "return site == \"same-origin\" and origin in (None, f\"http://{said.get('host', '')}\")",
        'return site == "same-origin"',
    ),
    _controls(
        "a browser that says cross-site may ask",
        'return site == "same-origin" and origin',
        "return bool(site) and origin",
    ),
    _controls("a foreign name is ours", "return name.lower() in self._names", "return True"),
    _controls(
        "an e-stop waits for other requests",
        '        if self.is_estop(path):\n            return _answer(self._ask("estop", 0.0))\n',
        "",
    ),
    _desk("an e-stop ends the run regularly", "            self.flag.set(E_STOP)\n", "            self.flag.end()\n"),
    _desk("an e-stop does nothing", "            self.flag.set(E_STOP)\n            return", "            return"),
    _desk(
        "a run that ends refuses an e-stop",
        'if action == "estop":',
        'if action == "estop" and not self.flag.ending:',
    ),
    _desk("a stop is latched", "            self.flag.end()\n", "            self.flag.set(action)\n"),
    _desk("a page that only shows takes requests", "if not self.settings.control:", "if self.settings is None:"),
    _desk("a run that ends takes targets", "if self.flag.cause or self.flag.ending:", "if self._token is None:"),
    _desk("nothing waits for the start", "self.started = not settings.wait_for_start", "self.started = True"),
    _desk(
        "the token is the same in every run", "self._token = secrets.token_urlsafe(24)", 'self._token = "hystmpc" * 4'
    ),
    _asked_loop("the regular end is not heard", "if self._flag.ending and not", "if self._flag.cause and not"),
    _asked_loop(
        "the phases that are left are gone through",
        "            self._rest.clear()\n            self._phase = None\n",
        "            self._phase = None\n",
    ),
    _asked_loop(
        "the wait before the start is replayed",
        "            self._past_u.clear()\n            self._past_y.clear()\n",
        "            self._past_y.clear()\n",
    ),
    _asked_flag("the end that is asked for is forgotten", "self.ending = True", "self.ending = False"),
    _asked_bench("the start is not waited for", "if desk.started else", "if desk.settings else"),
    _asked_bench("the page is not told that the run ends", "        flag.end()  # whoever", "        # whoever"),
    _asked_phase("the run begins before the start", "finished=started)", "finished=True)"),
    _targets(
        "a target out of reach is taken",
        "        if not reach:\n            return Answer(False, reach.reason)\n",
        "",
    ),
    _targets("a target before the hand-over is taken", "            if not self._tracks:", "            if False:"),
    _targets("the run ends at a target", "t >= reference.duration_s and not self._stays", "t >= reference.duration_s"),
    _page("there are streams without end", "if len(self._server.streams) >= _MOST_STREAMS:", "if False:"),
    _page(
        "requests are taken by a page that only shows",
        'elif method != "POST" or server.controls is None:',
        "elif False:",
    ),
    _at_bench("held is always claimed", "    if outcome.confirmed:", "    if outcome:"),
)
