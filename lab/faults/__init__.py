"""Faults on purpose, over a real connection, and what became of them."""
