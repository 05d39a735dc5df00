"""Operators that only move entries, written on arrays of entry numbers: the result says which entry goes where."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Places = NDArray[np.int64]
Attributes = Mapping[str, Any]
Rule = Callable[[Sequence[Places], Sequence[Places | None], Attributes], Sequence[Places]]
# A rule takes the entry numbers of the tensors that it rearranges (all inputs of Concat, the first of the others), the
# values of its remaining inputs (axes, sizes, starts; None where left out) and the attributes.


def _concat(data: Sequence[Places], options: Sequence[Places | None], given: Attributes) -> list[Places]:
    del options
    return [np.concatenate(data, axis=given["axis"])]


def _split(data: Sequence[Places], options: Sequence[Places | None], given: Attributes) -> list[Places]:
    axis = given.get("axis", 0)
    sizes = _option(options, 0)
    if sizes is not None:
        return np.split(data[0], np.cumsum(sizes)[:-1], axis)
    size = data[0].shape[axis]
    chunk = -(-size // given["num_outputs"])  # ONNX rounds up and lets the last part be smaller
    return np.split(data[0], range(chunk, size, chunk), axis)


def _slice(data: Sequence[Places], options: Sequence[Places | None], given: Attributes) -> list[Places]:
    del given
    starts, ends, axes, steps = _needed(options, 0), _needed(options, 1), _option(options, 2), _option(options, 3)
    axes = np.arange(starts.size) if axes is None else axes
    steps = np.ones_like(starts) if steps is None else steps
    cuts = [slice(None)] * data[0].ndim
    for start, end, axis, step in np.stack([starts, ends, axes, steps], axis=1).tolist():
        # Counting down to the first entry, ONNX writes an end that Python would count from the back.
        past_front = step < 0 and end < -data[0].shape[axis]
        cuts[axis] = slice(start, None if past_front else end, step)
    return [data[0][tuple(cuts)]]


def _gather(data: Sequence[Places], options: Sequence[Places | None], given: Attributes) -> list[Places]:
    return [np.take(data[0], _needed(options), axis=given.get("axis", 0))]


def _reshape(data: Sequence[Places], options: Sequence[Places | None], given: Attributes) -> list[Places]:
    copy_zeros = not given.get("allowzero", 0)
    shape = [data[0].shape[k] if n == 0 and copy_zeros else n for k, n in enumerate(_needed(options).tolist())]
    return [data[0].reshape(shape)]


def _squeeze(data: Sequence[Places], options: Sequence[Places | None], given: Attributes) -> list[Places]:
    del given
    axes = _option(options, 0)
    return [np.squeeze(data[0], None if axes is None else tuple(axes.tolist()))]


def _unsqueeze(data: Sequence[Places], options: Sequence[Places | None], given: Attributes) -> list[Places]:
    del given
    return [np.expand_dims(data[0], tuple(_needed(options).tolist()))]


def _transpose(data: Sequence[Places], options: Sequence[Places | None], given: Attributes) -> list[Places]:
    del options
    return [np.transpose(data[0], given.get("perm"))]


def _expand(data: Sequence[Places], options: Sequence[Places | None], given: Attributes) -> list[Places]:
    del given
    shape = np.broadcast_shapes(data[0].shape, tuple(_needed(options).tolist()))
    return [np.broadcast_to(data[0], shape)]


def _option(options: Sequence[Places | None], place: int) -> Places | None:
    return options[place] if place < len(options) else None


def _needed(options: Sequence[Places | None], place: int = 0) -> Places:
    value = _option(options, place)
    if value is None:
        raise ValueError(f"input {place + 1} is left out, expected whole numbers")
    return value


REARRANGE: Mapping[str, Rule] = {
    "Concat": _concat,
    "Expand": _expand,
    "Gather": _gather,
    "Reshape": _reshape,
    "Slice": _slice,
    "Split": _split,
    "Squeeze": _squeeze,
    "Transpose": _transpose,
    "Unsqueeze": _unsqueeze,
}
