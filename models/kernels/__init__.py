"""Loops that numba compiles until the engine has them."""
