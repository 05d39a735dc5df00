"""Networks: one definition each, a PyTorch module that also writes its own ONNX nodes; what they share."""
