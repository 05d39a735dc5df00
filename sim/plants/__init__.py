"""Simulated plants, made of operators or of a device with separate physics, with additional effects."""
