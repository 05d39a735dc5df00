"""Models of actuators with hysteresis: operators, networks, their identification, inverses and the ONNX contract."""
