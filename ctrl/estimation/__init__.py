"""TODO: ctrl/estimation."""
