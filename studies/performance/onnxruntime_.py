"""Matrix products by onnxruntime, whose kernels know newer processors than those of NumPy's BLAS."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import onnxruntime
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

Float32 = NDArray[np.float32]


def product_call(a: Float32, b: Float32, threads: int) -> Callable[[], object]:
    """One call of the product of `a` (M, K) and the constant `b` (K, N), into memory that is already there."""
    shapes = {"a": a.shape, "c": (a.shape[0], b.shape[1])}
    tensors = {name: helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in shapes.items()}
    node = helper.make_node("MatMul", ["a", "b"], ["c"])
    graph = helper.make_graph([node], "product", [tensors["a"]], [tensors["c"]], [numpy_helper.from_array(b, "b")])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    # waiting threads must not burn the cores of the job that is timed next
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    binding = session.io_binding()
    binding.bind_ortvalue_input("a", onnxruntime.OrtValue.ortvalue_from_numpy(a))
    binding.bind_ortvalue_output("c", onnxruntime.OrtValue.ortvalue_from_numpy(np.empty(shapes["c"], np.float32)))
    return lambda: session.run_with_iobinding(binding)
