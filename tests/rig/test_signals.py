"""Every signal that ends a run sets the flag, and nothing else; real signals to this process."""

from __future__ import annotations

import os
import signal
import threading

import pytest

from hystmpc.rig.safety.stop import StopFlag, stopping_on_signals


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_each_signal_asks_for_a_stop_and_the_handler_before_comes_back(name: str) -> None:
    """SIGHUP is what a closed terminal sends: it must not end the program before the device is at rest."""
    number, flag, caught = getattr(signal, name), StopFlag(), []
    before = signal.signal(number, lambda n, frame: caught.append(n))
    try:
        with stopping_on_signals(flag):
            os.kill(os.getpid(), number)
            assert flag.cause == name
            os.kill(os.getpid(), number)
        assert caught == []
        os.kill(os.getpid(), number)
        assert caught == [number]
    finally:
        signal.signal(number, before)


def test_the_first_of_several_signals_is_the_cause() -> None:
    flag = StopFlag()
    with stopping_on_signals(flag):
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGHUP)
    assert flag.cause == "SIGTERM"


def test_outside_the_main_thread_nothing_is_changed() -> None:
    handlers = []

    def look() -> None:
        with stopping_on_signals(StopFlag()):
            handlers.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert handlers == [signal.getsignal(signal.SIGTERM)]
