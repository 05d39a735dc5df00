"""Compiled roll-outs and exact sensitivities, made by numba on the user's machine without a compiler."""
