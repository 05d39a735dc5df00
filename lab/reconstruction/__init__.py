"""S1's reconstruction experiment: a scanning tip ranges a grooved cap, and a model's angle draws it.

`protocol.record_scans` runs a device and models over the session of scans, `reconstruct.reconstruct` measures the
distances and compares every model's cloud of points with the ground truth, `report.reconstruction_pieces` shows it.
What device and models are does not matter here: they come in as functions of the command, or as arrays in a `Scan`.
"""
