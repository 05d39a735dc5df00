"""The ONNX contract: content of a model file, the check before it is written, and the loader."""
