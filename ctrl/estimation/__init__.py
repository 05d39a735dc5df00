"""Estimation: model state and output disturbance, and the learned part of a model."""
