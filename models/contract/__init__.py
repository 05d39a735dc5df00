"""The ONNX contract: what a model file holds, the check before it is written, how it is read again."""
