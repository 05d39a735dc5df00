"""Operators: the only place of each equation of hysteresis, lag and delay, as a CasADi expression."""
