"""The sim-to-real diagnosis: the place of the gap, its causes, the share that they close, and the next motion."""
