"""Fast roll-outs and exact linearisations of a model for predictive control."""
