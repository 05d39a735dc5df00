"""Simulated plants, made of operators or of a device with physics of its own, with additional effects."""
