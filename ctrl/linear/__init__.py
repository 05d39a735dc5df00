"""Linear analysis of loops: controllers as systems of python-control, margins, limit cycles."""
