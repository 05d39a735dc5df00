"""TODO: rig/safety."""
