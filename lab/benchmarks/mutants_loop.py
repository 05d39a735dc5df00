"""Mutants of the loop that all movers share: what raises, what is slow, who listens, and the planner's node."""

from __future__ import annotations

from mutant import Mutant, Mutated, mutated_file  # isort: skip

_guard = mutated_file("rig", "transports/guarded.py", "test_from_outside.py")
_guarded_loop = mutated_file("rig", "loop.py", "test_whatever_raises.py")
_slow = mutated_file("rig", "loop.py", "test_slow_wire.py")
_stepped = mutated_file("rig", "loop.py", "test_loop.py")
_reader = mutated_file("rig", "reader.py", "test_slow_wire.py")
_contact = mutated_file("rig", "contact.py", "test_slow_wire.py")
_listens = Mutated("rig", "rig/loop.py", ("tests/ros2/test_planner_motion.py",))
_node = Mutated("ros2", "ros2/hystmpc_ros/hystmpc_ros/planner.py", ("tests/ros2/test_planner_motion.py",))
_steering = Mutated("rig", "rig/commission/steering.py", ("tests/ros2/test_planner_motion.py",))
_rest = Mutated("rig", "rig/commission/phases.py", ("tests/ros2/test_planner_motion.py",))

MUTANTS: tuple[Mutant, ...] = (
    _guarded_loop(
        "what a part raises leaves the loop",
        "            return self._failed(_said(error), deadline)",
        "            raise",
    ),
    _guarded_loop(
        "a part that has failed is gone on with",
        "        self._flag.set(cause)\n        self._failures",
        "        self._failures",
    ),
    _guarded_loop(
        "a command that may have left is taken for one that has not",
        "            self._anchor.not_sent(self._clock.boot_ns())  # it may have left, and not be in the books\n",
        "",
    ),
    _guarded_loop(
        "a loop without a gate goes on for ever", "if self._failures * self._dt_ns <= self._stall_ns:", "if True:"
    ),
    _guarded_loop(
        "a reading that nobody can judge is forgotten",
        'self._flag.set(f"a reading cannot be judged: {_said(error)}")',
        "pass",
    ),
    _guarded_loop(
        "a sample that failed is not in the log",
        "            self._conclude(times, seen, Decision(held,",
        "            str((times, seen, held)) or self._conclude(times, seen, Decision(held,",
    ),
    _slow("a wire that is too slow goes on", "        if self._behind_ns > most:", "        if self._behind_ns < 0:"),
    _slow("one slow call is a slow wire", "min(over, most // 3)", "100 * max(over, 0)"),
    _slow(
        "slow reading in a stop keeps the commands", "spared=bool(self._cause) and self._gate.anchored", "spared=False"
    ),
    _slow(
        "what a slow reading has told is too old for a command",
        "boot if self._gate.anchored else self._clock.boot_ns()",
        "boot",
    ),
    _slow(
        "a pile is read for ever before the first sample",
        "until = self._clock.now_ns() + self._stall_ns",
        "until = self._clock.now_ns() + 1000 * self._stall_ns",
    ),
    _reader("reading goes on for the whole sample", "_SHARE = 4 ", "_SHARE = 1 "),
    _reader("reading has no budget", "while now - began <= budget_ns and", "while began <= now and"),
    _reader("64 readings are all that is taken", "_MOST = 4096", "_MOST = 64"),
    _contact("a backlog looks fresh", "sent_ns=newest.sent_ns + later_ns, ", "sent_ns=newest.sent_ns, "),
    _stepped("a missed period is not told", "(deadline - self._deadline_ns) // self._dt_ns - 1", "0"),
    _listens(
        "the oldest reading says whether the device listens", "not readings[-1].listens", "not readings[0].listens"
    ),
    _listens(
        "a device that listens no more is commanded",
        "if unheard and self._commands and self._gate.anchored:",
        "if unheard and self._commands < 0:",
    ),
    _listens(
        "what a device holds that listens no more counts",
        'replace(seen, follows=False, faults=(*seen.faults, "not-heard"',
        'replace(seen, faults=(*seen.faults, "not-heard"',
    ),
    _node("a stop of the planner is not latched", "                self.tip.stop()\n", ""),
    _node("the planner's stop stops the controller alone", "        self._flag.set(cause)\n", ""),
    _node("the planner ends its stop at once", "stays=lambda: not self._leaves", "stays=lambda: False"),
    _node("a stop of the planner leads elsewhere", "safe = self._steering.safe_command", "safe = 1.0"),
    _node(
        "a reset of the planner keeps the old loop",
        "        self._flag, self._loop = StopFlag(), None\n",
        '        self._flag = StopFlag()\n        self._loop = getattr(self, "_loop", None)\n',
    ),
    _node(
        "goodbye is said to a device that rests anywhere",
        "goodbye=self._over and self._loop is not None and self._loop.outcome().confirmed",
        "goodbye=self._over",
    ),
    _steering(
        "the planner's model is not watched",
        "self._watch)\n",
        "model_watch(self._plausibility, self._settings, 1e-9))\n",
    ),
    _steering("samples that the planner missed are forgotten", "for _ in range(now.skipped):", "for _ in range(0):"),
    _rest(
        "a stop without a safe command leads back to where it began",
        "if math.isnan(self._safe):",
        "if math.isnan(self._safe) and self._k == 0:",
    ),
    _rest(
        "a rest anywhere is confirmed",
        "abs(now.told - self._safe) <= self._tolerance",
        "abs(now.told - self._end) <= self._tolerance",
    ),
    _guard("a batch drops what has failed", "                found = error\n", "                return\n"),
    _guard("what does not fit the units is believed", "if math.isinf(getattr(reading, name)):", "if False:"),
    _guard("anything listens", "if not isinstance(found.listens, bool | np.bool_):", "if False:"),
    _guard("numbers of numpy stay what they are", "int(found.sequence),", "found.sequence,"),
    _guard("a command waits behind a reading that is late", "                self._late = True\n", ""),
)
