"""Simulated devices by name, not made of identified operators: the tendon catheter of S2, and those of packages."""
