"""Mutants of the bench: what comes in, what goes over the wire, signals, preparation."""

from __future__ import annotations

from mutant import Mutant, mutated_file  # isort: skip

_intake = mutated_file("rig", "intake.py", "test_parts.py", "test_intake.py", "test_loop.py")
_followed = mutated_file("rig", "followed.py", "test_followed.py")
_order = mutated_file("rig", "transports/order.py", "test_parts.py", "test_udp.py")
_units = mutated_file("rig", "transports/units.py", "test_units.py")
_datagram = mutated_file("rig", "transports/datagram.py", "test_datagram.py", "test_udp.py")
_signals = mutated_file("rig", "signals_.py", "test_signals.py")
_prepare = mutated_file("rig", "prepare.py", "test_prepare.py")

MUTANTS: tuple[Mutant, ...] = (
    _intake(
        "the age of a reading is not judged",
        "if self._age_s(reading, now_ns) > self._settings.age_limit_s:",
        "if self._age_s(reading, now_ns) > 1e9:",
    ),
    _intake(
        "the time of flight does not count as age",
        "return _S * (now_ns - reading.received_ns + excess)",
        "return _S * (now_ns - reading.received_ns)",
    ),
    _intake(
        "the time since receipt does not count as age",
        "return _S * (now_ns - reading.received_ns + excess)",
        "return _S * excess",
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
        "if abs(angle - self._angle) > settings.rate_limit_deg_s * elapsed_s:",
        "if abs(angle - self._angle) > 1e9:",
    ),
    _intake("a frozen sensor is not found", "frozen = count is not None and", "frozen = count is None and"),
    _intake(
        "a frozen sensor is found at rest",
        "self._repeats >= count and self._travel >= settings.frozen_travel",
        "self._repeats >= count",
    ),
    _intake("a dead sensor does not stop the run", "silent_s > self._settings.dead_after_s", "silent_s > 1e9"),
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
)
