"""The program's start: Ctrl-C ends it without a trace, also while it is still importing."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest


@pytest.mark.slow
@pytest.mark.parametrize("after_s", [0.2, 0.5])
def test_ctrl_c_during_the_start_is_quiet(after_s: float) -> None:
    code = "import sys; from hystmpc.cli.entry import main; print('on', flush=True); sys.argv[1:] = ['effects']; main()"
    program = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert program.stdout is not None
    assert program.stdout.readline() == "on\n"
    time.sleep(after_s)
    program.send_signal(signal.SIGINT)
    _, said = program.communicate(timeout=60)
    assert program.returncode in (0, 130)  # 0 where it was done by then
    assert "Traceback" not in said
