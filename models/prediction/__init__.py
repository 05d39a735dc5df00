"""Fast roll-outs and exact linearisations of a model for predictive control, and the reference they are held against."""
