"""Fixture: devices and controllers of a test are forked from one process with its imports done.

What they run is a function of the laboratory, for the other process has to find it by the name of its module: a module
of tests is named after the folder of the checkout.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from hystmpc_lab.faults import play
from hystmpc_lab.faults.forked import Forked


@pytest.fixture
def forked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Devices and controllers that `play` starts are forked, those in a terminal excepted."""

    def start(arguments: Sequence[object], *others: Any) -> Forked:
        return Forked(arguments)

    monkeypatch.setattr(play, "start", start)
