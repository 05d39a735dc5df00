"""The sim-to-real diagnosis: where, which, how far, what next. Empty so far."""
