"""Networks: PyTorch modules that also write their ONNX nodes, and their common parts."""
