"""Simulated plants: a chain of operators or a device of its own physics, with injectable effects."""
