"""The loop in C under datagrams of any content: what is malformed moves nothing, and what is odd ends it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hystmpc.rig.compiled.loop import available

from ..sanitized import said_under_sanitizers

RUNS = 1500


@pytest.mark.skipif(not available(), reason="a system without sockets of POSIX")
def test_malformed_datagrams_move_nothing(tmp_path: Path) -> None:
    """On a clock and a wire that are made up; the program says which rule was broken."""
    said = said_under_sanitizers(Path(__file__).with_name("fuzzed_datagrams.c"), [], [1, RUNS], tmp_path)
    runs, commands, *ends = (int(number) for number in re.findall(r"\d+", said))
    assert runs == RUNS == sum(ends)
    assert commands > 10 * RUNS
    assert min(ends[0], ends[4], ends[5], ends[7]) > 10  # to the end, odd, strayed, not sent
