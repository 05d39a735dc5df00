"""Residual of the retuned simulator: parts of the motion, spectrum, memory."""
