"""Opening a checked step graph in onnxruntime: one thread, warmed up, errors on one line."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnxruntime as ort
import onnxruntime.capi.onnxruntime_pybind11_state as state_

from hystmpc.trials.errors import ModelError

_ERRORS = (
    state_.EPFail,
    state_.Fail,
    state_.InvalidArgument,
    state_.InvalidGraph,
    state_.InvalidProtobuf,
    state_.NotImplemented,
    state_.RuntimeException,
)
_SILENT = 3  # errors only
_WARM_UP = (1, 2, 1)  # batch sizes; the second differs so that a frozen batch axis shows


def open_session(content: bytes, state_size: int, dtype: np.dtype[np.generic], where: str) -> ort.InferenceSession:
    """Open a step graph and run it a few times, so that the first step in a loop is as fast as the rest.

    Raises:
        ModelError: if onnxruntime refuses the graph, or it does not keep the batch axis.
    """
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.log_severity_level = _SILENT
    try:
        session = ort.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        for batch in _WARM_UP:
            _check_batch(session, batch, state_size, dtype, where)
    except _ERRORS as error:
        text = " ".join(str(error).split())
        raise ModelError(f"{where}: onnxruntime refuses the graph: {text}") from None
    return session


def _check_batch(session: ort.InferenceSession, batch: int, state_size: int, dtype: np.dtype[Any], where: str) -> None:
    feed = {"u": np.zeros((batch, 1), dtype), "state": np.zeros((batch, state_size), dtype)}
    shapes = [np.asarray(result).shape for result in session.run(["theta", "next_state"], feed)]
    if shapes != [(batch, 1), (batch, state_size)]:
        raise ModelError(
            f"{where}: a batch of {batch} gives theta {shapes[0]} and next_state {shapes[1]}, "
            f"expected ({batch}, 1) and ({batch}, {state_size})"
        )
