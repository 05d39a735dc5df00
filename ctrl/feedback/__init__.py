"""Laws without a horizon: PID feedback, inverse feedforward, both together."""
