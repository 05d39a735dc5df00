"""From one CasADi expression to every backend: instruction list, Python source (NumPy, numba, torch), ONNX nodes."""
