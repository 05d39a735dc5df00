"""Recording and live view in a separate process, so that the interpreter of the loop serves the control thread alone.

`RecorderProcess` is the end in the control process, `serve` the main function of the recorder process.
"""

from __future__ import annotations

import json
import logging
import marshal
import os
import signal
import struct
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path
from threading import Event, Lock
from typing import Any, BinaryIO, final

from hystmpc.trials.config import Settings
from hystmpc.trials.errors import ConfigError, HystmpcError
from hystmpc.trials.run_folder import RunFolder, take_back

from ..axes import PerAxis, each, together
from ..live.desk import Access, Desk, Reply
from ..safety.stop import STOPPING
from .recording import Recording, RecordingMeta, Tell, create_folder
from .sample import Sample, Sink, Tee, ThreadedSink

_LENGTH = struct.Struct("<I")

_FEED_S = 0.05
_BLOCK = 10  # samples about: packing them keeps the interpreter from the control thread
_CLOSE_S = 20.0
_REPLY_S = 2.0  # how long the page waits for the run's reply
_NO_REPLY = "the run has not answered: use the device's own emergency stop"

_logger = logging.getLogger(__name__)
_lock = Lock()  # of the process's standard output


# What the run said to requests of the page: number, whether it does as asked, and a line.
Replies = Iterable[tuple[int, bool, str]]


def pack(samples: Iterable[Sample], replies: Replies = ()) -> bytes:
    """Serialise samples and replies as one block.

    `marshal` is the fastest way to bytes in the interpreter; the reader is the same interpreter, started by the writer,
    so its limits (one version, trusted data) do not matter here.

    Raises:
        ValueError, TypeError, AttributeError: on a sample whose fields are of other types than `Sample` says.
    """
    body = marshal.dumps(([_plain(sample) for sample in samples], list(replies)))
    return _LENGTH.pack(len(body)) + body


def unpack(pipe: BinaryIO, take_replies: Callable[[Replies], object] = lambda replies: None) -> Iterator[list[Sample]]:
    """Read blocks of samples until the other side has closed the pipe or died; an incomplete block is left out.

    `take_replies` takes the replies of each block.
    """
    while len(head := pipe.read(_LENGTH.size)) == _LENGTH.size:
        length = _LENGTH.unpack(head)[0]
        body = pipe.read(length)
        if len(body) < length:
            return
        samples, replies = marshal.loads(body)
        take_replies(replies)
        yield [Sample(*fields) for fields in samples]


def _plain(s: Sample) -> tuple[object, ...]:
    """Fields of a sample in order, in types that `marshal` supports, since a controller may return NumPy types."""
    angles = _numbers(s.reference_deg), _numbers(s.measured_deg)
    stages = tuple((str(name), float(spent)) for name, spent in s.stages_s)
    chosen = _numbers(s.command), str(s.source), str(s.status), _numbers(s.predicted_deg), stages
    timing = float(s.period_s), float(s.lateness_s), bool(s.missed)
    rest = tuple(map(str, s.faults)), int(s.sequence), float(s.taken_s), dict(s.inputs)
    return (float(s.t_s), int(s.wall_ns), *angles, *chosen, *timing, *rest)


def _numbers(value: PerAxis) -> PerAxis:
    return together(float(one) for one in each(value))


@dataclass(frozen=True)
class Views:
    """Choice of the live views of a run."""

    terminal: bool = False  # the terminal view, on standard error
    page: bool = False  # whether the local page is served
    host: str = "127.0.0.1"  # address of the page; only this machine reaches the default
    port: int = 8765  # of the page; 0 takes a free one


def open_recorder_process(
    folder: Path | str,
    config: Settings | Mapping[str, Any],
    meta: RecordingMeta,
    rate_hz: float,
    views: Views = Views(),
    tell: Tell | None = None,
    report: bool = True,
    desk: Desk | None = None,
) -> RecorderProcess:
    """Start a recording, and the views, in a separate process; arguments as of `open_recording`.

    Writing and drawing are Python code that holds the interpreter's lock for milliseconds at a time, up to a whole
    period of a loop at 250 Hz. Here the control process only packs tuples and writes them to a pipe, and the log is
    ended properly when the controller is killed. Requests at the page come back the same way, to `desk`.

    Raises:
        ConfigError: on a folder that is not new or empty, a missing model file, or a process that does not start (a
            page whose port is taken, for example).
    """
    path, made = Path(folder), not Path(folder).exists()
    create_folder(path, config, meta)
    order = {"folder": str(path), "rate_hz": rate_hz, "unit": meta.unit, "stages": meta.stages, "axes": meta.axes}
    order["inputs"] = meta.inputs
    access = None if desk is None or desk.access is None else asdict(desk.access)
    more = {"views": asdict(views), "report": report, "access": access}
    try:
        return RecorderProcess(order | more, rate_hz, tell, desk)
    except ConfigError:
        take_back(path, ("log.csv", "log.mcap"), made)
        raise


@final
class RecorderProcess(ThreadedSink):
    """Sink that sends samples to the recorder process; see `open_recorder_process`.

    Raises:
        ConfigError: if the process does not start.
    """

    def __init__(
        self, order: Mapping[str, Any], rate_hz: float, tell: Tell | None = None, desk: Desk | None = None
    ) -> None:
        super().__init__("hystmpc-recorder-feed", rate_hz, min(_FEED_S, _BLOCK / rate_hz))
        self._tell = tell or _logger.warning
        self._desk = desk or Desk()
        self._replies: deque[tuple[int, bool, str]] = deque()
        self._folder = str(order["folder"])
        # -P: a file of the working folder takes the place of no module
        command = [sys.executable, "-P", "-m", "hystmpc.rig.recording.recorder_process"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._to, self._from = self._process.stdin, self._process.stdout
        self.on_disk = self.lost = 0
        self.page = ""
        self._start(order)
        self._reader = threading.Thread(target=self._receive, name="hystmpc-recorder-answers", daemon=True)
        self._reader.start()
        self._thread.start()

    @property
    def dropped(self) -> int:
        return super().dropped + self.lost

    @property
    def pid(self) -> int:
        """Process id of the recorder process."""
        return self._process.pid

    def close(self) -> None:
        """Send the remaining samples and wait for the process to write them; failures are reported, not raised."""
        if not self._finish(_CLOSE_S):
            return
        with suppress(OSError):  # the process has died: that has been told
            self._to.close()
        try:
            self._process.wait(_CLOSE_S)
        except subprocess.TimeoutExpired:
            self._tell(f"{self._folder}: the recording process did not end within {_CLOSE_S:g} s and goes on writing")
            return
        self._reader.join(_CLOSE_S)
        self._from.close()
        if self.dropped:
            self._tell(f"{self._folder}: {self.dropped} samples did not reach the recording")

    def _start(self, order: Mapping[str, Any]) -> None:
        """Send the order to the process and wait for its answer."""
        with suppress(OSError):  # the answer is then empty
            self._to.write(json.dumps(order).encode() + b"\n")
            self._to.flush()
        answer = _line(self._from.readline())
        if "ready" not in answer:
            self._process.wait(_CLOSE_S)
            reason = answer.get("error", f"exit code {self._process.returncode}")
            raise ConfigError(f"{self._folder}: the recording process did not start: {reason}")
        self.page = str(answer["ready"])

    def _turn(self, samples: list[Sample], ending: bool) -> bool:
        """Pack and send samples; a slow process delays this thread, not the control thread."""
        del ending
        block = self._packed(samples) if samples else b""
        if self._replies:
            block += pack((), [self._replies.popleft() for _ in range(len(self._replies))])
        try:
            self._to.write(block)
            self._to.flush()
        except OSError:
            self._waiting.closed = True
            self.lost += len(samples)
            self.problem = f"{self._folder}: the recording process has died; the run goes on without a log"
            self._tell(self.problem)
            return False
        return True

    def _packed(self, samples: list[Sample]) -> bytes:
        """One block; samples of wrong types are left out and counted."""
        try:
            return pack(samples)
        except (ArithmeticError, AttributeError, TypeError, ValueError):
            if len(samples) == 1:
                self.lost += 1
                return b""
            return b"".join(self._packed([sample]) for sample in samples)

    def _receive(self) -> None:
        """Read the messages of the process in a separate thread."""
        for raw in self._from:
            answer = _line(raw)
            self.on_disk = int(answer.get("on_disk", self.on_disk))
            if "ask" in answer:
                reply = self._desk.ask(str(answer["ask"]), float(answer["value"]))
                self._replies.append((int(answer["number"]), reply.done, reply.text))
            if "tell" in answer:
                self.problem = str(answer["tell"])
                self._tell(self.problem)


def _line(raw: bytes) -> dict[str, Any]:
    try:
        answer = json.loads(raw)
    except ValueError:
        return {}
    return answer if isinstance(answer, dict) else {}


def serve() -> int:
    """Main function of the recorder process: read the order, then samples until the pipe closes."""
    for name in STOPPING:  # meant for the controller; this process ends after it
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    order, requests = json.loads(sys.stdin.buffer.readline() or b"{}"), _Requests()
    try:
        sink, page = _sinks(order, requests)
    except HystmpcError as error:
        _say(error=str(error))
        return 1
    _say(ready=page)
    for samples in unpack(sys.stdin.buffer, requests.take_replies):
        for sample in samples:
            sink.put(sample)
    sink.close()
    return 0


@final
class _Requests:
    """Forwarding of the page's requests to the controller, with a wait for the reply."""

    def __init__(self) -> None:
        self._numbers = count()
        self._open: dict[int, tuple[Event, list[Reply]]] = {}

    def ask(self, action: str, value: float) -> Reply:
        """Reply of the run to a request; callable from any thread."""
        number, arrived, received = next(self._numbers), Event(), list[Reply]()
        self._open[number] = arrived, received
        _say(ask=action, value=value, number=number)
        arrived.wait(_REPLY_S)
        del self._open[number]
        return received[0] if received else Reply(False, _NO_REPLY)

    def take_replies(self, replies: Replies) -> None:
        """Accept the controller's replies; late replies are dropped."""
        for number, done, text in replies:
            if number in self._open:
                arrived, received = self._open[number]
                received.append(Reply(done, text))
                arrived.set()


def _sinks(order: dict[str, Any], requests: _Requests) -> tuple[Sink, str]:
    """Sinks of recording and views, and the address of the page."""
    from ..live.desk import Controls
    from ..live.page import LivePage
    from ..live.terminal import TerminalView

    wanted = order["views"]
    page = None
    if wanted["page"]:
        access, place = order["access"], (wanted["host"], wanted["port"])
        controls = None if access is None else Controls(Access(**access), requests.ask, wanted["host"])
        page = LivePage(order["unit"], order["rate_hz"], *place, controls)
    terminal = (
        TerminalView(order["unit"], order["rate_hz"], page.address if page else "") if wanted["terminal"] else None
    )

    def tell(text: str) -> None:
        for view in (page, terminal):
            if view is not None:
                view.tell(text)
        _say(tell=text)

    meta = RecordingMeta(
        order["unit"], stages=tuple(order["stages"]), axes=order["axes"], inputs=tuple(order["inputs"])
    )
    run = RunFolder.open(order["folder"])
    recording = Recording(run, meta, order["rate_hz"], tell, lambda count: _say(on_disk=count), report=order["report"])
    views: list[Sink] = [view for view in (page, terminal) if view is not None]
    return Tee(recording, *views), page.address if page else ""


def _say(**answer: object) -> None:
    """Send one line to the controller; a dead one is ignored."""
    with _lock, suppress(OSError):
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    code = serve()
    with suppress(OSError):
        sys.stdout.flush()
    os._exit(code)  # a controller that was killed left a closed pipe: the interpreter's own end would complain of it
