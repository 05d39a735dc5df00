"""Sim-to-real diagnosis: location and causes of the gap, the share that the causes close, and the next motion."""
