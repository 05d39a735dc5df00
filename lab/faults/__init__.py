"""Fault campaigns over real connections or on simulated devices, and their verdicts."""
