"""Operators: equations of hysteresis, lag and delay, each defined once as a CasADi expression."""
