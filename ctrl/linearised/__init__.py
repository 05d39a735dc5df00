"""Linearised predictive controller: quadratic program, solver and real-time iteration."""
