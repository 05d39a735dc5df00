"""The linearised controller: quadratic program, solver, and the real-time iteration that joins them."""
