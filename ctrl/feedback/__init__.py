"""TODO: ctrl/feedback."""
