"""Estimation of model state and output disturbance."""
