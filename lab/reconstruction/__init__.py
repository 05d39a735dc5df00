"""Reconstruction experiment of S1: a scanning tip measures distances to a grooved cap, drawn by a model's angle.

`protocol.record_scans` runs a device and models over the session of scans, `reconstruct.reconstruct` measures the
distances and compares every model's cloud of points with the ground truth, `report.reconstruction_pieces` shows it.
Device and models are functions of the command, or arrays in a `Scan`.
"""
