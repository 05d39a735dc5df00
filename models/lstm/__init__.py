"""The stacked LSTM: weights, NumPy reference with exact Jacobian, ONNX graphs, torch module."""
