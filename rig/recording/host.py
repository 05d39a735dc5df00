"""The process behind `Apart`: takes samples from its standard input and gives them to recording and views."""

from __future__ import annotations

import json
import os
import signal
import sys
from contextlib import suppress
from threading import Lock
from typing import Any

from hystmpc.trials.errors import HystmpcError
from hystmpc.trials.run_folder import RunFolder

from ..live.page import LivePage
from ..live.terminal import TerminalView
from ..safety.stop import STOPPING
from .recorder_process import unpack
from .recording import Recording, RecordingMeta
from .sample import Sink, Tee

_lock = Lock()


def main() -> int:
    """Read the order, then samples until the pipe closes, which is also what a killed controller leaves."""
    for name in STOPPING:  # meant for the controller; this process ends after it
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    order = json.loads(sys.stdin.buffer.readline() or b"{}")
    try:
        sink, page = _sinks(order)
    except HystmpcError as error:
        _say(error=str(error))
        return 1
    _say(ready=page)
    for samples in unpack(sys.stdin.buffer):
        for sample in samples:
            sink.put(sample)
    sink.close()
    return 0


def _sinks(order: dict[str, Any]) -> tuple[Sink, str]:
    """Recording and views, and the address of the page."""
    wanted = order["views"]
    page = LivePage(order["unit"], order["rate_hz"], wanted["host"], wanted["port"]) if wanted["page"] else None
    terminal = (
        TerminalView(order["unit"], order["rate_hz"], page.address if page else "") if wanted["terminal"] else None
    )

    def tell(text: str) -> None:
        for view in (page, terminal):
            if view is not None:
                view.tell(text)
        _say(tell=text)

    meta = RecordingMeta(order["unit"], stages=tuple(order["stages"]))
    run = RunFolder.open(order["folder"])
    recording = Recording(run, meta, order["rate_hz"], tell, lambda count: _say(on_disk=count), report=order["report"])
    views: list[Sink] = [view for view in (page, terminal) if view is not None]
    return Tee(recording, *views), page.address if page else ""


def _say(**answer: object) -> None:
    """One line to the controller; one that has died is told nothing."""
    with _lock, suppress(OSError):
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    code = main()
    with suppress(OSError):
        sys.stdout.flush()
    os._exit(code)  # a controller that was killed left a closed pipe: the interpreter's own end would complain of it
