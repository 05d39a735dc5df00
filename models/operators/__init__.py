"""Operators: each equation of hysteresis, lag and delay stands here once, as a CasADi expression."""
