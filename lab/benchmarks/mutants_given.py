"""Mutants of what a file, a folder or a client that one was given may do."""

from __future__ import annotations

from mutant import Mutant, Mutated, mutated_file  # isort: skip

_RECEIVED = ("tests/cli/test_received.py",)
_named = Mutated("trials", "trials/from_outside.py", _RECEIVED)
_unread = Mutated("ctrl", "ctrl/from_outside.py", _RECEIVED)
_parsed = Mutated("trials", "trials/config.py", _RECEIVED)
_reviewed = Mutated("rig", "rig/commission/review_page.py", _RECEIVED)
_measured = Mutated("gap", "gap/tracking/measured.py", _RECEIVED)
_loaded = Mutated("sim", "sim/results.py", _RECEIVED)
_workers = Mutated("sim", "sim/jobs/backend.py", _RECEIVED)
_recorder = Mutated("rig", "rig/recording/recorder_process.py", _RECEIVED)
_bench = Mutated("rig", "rig/config.py", _RECEIVED)
_device = Mutated("rig", "rig/device/server.py", _RECEIVED)
_option = Mutated("tasks", "tasks/inputs.py", _RECEIVED)
_compiled = mutated_file("rig", "compiled/controller.py", "test_library.py")
_build = Mutated("codegen", "codegen/build.py", ("tests/rig/test_library.py",))
_server = mutated_file("rig", "live/server.py", "test_live_hostile.py", "test_live_control.py", "test_live.py")
_hdf5 = mutated_file("trials", "mat_.py", "test_bounds.py", "test_mat.py")
_version_5 = mutated_file("trials", "mat_bounds.py", "test_bounds.py")
_mcap = mutated_file("trials", "mcap_.py", "test_bounds.py")
_numpy = mutated_file("trials", "npz_.py", "test_bounds.py")
_workbook = mutated_file("trials", "xlsx_.py", "test_bounds.py")
_bag = mutated_file("trials", "rosbag1_.py", "test_bounds.py")
_kernels = mutated_file("models", "kernels/numba_.py", "test_kernel_cache.py")

MUTANTS: tuple[Mutant, ...] = (
    _named("the working folder comes first on the path", "sys.path.append(here)", "sys.path.insert(0, here)"),
    _named("the working folder stays on the path", "sys.path.remove(here)", "sys.path.index(here)"),
    _named(
        "the import asks nobody",
        "    if refused := refusal(name, group):\n        raise ConfigError",
        "    if refused := '':\n        raise ConfigError",
    ),
    _named("a file may name what a program may", "elif _place_of(name):", "elif False:"),
    _named("a report imports what was allowed", "if not _reading.get() and (_ALL", "if (_ALL"),
    _named("a yes to one class is one to others", "or name in said)", "or name in ' '.join(said))"),
    _named(
        "data in a file's data are a program's",
        "where == MEMORY if _by_code.get() is None else _by_code.get()",
        "where == MEMORY",
    ),
    _named("a program's own name allows all", "            allow_python(name)\n", "            allow_python()\n"),
    _unread(
        "a report imports a controller",
        "if self._read_only:\n            return _unread",
        "if False:\n            return _unread",
    ),
    _parsed("what a file names is a program's", "with given_by(where):", "with given_by(MEMORY):"),
    _reviewed("a review imports", "@only_reads()\ndef review_run(", "def review_run("),
    _measured("a comparison imports", "@only_reads()\ndef measured_runs(", "def measured_runs("),
    _loaded("results import", "@only_reads()\ndef load_results(", "def load_results("),
    _workers("workers look into the working folder", 'os.environ["PYTHONSAFEPATH"] = before or "1"', "pass"),
    _recorder("the recorder looks into the working folder", '[sys.executable, "-P", "-m"', '[sys.executable, "-m"'),
    _bench("any file may be a latch", "if not _may_latch(place):", "if False:"),
    _bench("any JSON may be a latch", 'isinstance(found, dict) and "cause" in found', "isinstance(found, dict)"),
    _device("a device's log goes into any file", 'if begins not in ("", _HEADER):', "if False:"),
    _option("nobody has to say yes", "    if allow:\n        allow_python()", "    allow_python()"),
    _compiled("the C is not compared", "if differs := _difference(controller, compiled):", "if differs := '':"),
    _compiled("the C may differ", "_CHECKED, _SAME = 24, 1e-6", "_CHECKED, _SAME = 24, 1e-5"),
    _compiled("the check is short", "_CHECKED, _SAME = 24, 1e-6", "_CHECKED, _SAME = 10, 1e-6"),
    _compiled("the check has no source", " or one.source is not other.source:", ":"),
    _compiled(
        "a command that is no number passes the check",
        "if not abs(one.u - other.u) <= _SAME or",
        "if abs(one.u - other.u) > _SAME or",
    ),
    _compiled("the check has an angle in every sample", "{7: np.nan, 8: np.nan, 15: 1e9}", "{}"),
    _build("an older library is loaded", "    if text not in _made:\n", "    if not _made:\n"),
    _server("connections pile up", "if len(self.clients) > _most_clients():", "if False:"),
    _server("one connection gives way for many", "            self.leave(oldest)", "            pass"),
    _server("a slow request has all the time", "self._timer = self._later(_ASKS_S)", "self._timer = self._later(1e6)"),
    _server(
        "messages pile up for a viewer that takes none",
        "if self._transport.get_write_buffer_size() > _UNSENT // 2:",
        "if False:",
    ),
    _server(
        "a viewer that takes nothing stays",
        "        self._timer = self._later(_TAKES_S)\n        self._transport.write(message)",
        "        self._transport.write(message)",
    ),
    _server("a body may be long", "if len(text) > 10 or int(text) > MOST_BYTES:", "if len(text) > 10:"),
    _server(
        "a body's length may be any number", "if not (text.isascii() and text.isdigit()):", "if not text.isdigit():"
    ),
    _server("a body may come in chunks", 'if "transfer-encoding" in headers:', "if False:"),
    _server("a header may stand twice", "(name in headers and name in _ONCE)", "False"),
    _server(
        "an e-stop is counted among the requests that wait", "if not emergency and server.waiting", "if server.waiting"
    ),
    _server(
        "a request that waits stops the server",
        'threading.Thread(target=asked, name="hystmpc-page-request", daemon=True).start()',
        "asked()",
    ),
    _server("requests that wait are never done", "server.waiting -= not emergency", "pass"),
    _server("a head may be long", "if len(head) > _LARGEST_HEAD:", "if False:"),
    _hdf5("data may lie in a file of raw numbers", "if item.external or item.is_virtual:", "if item.is_virtual:"),
    _hdf5("data may be virtual", "if item.external or item.is_virtual:", "if item.external:"),
    _hdf5("a link may lead out", "if kind != h5l.TYPE_SOFT:", "if False:"),
    _hdf5("a link of the first level is followed blindly", "item = tree.item(file, name)\n", "item = file[name]\n"),
    _hdf5("a link in a group is followed blindly", "self.read(self.item(item, name))", "self.read(item[name])"),
    _hdf5("a filter is looked for", "- _FILTERS:", "- _FILTERS - {32015}:"),
    _hdf5("a variable may be as large as it says", "        self._bytes -= size * (item.size or 0)\n", ""),
    _hdf5("a chunk may be as large as it says", "min(self._bytes, MOST_BYTES - size * chunk) < 0", "self._bytes < 0"),
    _hdf5("references are read without end", "if (item.size or 0) > self._left:", "if False:"),
    _numpy("pickles are read", "if dtype.hasobject:", "if False:"),
    _numpy("an array is as large as it says", "if needed > size:", "if False:"),
    _numpy("arrays count one by one", "            left -= value.nbytes\n", ""),
    _workbook("parts unpack without a bound", "or size > MOST_BYTES:", "or False:"),
    _workbook("entities are read", "if _DOCTYPE in (tail + block).lower():", "if False:"),
    _workbook("other encodings hide entities", "if not tail and block.startswith(_UTF_16):", "if False:"),
    _workbook("rows far down are made", "if len(rows) - filled > _MOST_EMPTY:", "if False:"),
    _bag("chunks unpack without a bound", "if left < 0:", "if False:"),
    _version_5("cells are made without room", "if holds in _HOLDING and", "if holds == 1 and"),
    _version_5(
        "cells within cells are not looked at", "                self.walk(content, depth + 1)", "                pass"
    ),
    _version_5("cells may lie ever deeper", "if depth > _DEEPEST:", "if False:"),
    _version_5("variables unpack one by one", "self.left -= len(found)", "self.left = MOST_BYTES - len(found)"),
    _mcap("chunks unpack one by one", "self.left -= len(records) if chunk.compression else 0", "pass"),
    _mcap("a chunk may be longer than it says", "if len(found) != size:", "if len(found) < size:"),
    _kernels("code of a folder of others runs", "if not only_ours(Path(self._cache_path)):", "if False:"),
    _kernels(
        "kernels lie where others write",
        "os.access(folder, os.W_OK) and only_ours(folder)",
        "os.access(folder, os.W_OK)",
    ),
    _kernels("a group may write", "umask & (stat.S_IWGRP | stat.S_IWOTH)", "umask & stat.S_IWOTH"),
    _kernels("another user's folder is ours", "return found.st_uid in (os.getuid(), 0) and not", "return not"),
)
