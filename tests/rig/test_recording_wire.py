"""The pipe to the recording's process: what goes in comes out, and what is cut off by a death is left out whole."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hystmpc.rig.recording.recorder_process import open_recorder_process, pack, unpack
from hystmpc.rig.recording.recording import RecordingMeta
from hystmpc.trials.run_folder import RunFolder

from .recording_samples import sample

NUMBERS = st.floats(allow_nan=False)
SAMPLES = st.builds(
    sample,
    st.integers(0, 10**6),
    measured_deg=NUMBERS,
    command=NUMBERS,
    status=st.text(),
    missed=st.booleans(),
    faults=st.lists(st.text(), max_size=2).map(tuple),
    stages_s=st.lists(st.tuples(st.text(), NUMBERS), max_size=3).map(tuple),
)


@settings(max_examples=40)
@given(blocks=st.lists(st.lists(SAMPLES, max_size=4), max_size=4), cut=st.floats(0, 1))
def test_whole_blocks_come_out_as_they_went_in(blocks: list[list], cut: float) -> None:
    packed = [pack(block) for block in blocks]
    stream = b"".join(packed)
    assert list(unpack(io.BytesIO(stream))) == blocks
    at = round(cut * len(stream))
    whole = sum(sum(map(len, packed[: k + 1])) <= at for k in range(len(packed)))
    assert list(unpack(io.BytesIO(stream[:at]))) == blocks[:whole]


def test_numbers_of_numpy_become_plain_ones() -> None:
    strange = sample(3, measured_deg=np.float32(1.5), missed=np.bool_(True), sequence=np.int64(3))
    (block,) = unpack(io.BytesIO(pack([strange])))
    assert block == [sample(3, measured_deg=1.5, missed=True)]
    assert type(block[0].measured_deg) is float
    assert struct.unpack("<I", pack([])[:4])[0] == len(pack([])) - 4


@pytest.mark.slow
def test_a_sample_that_cannot_be_sent_does_not_cost_the_others(tmp_path) -> None:
    pytest.importorskip("mcap", reason="mcap (extra `logs`) is not installed")
    told: list[str] = []
    sink = open_recorder_process(tmp_path / "run", {}, RecordingMeta("mm"), 100.0, tell=told.append)
    for k in range(10):
        sink.put(None if k == 4 else sample(k, command="x" if k == 6 else 1.0))  # type: ignore[arg-type]
    sink.close()
    assert (sink.on_disk, sink.dropped) == (8, 2)
    assert told == [f"{tmp_path / 'run'}: 2 samples did not reach the recording"]
    assert RunFolder.open(tmp_path / "run").log()["sequence"].tolist() == [0, 1, 2, 3, 5, 7, 8, 9]
