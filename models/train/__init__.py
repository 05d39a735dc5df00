"""Training of networks and regressions."""
