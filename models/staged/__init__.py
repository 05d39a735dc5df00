"""Chains run operator by operator over whole trials: compiled once an operator, batched, with exact sensitivities."""
